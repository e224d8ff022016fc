"""Confidence intervals of least-squares estimates under autocorrelated noise.

Least squares with the Jacobian J and the residual e has the covariance

    Cov = H^-1 (J' Omega J) H^-1,    H = J' J,    J' Omega J = sum_s sum_t J_s' R(s - t) J_t

where Omega is the covariance of the noise and R its autocovariance. If Omega is taken as white, intervals are several
times too narrow where neighbouring samples err together, as they do behind any filter or where the model lacks an
effect. Here R comes from an autoregressive model of each channel's residual (``smajax.fitting.autoregression``), and
the double sum is computed over frequencies: the power of J's columns times the spectrum of that model.

Source: morelli1995 (covariance under coloured residuals), akaike1974 and levinson1946 (autoregression).
"""

import numpy as np
from jaxtyping import Float

from smajax.fitting.autoregression import autoregressive_spectrum, fit_autoregression

# Eigenvalues of H (columns of length 1) below this share of the largest are rounding: the residual does not change
# along that direction.
_FLAT_EIGENVALUE = 1e-14
# Share of a flat direction from which a parameter takes part in it: above rounding, below any real share.
_MEMBER_SHARE = 1e-3
# Probability below the upper end of a two-sided 95 % interval.
_UPPER_PROBABILITY = 0.975


def covariance_under_autocorrelation(
    jacobians: list[np.ndarray], residuals: list[np.ndarray], parameters: int
) -> Float[np.ndarray, "p p"]:
    """Compute the covariance of least-squares estimates whose residual is autocorrelated.

        Cov = n / (n - p) H^-1 (sum_k J_k' Omega_k J_k) H^-1,    H = sum_k J_k' J_k

    with one term k for the series of each channel and recording, n samples in all, and p free parameters.

    Args:
        jacobians: The Jacobian J_k (n_k, p) of each series.
        residuals: The residual (n_k,) of each series, evenly sampled.
        parameters: Number of free parameters.

    Returns:
        The covariance (p, p). The variance is infinite for parameters of a direction along which no residual changes,
        and for all of them where there are no more samples than parameters.

    Source: morelli1995.
    """
    samples = sum(len(r) for r in residuals)
    if samples <= parameters:
        return np.diag(np.full(jacobians[0].shape[1], np.inf))
    normal = np.sum([j.T @ j for j in jacobians], axis=0)
    score = np.sum([score_covariance(j, r) for j, r in zip(jacobians, residuals, strict=True)], axis=0)
    # Columns of length 1, so that eigenvalues of different parameters compare.
    effective = np.diag(normal) > 0
    size = np.sqrt(np.where(effective, np.diag(normal), 1.0))
    block = np.ix_(effective, effective)
    values, vectors = np.linalg.eigh((normal / np.outer(size, size))[block])
    flat = values <= _FLAT_EIGENVALUE * np.max(values, initial=0.0)
    inverse = (vectors[:, ~flat] / values[~flat]) @ vectors[:, ~flat].T
    covariance = np.full(normal.shape, 0.0)
    covariance[block] = inverse @ (score / np.outer(size, size))[block] @ inverse
    covariance *= samples / (samples - parameters)
    covariance /= np.outer(size, size)
    in_flat = np.flatnonzero(effective)[np.any(np.abs(vectors[:, flat]) > _MEMBER_SHARE, axis=1)]
    undetermined = np.union1d(np.flatnonzero(~effective), in_flat)
    covariance[undetermined, undetermined] = np.inf
    return covariance


def unit_noise_variances(jacobian: Float[np.ndarray, "m p"]) -> Float[np.ndarray, " p"]:
    """Compute the variances of estimates under white noise of variance 1, the diagonal of (J' J)^-1.

    A cost that is a sum of squares rises by d^2 / v_i to second order if parameter i is held at a distance d from its
    estimate and the others are fitted again.

    Args:
        jacobian: Jacobian J (m, p) of the residual.

    Returns:
        The variances v (p,).
    """
    size = np.linalg.norm(jacobian, axis=0)
    size = np.where(size > 0.0, size, 1.0)
    return np.sum(np.linalg.pinv(jacobian / size) ** 2, axis=1) / size**2


def score_covariance(jacobian: Float[np.ndarray, "n p"], residual: Float[np.ndarray, " n"]) -> Float[np.ndarray, "p p"]:
    """Compute the covariance J' Omega J of the score J' e of one evenly sampled series.

        J' Omega J = sum_f conj(J(f)) S(f) J(f)

    with the discrete Fourier transform J(f) of the columns, padded by zeros, and the spectrum S of the residual's
    autoregression.

    Args:
        jacobian: Jacobian J (n, p).
        residual: Residual e (n,).

    Returns:
        The covariance (p, p).
    """
    n = len(residual)
    coefficients, variance = fit_autoregression(residual - residual.mean())
    length = 2 * n
    transformed = np.fft.rfft(jacobian, length, axis=0)
    density = autoregressive_spectrum(coefficients, variance, np.fft.rfftfreq(length))
    # The real transform has each pair of frequencies +f and -f once, and the two frequencies at the ends alone.
    multiplicity = np.full(len(density), 2.0)
    multiplicity[0] = multiplicity[-1] = 1.0
    return np.real((transformed.conj().T * (density * multiplicity / length)) @ transformed)


def confidence_half_widths(
    covariance: Float[np.ndarray, "p p"], samples: int, parameters: int
) -> Float[np.ndarray, " p"]:
    """Compute the half-widths of 95 % intervals from the covariance of the estimates.

    Args:
        covariance: Covariance (p, p), see ``covariance_under_autocorrelation``.
        samples: Number of samples of all series.
        parameters: Number of free parameters.

    Returns:
        Student's quantile times the standard errors, in the estimates' units; infinite or NaN as the variances are.
    """
    return student_quantile(samples, parameters) * np.sqrt(np.diag(covariance))


def student_quantile(samples: int, parameters: int) -> float:
    """Return the two-sided 95 % quantile of Student's distribution.

    Args:
        samples: Number of samples.
        parameters: Number of free parameters; their difference, at least 1, is the degrees of freedom.
    """
    from scipy.special import stdtrit  # slow to import

    return float(stdtrit(max(samples - parameters, 1), _UPPER_PROBABILITY))
