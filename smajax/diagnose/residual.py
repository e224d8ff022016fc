"""What a residual looks like, channel by channel: its noise, how much of it is no noise, and what it goes with."""

import dataclasses

import numpy as np

from smajax.fit.problem import difference_noise

LAGS = 25
_BAND = 2.576  # 99 % of a normal distribution, as in MATLAB's resid
_WINDOW = 60
_WINDOWS, _AGREE = 6, 1.35


@dataclasses.dataclass(frozen=True)
class Look:
    """One channel's residual: autocorrelation ``(LAGS,)`` from lag 1, cross-correlation with each input ``(2 LAGS + 1,)``.

    ``band`` bounds 99 % of what white noise gives. ``outside`` is the share of lags beyond it, of the autocorrelation and of each input.
    """

    rms: float
    band: float
    autocorrelation: np.ndarray
    cross: dict[str, np.ndarray]
    outside: dict[str, float]


def look(series: np.ndarray, inputs: dict[str, np.ndarray]) -> Look:
    """Looks at a residual (any unit); ``inputs`` are the driving channels at the same samples."""
    count = len(series)
    lags = min(LAGS, count // 4)
    band = _BAND / np.sqrt(count)
    own = correlation(series, series, lags)[lags + 1 :]
    cross = {name: correlation(series, values, lags) for name, values in inputs.items()}
    outside = {"residual": float(np.mean(np.abs(own) > band))} | {n: float(np.mean(np.abs(c) > band)) for n, c in cross.items()}
    return Look(float(np.sqrt(np.mean(series**2))), float(band), own, cross, outside)


def correlation(first: np.ndarray, second: np.ndarray, lags: int) -> np.ndarray:
    """Correlation of one series at t with another at t - lag, from lag ``-lags`` to ``lags``; zero if one of them is constant."""
    a, b = first - first.mean(), second - second.mean()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if size <= 1e-12 * max(np.abs(first).max(initial=0.0) * np.abs(second).max(initial=0.0), 1e-300):
        return np.zeros(2 * lags + 1)
    n = len(a)
    return np.array([a[max(k, 0) : n + min(k, 0)] @ b[max(-k, 0) : n - max(k, 0)] for k in range(-lags, lags + 1)]) / size


def noise(residual: np.ndarray, inputs: dict[str, np.ndarray]) -> tuple[float, str]:
    """Standard deviation of a channel's noise, and where it is seen: at rest or in the residual's differences, whichever is more.

    Noise that is slower than the sampling shows at rest only: in the quietest quarter of the stretches under constant inputs, about a
    parabola through each.
    """
    fast = difference_noise(residual)
    still = np.ones(len(residual), bool)
    for values in inputs.values():
        still &= np.append(False, np.abs(np.diff(values)) <= 1e-3 * max(np.ptp(values), 1e-300))
    x = np.linspace(-1.0, 1.0, _WINDOW)
    fit = np.column_stack([np.ones_like(x), x, x * x])
    project = np.eye(_WINDOW) - fit @ np.linalg.pinv(fit)
    windows = [residual[k : k + _WINDOW] for k in range(0, len(residual) - _WINDOW + 1, _WINDOW) if still[k : k + _WINDOW].all()]
    if len(windows) < _WINDOWS:
        return fast, "residual differences"
    spreads = [np.sqrt(np.sum((project @ w) ** 2) / (_WINDOW - 3)) for w in windows]
    rest, louder = (float(q) for q in np.quantile(spreads, [0.25, 0.75]))
    # A parabola follows a decay badly, so a stretch that has not come to rest would pass for noise: more than double is not believed, nor
    # are stretches that do not agree, as noise alone would.
    return (rest, "rest") if 1.1 * fast < rest < 2.0 * fast and louder < _AGREE * rest else (fast, "residual differences")
