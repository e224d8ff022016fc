"""Checks of a residual, channel by channel: noise, autocorrelation, and cross-correlation with the inputs."""

import dataclasses

import numpy as np
from jaxtyping import Float

from smajax.fitting.noise import difference_noise

# Largest lag of the correlations, as in MATLAB's ``resid``.
LAGS = 25
# Quantile of the normal distribution that bounds 99 % of it, as in MATLAB's ``resid``.
_BAND_QUANTILE = 2.576
# Number of samples of a window under constant inputs in which noise is measured, and least number of windows for
# meaningful quartiles. Chosen by trial; tests/unit/diagnosis holds them.
_WINDOW = 60
_MIN_WINDOWS = 6
# Change of an input from one sample to the next, as a share of its range, up to which it counts as constant. Chosen by
# trial.
_CONSTANT = 1e-3
# Upper over lower quartile of the windows' standard deviations below which they agree, as those of noise alone do.
# Chosen by trial.
_MAX_SPREAD_RATIO = 1.35
# The noise at rest replaces that of the differences if their ratio is between these numbers: below the first they
# agree, and above the second the residual decays in a way that a parabola does not follow. Chosen by trial;
# tests/unit/diagnosis holds them.
_MIN_EXCESS = 1.1
_MAX_EXCESS = 2.0


@dataclasses.dataclass(frozen=True)
class ResidualStatistics:
    """Statistics of the residual of one channel.

    Attributes:
        rms: Root mean square, in the unit of the residual.
        band: Bound of 99 % of the correlations of white noise.
        autocorrelation: Autocorrelation from lag 1 to ``LAGS``.
        cross: Cross-correlation with each input from lag ``-LAGS`` to ``LAGS``, by input.
        outside: Share of lags beyond ``band``, of the autocorrelation ("residual") and of each input.
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
        inputs: The driving channels at the same samples, each of shape ``(n,)``.

    Source: ljung1999, section 16.6.
    """
    count = len(series)
    lags = min(LAGS, count // 4)
    band = _BAND_QUANTILE / np.sqrt(count)
    autocorrelation = correlation(series, series, lags)[lags + 1 :]
    cross = {name: correlation(series, values, lags) for name, values in inputs.items()}
    outside = {"residual": float(np.mean(np.abs(autocorrelation) > band))}
    outside |= {name: float(np.mean(np.abs(c) > band)) for name, c in cross.items()}
    return ResidualStatistics(float(np.sqrt(np.mean(series**2))), float(band), autocorrelation, cross, outside)


def correlation(
    first: Float[np.ndarray, " n"], second: Float[np.ndarray, " n"], lags: int
) -> Float[np.ndarray, " lags"]:
    """Compute the correlation of one series at t with another at t - lag.

    Args:
        first: The series at t.
        second: The series at t - lag, of the same length.
        lags: Largest lag, in samples.

    Returns:
        The correlation from lag ``-lags`` to ``lags``, shape ``(2 lags + 1,)``; zero if a series is constant.
    """
    a, b = first - first.mean(), second - second.mean()
    norm = np.linalg.norm(a) * np.linalg.norm(b)
    if norm <= 1e-12 * max(np.abs(first).max(initial=0.0) * np.abs(second).max(initial=0.0), 1e-300):
        return np.zeros(2 * lags + 1)
    count = len(a)
    products = [a[max(k, 0) : count + min(k, 0)] @ b[max(-k, 0) : count - max(k, 0)] for k in range(-lags, lags + 1)]
    return np.array(products) / norm


def estimate_noise(residual: Float[np.ndarray, " n"], inputs: dict[str, np.ndarray]) -> tuple[float, str]:
    """Estimate the standard deviation of a channel's noise from differences of the residual, or at rest.

    Differences miss noise that is slower than the sampling. It is measured at rest: in windows under constant inputs,
    about a parabola through each, as the lower quartile of their standard deviations.

    Args:
        residual: The residual of the channel.
        inputs: The driving channels at the same samples, each of shape ``(n,)``.

    Returns:
        The standard deviation, in the unit of the residual, and its source: "rest" or "residual differences".
    """
    from_differences = difference_noise(residual)
    constant = np.ones(len(residual), bool)
    for values in inputs.values():
        constant &= np.append(False, np.abs(np.diff(values)) <= _CONSTANT * max(np.ptp(values), 1e-300))
    x = np.linspace(-1.0, 1.0, _WINDOW)
    parabola = np.column_stack([np.ones_like(x), x, x * x])
    remove_parabola = np.eye(_WINDOW) - parabola @ np.linalg.pinv(parabola)
    windows = [
        residual[k : k + _WINDOW]
        for k in range(0, len(residual) - _WINDOW + 1, _WINDOW)
        if constant[k : k + _WINDOW].all()
    ]
    if len(windows) < _MIN_WINDOWS:
        return from_differences, "residual differences"
    spreads = [np.sqrt(np.sum((remove_parabola @ w) ** 2) / (_WINDOW - 3)) for w in windows]
    at_rest, upper = (float(q) for q in np.quantile(spreads, [0.25, 0.75]))
    is_larger = _MIN_EXCESS * from_differences < at_rest < _MAX_EXCESS * from_differences
    is_slow_noise = is_larger and upper < _MAX_SPREAD_RATIO * at_rest
    return (at_rest, "rest") if is_slow_noise else (from_differences, "residual differences")
