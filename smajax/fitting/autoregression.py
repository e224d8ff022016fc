"""Autoregressive models of a residual: coefficients, order and spectrum.

Source: levinson1946 (recursion), akaike1974 (order).
"""

import math

import numpy as np
from jaxtyping import Float

# Highest order of an autoregression; chosen by trial, tests/unit/fitting/test_fit.py holds the intervals' coverage.
_MAX_ORDER = 30
# Least samples per coefficient; chosen by trial, held by the same test.
_SAMPLES_PER_COEFFICIENT = 10
# Frequencies whose spectrum is computed at a time: with 30 coefficients they take 25 MB.
_BLOCK = 50_000
# Keeps the logarithm of a variance finite where a series vanishes.
_TINY = 1e-300


def fit_autoregression(
    series: Float[np.ndarray, " n"], most: int = _MAX_ORDER
) -> tuple[Float[np.ndarray, " order"], float]:
    """Fit an autoregression to a series by Levinson's recursion, with the order of least Akaike criterion.

        e_t = sum_k a_k e_{t-k} + w_t,    AIC = n ln(var w) + 2 order

    Args:
        series: Evenly sampled series e (n,), of mean 0.
        most: Highest order; at most a tenth of the samples is used.

    Returns:
        The coefficients a (order,) and the variance of the innovations w, in the series' unit squared.

    Source: levinson1946, akaike1974.
    """
    n = len(series)
    most = min(most, n // _SAMPLES_PER_COEFFICIENT)
    correlation = np.array([series[: n - k] @ series[k:] / n for k in range(most + 1)])
    variance, coefficients = correlation[0], np.zeros(0)
    best = (n * math.log(max(variance, _TINY)), coefficients, variance)
    for k in range(1, most + 1):
        if variance <= 0:
            break
        reflection = (
            (correlation[k] - coefficients @ correlation[k - 1 : 0 : -1]) / variance
            if k > 1
            else correlation[1] / variance
        )
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= 1.0 - reflection**2
        criterion = n * math.log(max(variance, _TINY)) + 2.0 * k
        if criterion < best[0]:
            best = (criterion, coefficients, variance)
    return best[1], best[2]


def autoregressive_spectrum(
    coefficients: Float[np.ndarray, " order"], variance: float, frequencies: Float[np.ndarray, " frequencies"]
) -> Float[np.ndarray, " frequencies"]:
    """Compute the power spectral density of an autoregression.

        S(f) = var w / |1 - sum_k a_k exp(-2 pi i k f)|^2

    Args:
        coefficients: Coefficients a (order,).
        variance: Variance of the innovations w.
        frequencies: Frequencies f, cycles per sample.

    Returns:
        The density at each frequency, in variance per (cycle per sample).
    """
    lags = np.arange(1, len(coefficients) + 1)
    blocks = np.split(frequencies, range(_BLOCK, len(frequencies), _BLOCK))
    sums = [np.exp(-2j * np.pi * np.outer(block, lags)) @ coefficients for block in blocks]
    return variance / np.abs(1.0 - np.concatenate(sums)) ** 2
