"""Screening by the score test: what each effect would explain of a residual beyond the free parameters.

Notation: r is the residual over the noise, J its Jacobian with respect to the parameters that are free already, g its
derivative with respect to an effect's strength (its sensitivity), and Q an orthonormal basis of J. With g' = g - Q Q'g
and r' = r - Q Q'r, the expected strength is -g'r' / g'g', clipped to what is plausible, and the gain is the fall of
chi-squared, r'r, that it would bring. Source: rao1948 (the score test); saris1987 (the expected parameter change).
"""

import dataclasses
from collections.abc import Hashable, Mapping
from typing import TypeVar

import numpy as np
from jaxtyping import Float

from smajax.fitting.intervals import fit_autoregression

# Standard deviations by which a strength has to exceed the noise to count as detectable (two-sided probability 0.05 %):
# the figure of the prototype study of the diagnosis.
DETECTABLE = 3.5
# Singular values of the normalised Jacobian below this share of the largest are directions that the data do not
# determine; from the prototype study of the diagnosis.
_RANK_TOLERANCE = 1e-6
# Highest order of the autoregression by which a residual is whitened; chosen by trial.
_MAX_ORDER = 12
# Random samples of the null distribution: a p-value of 0.01 then has a standard error of 0.0016.
_DRAWS = 4000

Key = TypeVar("Key", bound=Hashable)


@dataclasses.dataclass(frozen=True)
class Score:
    """The score of one effect. Strengths are in units of the typical one.

    ``strength`` is the expected one, ``gain`` the fall of chi-squared that it would bring, ``absorbed_fraction`` the
    share of the squared sensitivity that free parameters can compensate, ``minimum_detectable_strength`` that which
    exceeds the noise ``DETECTABLE`` times, and ``sensitivity`` the projected sensitivity.
    """

    strength: float
    gain: float
    absorbed_fraction: float
    minimum_detectable_strength: float
    sensitivity: np.ndarray


def orthonormal_basis(jacobian: Float[np.ndarray, "m p"]) -> Float[np.ndarray, "m rank"]:
    """Return an orthonormal basis of a Jacobian's columns; directions of no influence are left out."""
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian[:, size > 0] / size[size > 0]
    if not scaled.shape[1]:
        return np.zeros((len(jacobian), 0))
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return u[:, s > _RANK_TOLERANCE * s[0]]


def project_out(basis: Float[np.ndarray, "m rank"], vector: Float[np.ndarray, " m"]) -> Float[np.ndarray, " m"]:
    """Return the part of a vector that is orthogonal to the basis."""
    return vector - basis @ (basis.T @ vector)


def score_test(
    basis: Float[np.ndarray, "m rank"],
    residual: Float[np.ndarray, " m"],
    sensitivity: Float[np.ndarray, " m"],
    plausible_range: tuple[float, float],
    absorbed_from: float,
) -> Score:
    """Score one effect against a residual.

    Args:
        basis: Orthonormal basis of the free parameters' Jacobian.
        residual: The residual over the noise, projected already.
        sensitivity: Derivative of the residual with respect to the strength.
        plausible_range: Plausible strengths, in the unit of the sensitivity.
        absorbed_from: Share of the squared sensitivity in the basis from which the effect counts as absorbed and gains
            nothing.

    Source: rao1948, with the strength clipped to its plausible range.
    """
    projected = project_out(basis, sensitivity)
    remaining, total = float(projected @ projected), float(sensitivity @ sensitivity)
    if total == 0.0 or not np.isfinite(total):
        return Score(0.0, 0.0, float("nan"), float("inf"), projected)
    if remaining <= (1.0 - absorbed_from) * total:
        return Score(0.0, 0.0, 1.0 - remaining / total, float("inf"), projected)
    strength = float(np.clip(-(projected @ residual) / remaining, *plausible_range))
    gain = -2.0 * strength * float(projected @ residual) - strength**2 * remaining
    detectable = DETECTABLE / float(np.sqrt(remaining))
    return Score(strength, max(gain, 0.0), 1.0 - remaining / total, detectable, projected)


def whiten(series: Float[np.ndarray, "n ..."], coefficients: Float[np.ndarray, " order"]) -> Float[np.ndarray, "n ..."]:
    """Filter a series along its first axis so that autoregressive noise with these coefficients becomes white."""
    white = np.array(series, dtype=float)
    for lag, coefficient in enumerate(coefficients, 1):
        white[lag:] -= coefficient * series[:-lag]
    return white


def noise_model(series: Float[np.ndarray, " n"]) -> tuple[Float[np.ndarray, " order"], float]:
    """Return the autoregressive coefficients of a residual's series, and the standard deviation of its innovations."""
    coefficients, variance = fit_autoregression(series - series.mean(), most=_MAX_ORDER)
    return coefficients, float(np.sqrt(max(variance, 1e-300)))


def p_value(
    sensitivities: Mapping[Key, np.ndarray],
    plausible_ranges: Mapping[Key, tuple[float, float]],
    largest: float,
    seed: int,
    draws: int = _DRAWS,
) -> float:
    """Return the probability that noise alone gives a largest gain of at least ``largest``."""
    return float(np.mean(null_max_distribution(sensitivities, plausible_ranges, seed, draws) >= largest))


def null_max_distribution(
    sensitivities: Mapping[Key, np.ndarray],
    plausible_ranges: Mapping[Key, tuple[float, float]],
    seed: int,
    draws: int = _DRAWS,
) -> Float[np.ndarray, " draws"]:
    """Sample the largest gain over all effects that white noise alone gives.

    The gains are simulated with the correlations of the sensitivities and clipped to the plausible ranges, so that a
    p-value from them holds for the whole catalogue, for alike effects and for effects of one sign.

    Args:
        sensitivities: Projected sensitivities of the effects.
        plausible_ranges: Plausible strengths, under the same keys.
        seed: Seed of the random samples.
        draws: Their number.
    """
    sensitivities = {key: vector for key, vector in sensitivities.items() if np.linalg.norm(vector) > 0}
    if not sensitivities:
        return np.full(draws, np.inf)
    sizes = np.array([np.linalg.norm(vector) for vector in sensitivities.values()])
    unit = np.column_stack(list(sensitivities.values())) / sizes
    correlation = unit.T @ unit
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(seed).standard_normal((draws, len(sizes))) @ root.T
    low = np.array([plausible_ranges[key][0] for key in sensitivities]) * sizes
    high = np.array([plausible_ranges[key][1] for key in sensitivities]) * sizes
    clipped = np.clip(z, low, high)
    return np.max(2.0 * clipped * z - clipped**2, axis=1)
