"""Bootstrap samples of the residuals of a branch: autoregressive noise with their scatter and autocorrelation."""

import math

import numpy as np
from jaxtyping import Float, Int
from scipy.signal import correlate, lfilter

from smajax.fitting.autoregression import fit_autoregression
from smajax.properties.minor_loops import noise_of_averages

# Number of bootstrap samples of a branch; chosen by trial, tests/unit/properties/test_properties.py holds the coverage
# of the intervals.
SAMPLES = 60
# Residuals with a standard deviation above this multiple of their row-to-row noise are a misfit of the lines, not
# noise. Chosen by trial, like the constants below; held by the same tests.
MISFIT_RATIO = 5.0
# Least number of independent rows minus coefficients, the degrees of freedom of the chi-squared variable.
_MIN_DEGREES_OF_FREEDOM = 4.0
# Largest autocorrelation at lag 1 after debiasing: a stronger one cannot be distinguished from a trend in so few rows.
_MAX_AUTOCORRELATION = 0.96
# Number of coefficients per row above which Kendall's formula, a first-order expansion, does not hold.
_MAX_COEFFICIENTS_PER_ROW = 0.05
# Rows on a line from which its own noise can be estimated.
_MIN_ROWS_OF_A_LINE = 4
# Rows per coefficient that an autoregression runs before its first used value, so that it has forgotten its start.
_WARM_UP_ROWS = 20
# Keeps divisions finite where residuals vanish.
_TINY = 1e-300


def bootstrap_residuals(
    line_index: Int[np.ndarray, " n"], residual: Float[np.ndarray, " n"], coefficients: int, rng: np.random.Generator
) -> Float[np.ndarray, "samples n"]:
    """Draw residuals like those of a fitted curve, from an autoregression.

    Each of the three lines with enough rows has its own autoregression and its own standard deviation, since noise in
    the temperatures affects the strain only where it is steep. The standard deviation is uncertain as well: it is drawn
    with a chi-squared variable whose degrees of freedom are the independent rows minus the coefficients.

    Args:
        line_index: Index (n,) of the line on which each row lies.
        residual: Residuals (n,) of the strain.
        coefficients: Number of coefficients of the curve.
        rng: Random stream.

    Returns:
        The residuals (SAMPLES, n) of the bootstrap samples.
    """
    residuals = np.zeros((SAMPLES, len(line_index)))
    lines = [line_index == index for index in np.unique(line_index)]
    everywhere = (np.full(len(line_index), True), coefficients)
    for rows, share in (
        everywhere,
        *((rows, coefficients / 3) for rows in lines if np.sum(rows) >= _MIN_ROWS_OF_A_LINE),
    ):
        series = residual[rows]
        deviation, inefficiency = math.sqrt(float(np.mean(series**2))), 2.0 * _correlation_rows(series) - 1.0
        independent = max(len(series) / inefficiency, share + _MIN_DEGREES_OF_FREEDOM)
        residuals[:, rows] = (
            _draw_like(series / max(deviation, _TINY), share, rng)
            * deviation
            * np.sqrt(independent / rng.chisquare(independent - share, (SAMPLES, 1)))
        )
    return residuals


def _draw_like(series: np.ndarray, coefficients: int | float, rng: np.random.Generator) -> np.ndarray:
    """Draw series (SAMPLES, n) from the autoregression of a series (n,) of residuals of a curve."""
    autoregression, variance = fit_autoregression(series)
    if np.sum(autoregression) <= 0.0:  # the residuals of white noise oscillate in this way after a fit
        autoregression, variance = np.zeros(0), 1.0
    if float(np.std(series)) < MISFIT_RATIO * noise_of_averages(series, 1):
        autoregression = debias_autocorrelation(autoregression, coefficients / len(series), 2.0 / len(series))
    rows = len(series) + _WARM_UP_ROWS * (len(autoregression) + 1)
    innovations = math.sqrt(variance) * rng.standard_normal((SAMPLES, rows))
    return np.asarray(lfilter([1.0], np.append(1.0, -autoregression), innovations, axis=1))[:, rows - len(series) :]


def debias_autocorrelation(
    autoregression: Float[np.ndarray, " order"], coefficients_per_row: float, two_per_row: float
) -> Float[np.ndarray, " order"]:
    """Correct an autoregression of residuals for the curve that was subtracted from them.

    The fitted curve absorbs slow noise, so that neighbouring residuals correlate less than the noise does. For a
    first-order autoregression r in n rows, the mean of the estimate is r - (1 + 3 r) / n after a mean was subtracted,
    r - (2 + 4 r) / n after a straight line, and so on:

        E[r_estimated] = r - (k + (k + 2) r) / n    with k coefficients

    This is inverted for the slowest root, unless that root oscillates or there are too few rows for the formula.

    Args:
        autoregression: Coefficients (order,) of the autoregression.
        coefficients_per_row: Coefficients of the curve over rows.
        two_per_row: 2 over rows.

    Returns:
        The corrected coefficients (order,).

    Source: kendall1954.
    """
    if not len(autoregression) or coefficients_per_row > _MAX_COEFFICIENTS_PER_ROW:
        return autoregression
    roots = np.roots(np.append(1.0, -autoregression))
    slowest = int(np.argmax(np.abs(roots)))
    if abs(roots[slowest].imag) > 0.0 or roots[slowest].real <= 0.0:
        return autoregression
    estimated = roots[slowest].real
    unbiased = (estimated + coefficients_per_row) / (1.0 - coefficients_per_row - two_per_row)
    roots[slowest] = max(estimated, min(unbiased, _MAX_AUTOCORRELATION))
    return -np.real(np.poly(roots))[1:]


def _correlation_rows(residual: np.ndarray) -> float:
    """Correlation length of residuals (n,) in rows, at least 1: sum of their autocorrelation up to its first zero."""
    centred = residual - residual.mean()
    covariances = correlate(centred, centred, "full")[len(centred) - 1 :]
    shares = covariances / max(float(covariances[0]), _TINY)
    return float(np.sum(shares[: int(np.argmax(shares <= 0.0))])) if np.any(shares <= 0.0) else 1.0
