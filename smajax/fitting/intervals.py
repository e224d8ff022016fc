"""Confidence intervals under autocorrelated noise, and collinear parameters.

Least squares with the Jacobian J and the residual e has the covariance H^-1 (J' Omega J) H^-1 with H = J' J, where
Omega is the covariance of the noise. To take Omega as white makes intervals several times too narrow when neighbouring
samples err together, as they do behind any filter or where the model lacks an effect. Here Omega comes from an
autoregressive model of each channel's residual, its order chosen by Akaike's criterion, and J' Omega J is summed over
frequencies as the power of J's columns times the spectrum of that model.

Source: akaike1974 (order), levinson1946 (recursion), brun2001 (collinearity).
"""

import dataclasses
import math

import numpy as np
import scipy.linalg
import scipy.special

# Highest order of an autoregression; chosen by trial, tests/unit/fitting/test_fit.py holds the intervals' coverage.
_MAX_ORDER = 30
# Least samples per coefficient; chosen by trial, held by the same test.
_SAMPLES_PER_COEFFICIENT = 10
# Eigenvalues of J' J (columns of length 1) below this share of the largest are rounding: nothing moves along that
# direction.
_FLAT_EIGENVALUE = 1e-14
# Share of a flat direction from which a parameter takes part in it: above rounding, below any real share.
_MEMBER_SHARE = 1e-3
# Response of a normalised direction below which its parameters are collinear: the inverse of the collinearity index of
# brun2001, so an index of 10. Chosen by trial; tests/unit/fitting/test_fit.py holds it.
_COLLINEAR_RESPONSE = 0.1
# Share of the direction's largest entry from which a parameter belongs to the group; chosen by trial, held by the same
# tests.
_GROUP_SHARE = 0.1


@dataclasses.dataclass(frozen=True)
class CollinearGroup:
    """Parameters whose effects the data cannot distinguish.

    Attributes:
        parameters: Names.
        direction: Joint change, each over the parameter's size, that hardly changes the model.
        shrink: Response to that change over the response to independent changes of the same size; 0 for a single
            parameter without any effect.
    """

    parameters: tuple[str, ...]
    direction: tuple[float, ...]
    shrink: float


def fit_autoregression(series: np.ndarray, most: int = _MAX_ORDER) -> tuple[np.ndarray, float]:
    """Fit ``e_t = sum a_k e_{t-k} + w_t`` by Levinson's recursion, with the order of least Akaike criterion.

    Args:
        series: Evenly sampled series e (n,), of mean 0.
        most: Highest order.

    Returns:
        The coefficients a (order,) and the variance of w.
    """
    n = len(series)
    most = min(most, n // _SAMPLES_PER_COEFFICIENT)
    correlation = np.array([series[: n - k] @ series[k:] / n for k in range(most + 1)])
    best, coefficients = (n * math.log(max(correlation[0], 1e-300)), np.zeros(0), correlation[0]), np.zeros(0)
    variance = correlation[0]
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
        criterion = n * math.log(max(variance, 1e-300)) + 2.0 * k
        if criterion < best[0]:
            best = (criterion, coefficients, variance)
    return best[1], best[2]


def autoregressive_spectrum(coefficients: np.ndarray, variance: float, frequencies: np.ndarray) -> np.ndarray:
    """Compute the power spectral density (variance per cycle per sample) of an autoregression.

    ``frequencies`` are in cycles per sample.
    """
    lags = np.arange(1, len(coefficients) + 1)
    denominator = 1.0 - np.exp(-2j * np.pi * np.outer(frequencies, lags)) @ coefficients
    return variance / np.abs(denominator) ** 2


def score_covariance(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """Compute J' Omega J of one evenly sampled series.

    Args:
        jacobian: J (n, p).
        residual: Residual (n,), whose autoregression gives Omega.

    Returns:
        Shape ``(p, p)``.
    """
    n = len(residual)
    coefficients, variance = fit_autoregression(residual - residual.mean())
    length = 2 * n
    transformed = np.fft.rfft(jacobian, length, axis=0)
    density = autoregressive_spectrum(coefficients, variance, np.fft.rfftfreq(length))
    twice = np.full(len(density), 2.0)
    twice[0] = twice[-1] = 1.0
    return np.real((transformed.conj().T * (density * twice / length)) @ transformed)


def estimate_covariance(jacobians: list[np.ndarray], residuals: list[np.ndarray], parameters: int) -> np.ndarray:
    """Compute the covariance of the estimates from the series of all channels and recordings.

    Args:
        jacobians: One Jacobian (n, p) a series.
        residuals: One residual (n,) a series.
        parameters: Number of free parameters.

    Returns:
        Shape ``(p, p)``. The variance is infinite for parameters of a direction along which no residual changes, and
        for all of them where there are no more samples than parameters.
    """
    samples = sum(len(r) for r in residuals)
    if samples <= parameters:
        return np.diag(np.full(jacobians[0].shape[1], np.inf))
    normal = np.sum([j.T @ j for j in jacobians], axis=0)
    middle = np.sum([score_covariance(j, r) for j, r in zip(jacobians, residuals, strict=True)], axis=0)
    effective = np.diag(normal) > 0
    size = np.sqrt(np.where(effective, np.diag(normal), 1.0))
    block = np.ix_(effective, effective)
    values, vectors = np.linalg.eigh((normal / np.outer(size, size))[block])
    flat = values <= _FLAT_EIGENVALUE * np.max(values, initial=0.0)
    inverse = (vectors[:, ~flat] / values[~flat]) @ vectors[:, ~flat].T
    result = np.full(normal.shape, 0.0)
    result[block] = inverse @ (middle / np.outer(size, size))[block] @ inverse
    result *= samples / (samples - parameters)
    result /= np.outer(size, size)
    in_flat = np.flatnonzero(effective)[np.any(np.abs(vectors[:, flat]) > _MEMBER_SHARE, axis=1)]
    undetermined = np.union1d(np.flatnonzero(~effective), in_flat)
    result[undetermined, undetermined] = np.inf
    return result


def student_quantile(samples: int, parameters: int) -> float:
    """Return the two-sided 95 % quantile of Student's distribution."""
    return float(scipy.special.stdtrit(max(samples - parameters, 1), 0.975))


def find_collinear_groups(
    jacobian: np.ndarray, names: list[str], sizes: np.ndarray, threshold: float = _COLLINEAR_RESPONSE
) -> list[CollinearGroup]:
    """Find groups of parameters whose joint change along some direction hardly changes the model.

    The columns of the Jacobian are scaled to length 1; the response along an eigenvector of their Gram matrix is the
    root of its eigenvalue, the inverse of the collinearity index of brun2001.

    Args:
        jacobian: Shape ``(m, p)``.
        names: Names of the parameters (p,).
        sizes: Sizes of the parameters (p,), over which directions are given.
        threshold: Response below which a group is reported.
    """
    length = np.linalg.norm(jacobian, axis=0)
    groups = [CollinearGroup((names[i],), (1.0,), 0.0) for i in np.flatnonzero(length == 0)]
    effective = np.flatnonzero(length > 0)
    if len(effective) < 2:
        return groups
    unit = jacobian[:, effective] / length[effective]
    values, vectors = scipy.linalg.eigh(unit.T @ unit)
    for value, vector in zip(values, vectors.T, strict=True):
        response = math.sqrt(max(value, 0.0))
        if response > threshold:
            break
        members = np.abs(vector) > _GROUP_SHARE * np.max(np.abs(vector))
        direction = vector[members] / (length[effective] * sizes[effective])[members]
        direction /= np.linalg.norm(direction) * (np.sign(direction[np.argmax(np.abs(direction))]) or 1.0)
        group = tuple(names[i] for i in effective[members])
        groups.append(CollinearGroup(group, tuple(float(d) for d in direction), response))
    return groups
