"""The score test of each effect: how much of a residual it would explain beyond the free parameters.

An effect has strength 0 in the current fit. The score test needs no refit with it, only the derivative at strength 0:

- r, shape ``(m,)``: the residual over the noise; J, shape ``(m, p)``: its Jacobian with respect to the free parameters.
- g, shape ``(m,)``: the sensitivity, the derivative of r with respect to the effect's strength.
- Q: an orthonormal basis of the columns of J (``orthonormal_basis``); P = I - Q Q^T removes everything that a change of
  the free parameters can explain (``project_out``).
- U = -(P g)^T (P r): the score. V = (P g)^T (P g): its variance for white noise of variance 1.
- s = U / V: the expected strength, clipped to its plausible range.
- 2 s U - s^2 V: the gain, the fall of chi-squared to first order. Without clipping it is the score statistic U^2 / V,
  which in white normal noise is chi-squared distributed with one degree of freedom if the effect is absent.

The largest gain over many effects, and over a grid of a shape parameter that has no influence at strength 0, does not
follow that distribution; ``null_max_distribution`` simulates its own.

Source: rao1948 (the score test); saris1987 (s, the expected parameter change); davies1977 (the largest over a grid).
"""

import dataclasses
from collections.abc import Hashable, Mapping
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from smajax.fitting.autoregression import fit_autoregression

# Number of standard errors from which a strength is detectable (two-sided probability 0.05 %). Chosen by
# trial.
DETECTABLE = 3.5
# Half width of a 95 % interval of the normal distribution, in standard deviations.
NORMAL_95 = 1.96
# Singular values of the normalised Jacobian below this share of the largest are directions that the data do not
# determine. Chosen by trial.
_RANK_TOLERANCE = 1e-6
# Highest order of the autoregression by which a residual is whitened; chosen by trial.
_MAX_ORDER = 12
# Number of random samples of the null distribution: a p-value of 0.01 then has a standard error of 0.0016.
_DRAWS = 4000

Key = TypeVar("Key", bound=Hashable)


@dataclasses.dataclass(frozen=True)
class Score:
    """The score of one effect. Strengths are in units of the typical strength.

    Attributes:
        strength: Expected strength.
        gain: Fall of chi-squared at the expected strength, to first order.
        absorbed_fraction: Share of the squared sensitivity that a change of the free parameters can compensate.
        minimum_detectable_strength: Strength that is ``DETECTABLE`` times its standard error.
        sensitivity: Projected sensitivity P g, shape ``(m,)``.
    """

    strength: float
    gain: float
    absorbed_fraction: float
    minimum_detectable_strength: float
    sensitivity: np.ndarray


def orthonormal_basis(jacobian: Float[np.ndarray, "m p"]) -> Float[np.ndarray, "m rank"]:
    """Return an orthonormal basis of a Jacobian's columns, without directions that the data do not determine.

    The columns are scaled to norm 1, and singular values below 1e-6 of the largest are left out.

    Args:
        jacobian: The Jacobian J of m samples and p parameters.
    """
    norms = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian[:, norms > 0] / norms[norms > 0]
    if not scaled.shape[1]:
        return np.zeros((len(jacobian), 0))
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return u[:, s > _RANK_TOLERANCE * s[0]]


def project_out(basis: Float[np.ndarray, "m rank"], vector: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Return the part of a vector that is orthogonal to an orthonormal basis.

    Args:
        basis: The basis Q.
        vector: The vector v.

    Returns:
        P v = v - Q Q^T v.
    """
    return vector - basis @ (basis.T @ vector)


def score_test(
    basis: Float[np.ndarray, "m rank"],
    residual: Float[np.ndarray, " m"],
    sensitivity: Float[np.ndarray, " m"],
    plausible_range: tuple[float, float],
    absorbed_from: float,
) -> Score:
    """Test whether the strength of one effect differs from 0, by the score of the residual.

    With the module's symbols, s = clip(U / V) and gain = 2 s U - s^2 V.

    Args:
        basis: Orthonormal basis Q of the free parameters' Jacobian.
        residual: Projected residual P r over the noise.
        sensitivity: Sensitivity g, the derivative of the residual with respect to the strength.
        plausible_range: Lowest and highest plausible strength, in units of the typical strength.
        absorbed_from: Share of the squared sensitivity in the basis from which the effect counts as absorbed. Its gain
            is 0 then, and no strength is detectable.

    Returns:
        The score.

    Source: rao1948, with the strength clipped to its plausible range.
    """
    projected = project_out(basis, sensitivity)
    variance, total = float(projected @ projected), float(sensitivity @ sensitivity)
    if total == 0.0 or not np.isfinite(total):
        return Score(0.0, 0.0, float("nan"), float("inf"), projected)
    absorbed_fraction = 1.0 - variance / total
    if variance <= (1.0 - absorbed_from) * total:
        return Score(0.0, 0.0, absorbed_fraction, float("inf"), projected)
    score = -float(projected @ residual)
    strength = float(np.clip(score / variance, *plausible_range))
    gain = 2.0 * strength * score - strength**2 * variance
    minimum_detectable_strength = DETECTABLE / float(np.sqrt(variance))
    return Score(strength, max(gain, 0.0), absorbed_fraction, minimum_detectable_strength, projected)


def half_width_95(minimum_detectable_strength: float) -> float:
    """Return the half width of the 95 % interval of a strength, in the unit of its minimum detectable strength."""
    return NORMAL_95 / DETECTABLE * minimum_detectable_strength


def whiten(series: Float[np.ndarray, "n ..."], coefficients: Float[np.ndarray, " order"]) -> Float[np.ndarray, "n ..."]:
    """Filter a series along its first axis so that autoregressive noise becomes white.

    With the coefficients a_k it is w_t = v_t - sum_k a_k v_(t-k); the first samples use the lags that exist.

    Args:
        series: The series v, shape ``(n, ...)``.
        coefficients: Autoregressive coefficients of the noise from lag 1.

    Returns:
        The filtered series w, of the same shape.
    """
    white = np.array(series, dtype=float)
    for lag, coefficient in enumerate(coefficients, 1):
        white[lag:] -= coefficient * series[:-lag]
    return white


def noise_model(series: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " order"], float]:
    """Fit an autoregression to a series about its mean.

    Args:
        series: A residual of one channel.

    Returns:
        The coefficients from lag 1, of an order up to 12, and the standard deviation of the innovations.
    """
    coefficients, variance = fit_autoregression(series - series.mean(), most=_MAX_ORDER)
    return coefficients, float(np.sqrt(max(variance, 1e-300)))


def p_value(
    sensitivities: Mapping[Key, np.ndarray],
    plausible_ranges: Mapping[Key, tuple[float, float]],
    largest: float,
    seed: int,
    draws: int = _DRAWS,
) -> float:
    """Compute the probability that the largest gain over all effects reaches a value by white noise alone.

    Args:
        sensitivities: Projected sensitivities of the effects, each of shape ``(m,)``.
        plausible_ranges: Plausible strengths by the same keys.
        largest: The value.
        seed: Seed of the random samples.
        draws: Number of random samples.
    """
    return float(np.mean(null_max_distribution(sensitivities, plausible_ranges, seed, draws) >= largest))


def null_max_distribution(
    sensitivities: Mapping[Key, np.ndarray],
    plausible_ranges: Mapping[Key, tuple[float, float]],
    seed: int,
    draws: int = _DRAWS,
) -> Float[np.ndarray, " draws"]:
    """Sample the distribution of the largest gain over all effects under white noise of variance 1.

    The scores U_k / sqrt(V_k) are drawn from a normal distribution with the correlations of the sensitivities, and the
    strengths are clipped to their plausible ranges. A p-value from the samples therefore holds for the whole catalogue,
    with collinear effects and with effects of one sign.

    Args:
        sensitivities: Projected sensitivities of the effects, each of shape ``(m,)``.
        plausible_ranges: Plausible strengths by the same keys.
        seed: Seed of the random samples.
        draws: Number of random samples.

    Returns:
        The largest gain of each sample, shape ``(draws,)``; infinite if no effect has a sensitivity.
    """
    sensitivities = {key: vector for key, vector in sensitivities.items() if np.linalg.norm(vector) > 0}
    if not sensitivities:
        return np.full(draws, np.inf)
    norms = np.array([np.linalg.norm(vector) for vector in sensitivities.values()])
    unit = np.column_stack(list(sensitivities.values())) / norms
    correlation = unit.T @ unit
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(seed).standard_normal((draws, len(norms))) @ root.T
    low = np.array([plausible_ranges[key][0] for key in sensitivities]) * norms
    high = np.array([plausible_ranges[key][1] for key in sensitivities]) * norms
    clipped = np.clip(z, low, high)
    return np.max(2.0 * clipped * z - clipped**2, axis=1)
