"""Checks of a residual, channel by channel: noise, autocorrelation, and cross-correlation with the inputs."""

import dataclasses

import numpy as np
from jaxtyping import Float

from smajax.fitting.noise import difference_noise

# Largest lag of the correlations, as in MATLAB's ``resid``.
LAGS = 25
# Quantile of the normal distribution that bounds 99 % of it, as in MATLAB's ``resid``.
_BAND_QUANTILE = 2.576
# Samples of a stretch under constant inputs in which noise is measured, and how many stretches there have to be for
# their quartiles to mean something. Chosen by trial; tests/unit/diagnosis holds them.
_WINDOW = 60
_MIN_WINDOWS = 6
# An input counts as constant where it changes by less than this share of its range from one sample to the next. Chosen
# by trial.
_CONSTANT = 1e-3
# Upper over lower quartile of the stretches' spreads up to which they agree, as those of noise alone do. Chosen by
# trial.
_MAX_SPREAD_RATIO = 1.35
# Noise at rest replaces that of the differences if it is larger by 10 % (else both say the same), and less than twice
# as large: more would be a decay that a parabola does not follow. Chosen by trial; tests/unit/diagnosis holds them.
_MIN_EXCESS = 1.1
_MAX_EXCESS = 2.0


@dataclasses.dataclass(frozen=True)
class ResidualStatistics:
    """One channel's residual: autocorrelation from lag 1, cross-correlation with each input from ``-LAGS`` to ``LAGS``.

    ``band`` bounds 99 % of the correlations of white noise. ``outside`` is the share of lags beyond it, of the
    autocorrelation ("residual") and of each input.
    """

    rms: float
    band: float
    autocorrelation: Float[np.ndarray, " lags"]
    cross: dict[str, np.ndarray]
    outside: dict[str, float]


def residual_statistics(series: Float[np.ndarray, " n"], inputs: dict[str, np.ndarray]) -> ResidualStatistics:
    """Compute the statistics of a residual.

    Args:
        series: The residual, in any unit.
        inputs: The driving channels at the same samples.

    Source: ljung1999, section 16.6.
    """
    count = len(series)
    lags = min(LAGS, count // 4)
    band = _BAND_QUANTILE / np.sqrt(count)
    own = correlation(series, series, lags)[lags + 1 :]
    cross = {name: correlation(series, values, lags) for name, values in inputs.items()}
    outside = {"residual": float(np.mean(np.abs(own) > band))}
    outside |= {name: float(np.mean(np.abs(c) > band)) for name, c in cross.items()}
    return ResidualStatistics(float(np.sqrt(np.mean(series**2))), float(band), own, cross, outside)


def correlation(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"], lags: int
) -> Float[np.ndarray, " lags"]:
    """Correlate one series at t with another at t - lag, from ``-lags`` to ``lags``; zero if one is constant."""
    a, b = first - first.mean(), second - second.mean()
    size = np.linalg.norm(a) * np.linalg.norm(b)
    if size <= 1e-12 * max(np.abs(first).max(initial=0.0) * np.abs(second).max(initial=0.0), 1e-300):
        return np.zeros(2 * lags + 1)
    n = len(a)
    products = [a[max(k, 0) : n + min(k, 0)] @ b[max(-k, 0) : n - max(k, 0)] for k in range(-lags, lags + 1)]
    return np.array(products) / size


def estimate_noise(residual: Float[np.ndarray, " n"], inputs: dict[str, np.ndarray]) -> tuple[float, str]:
    """Estimate the standard deviation of a channel's noise: at rest or from differences, whichever is larger.

    Noise that is slower than the sampling shows at rest only: in the quietest quarter of the stretches under constant
    inputs, about a parabola through each.

    Args:
        residual: The channel's residual.
        inputs: The driving channels at the same samples.

    Returns:
        The standard deviation, and where it is from: "rest" or "residual differences".
    """
    fast = difference_noise(residual)
    constant = np.ones(len(residual), bool)
    for values in inputs.values():
        constant &= np.append(False, np.abs(np.diff(values)) <= _CONSTANT * max(np.ptp(values), 1e-300))
    x = np.linspace(-1.0, 1.0, _WINDOW)
    parabola = np.column_stack([np.ones_like(x), x, x * x])
    project = np.eye(_WINDOW) - parabola @ np.linalg.pinv(parabola)
    windows = [
        residual[k : k + _WINDOW]
        for k in range(0, len(residual) - _WINDOW + 1, _WINDOW)
        if constant[k : k + _WINDOW].all()
    ]
    if len(windows) < _MIN_WINDOWS:
        return fast, "residual differences"
    spreads = [np.sqrt(np.sum((project @ w) ** 2) / (_WINDOW - 3)) for w in windows]
    at_rest, upper = (float(q) for q in np.quantile(spreads, [0.25, 0.75]))
    plausible = _MIN_EXCESS * fast < at_rest < _MAX_EXCESS * fast and upper < _MAX_SPREAD_RATIO * at_rest
    return (at_rest, "rest") if plausible else (fast, "residual differences")
