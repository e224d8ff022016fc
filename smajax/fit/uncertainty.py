"""What the data say about each parameter: intervals that survive autocorrelated noise, and what cannot be told apart.

Least squares with weights J and residual e has the covariance H^-1 (J' Omega J) H^-1 with H = J' J, where Omega is the covariance of the
noise. Taking Omega as white makes intervals several times too narrow when neighbouring samples err together, as they do behind any filter
or where the model lacks something. Here Omega comes from an autoregressive model of each channel's residual, its order chosen by Akaike's
criterion, and J' Omega J is summed over frequencies as the power of J's columns times the spectrum of that model.
"""

import dataclasses
import math

import numpy as np
import scipy.linalg
import scipy.special


@dataclasses.dataclass(frozen=True)
class Indistinct:
    """Parameters that the data cannot tell apart: moving them together along ``direction`` (each over its size) hardly changes the model.

    ``shrink`` is the share of the response that is left, compared with moving them by as much independently. A single parameter with a
    shrink of 0 has no effect at all.
    """

    parameters: tuple[str, ...]
    direction: tuple[float, ...]
    shrink: float


def autoregression(series: np.ndarray, most: int = 30) -> tuple[np.ndarray, float]:
    """Coefficients ``a`` of ``e_t = sum a_k e_{t-k} + w_t`` and the variance of ``w``, by Levinson's recursion and Akaike's criterion."""
    n = len(series)
    most = min(most, n // 10)
    correlation = np.array([series[: n - k] @ series[k:] / n for k in range(most + 1)])
    best, coefficients = (n * math.log(max(correlation[0], 1e-300)), np.zeros(0), correlation[0]), np.zeros(0)
    variance = correlation[0]
    for k in range(1, most + 1):
        if variance <= 0:
            break
        reflection = (correlation[k] - coefficients @ correlation[k - 1 : 0 : -1]) / variance if k > 1 else correlation[1] / variance
        coefficients = np.append(coefficients - reflection * coefficients[::-1], reflection)
        variance *= 1.0 - reflection**2
        criterion = n * math.log(max(variance, 1e-300)) + 2.0 * k
        if criterion < best[0]:
            best = (criterion, coefficients, variance)
    return best[1], best[2]


def spectrum(coefficients: np.ndarray, variance: float, frequencies: np.ndarray) -> np.ndarray:
    """Power spectral density (variance per cycle per sample) of an autoregression, at frequencies in cycles per sample."""
    lags = np.arange(1, len(coefficients) + 1)
    denominator = 1.0 - np.exp(-2j * np.pi * np.outer(frequencies, lags)) @ coefficients
    return variance / np.abs(denominator) ** 2


def noise_in_normal(jacobian: np.ndarray, residual: np.ndarray) -> np.ndarray:
    """J' Omega J of one evenly sampled series: ``jacobian`` of shape ``(n, p)``, ``residual`` of shape ``(n,)``."""
    n = len(residual)
    coefficients, variance = autoregression(residual - residual.mean())
    length = 2 * n
    transformed = np.fft.rfft(jacobian, length, axis=0)
    density = spectrum(coefficients, variance, np.fft.rfftfreq(length))
    twice = np.full(len(density), 2.0)
    twice[0] = twice[-1] = 1.0
    return np.real((transformed.conj().T * (density * twice / length)) @ transformed)


def covariance(jacobians: list[np.ndarray], residuals: list[np.ndarray], parameters: int) -> np.ndarray:
    """Covariance of the estimates, shape ``(p, p)``, from the series of all channels and recordings (one array of each per series).

    Parameters that a direction moves along which no residual changes have infinite variance, all of them where there are no more samples
    than ``parameters``.
    """
    samples = sum(len(r) for r in residuals)
    if samples <= parameters:
        return np.diag(np.full(jacobians[0].shape[1], np.inf))
    normal = np.sum([j.T @ j for j in jacobians], axis=0)
    middle = np.sum([noise_in_normal(j, r) for j, r in zip(jacobians, residuals, strict=True)], axis=0)
    seen = np.diag(normal) > 0
    size = np.sqrt(np.where(seen, np.diag(normal), 1.0))
    values, vectors = np.linalg.eigh((normal / np.outer(size, size))[np.ix_(seen, seen)])
    flat = values <= 1e-14 * np.max(values, initial=0.0)
    inverse = (vectors[:, ~flat] / values[~flat]) @ vectors[:, ~flat].T
    result = np.full(normal.shape, 0.0)
    result[np.ix_(seen, seen)] = inverse @ (middle / np.outer(size, size))[np.ix_(seen, seen)] @ inverse
    result *= samples / (samples - parameters)
    result /= np.outer(size, size)
    moved = np.flatnonzero(seen)[np.any(np.abs(vectors[:, flat]) > 1e-3, axis=1)]
    unknown = np.union1d(np.flatnonzero(~seen), moved)
    result[unknown, unknown] = np.inf
    return result


def critical(samples: int, parameters: int) -> float:
    """Two-sided 95 % quantile of Student's distribution."""
    return float(scipy.special.stdtrit(max(samples - parameters, 1), 0.975))


def indistinct(jacobian: np.ndarray, names: list[str], sizes: np.ndarray, threshold: float = 0.1) -> list[Indistinct]:
    """Groups of parameters along whose common direction the response shrinks below ``threshold``.

    ``jacobian`` has shape ``(m, p)``; ``sizes``, shape ``(p,)``, are the parameters' sizes, over which directions are given.
    """
    length = np.linalg.norm(jacobian, axis=0)
    groups = [Indistinct((names[i],), (1.0,), 0.0) for i in np.flatnonzero(length == 0)]
    seen = np.flatnonzero(length > 0)
    if len(seen) < 2:
        return groups
    unit = jacobian[:, seen] / length[seen]
    values, vectors = scipy.linalg.eigh(unit.T @ unit)
    for value, vector in zip(values, vectors.T, strict=True):
        if math.sqrt(max(value, 0.0)) > threshold:
            break
        members = np.abs(vector) > 0.1 * np.max(np.abs(vector))
        moved = vector[members] / (length[seen] * sizes[seen])[members]
        moved /= np.linalg.norm(moved) * (np.sign(moved[np.argmax(np.abs(moved))]) or 1.0)
        group = tuple(names[i] for i in seen[members])
        groups.append(Indistinct(group, tuple(float(m) for m in moved), math.sqrt(max(value, 0.0))))
    return groups
