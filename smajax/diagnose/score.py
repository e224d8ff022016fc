"""Scores: what each effect would explain of a residual, to first order, beyond what the free parameters can absorb.

Notation: r is the residual over the noise, J its derivative by the parameters that are free already, g that by an effect's strength, and
Q an orthonormal basis of J. With g' = g - Q Q'g and r' = r - Q Q'r, the expected strength is -g'r' / g'g', clipped to what is plausible,
and the gain is the fall of r'r that it would bring. References: Rao's score test; expected parameter change of structural equation models.
"""

import dataclasses
from collections.abc import Mapping
from typing import Any

import numpy as np

from smajax.fit.uncertainty import autoregression

DETECTABLE = 3.5
CLASS = 0.9


@dataclasses.dataclass(frozen=True)
class Score:
    """One effect's score. Strengths are in units of the typical one; ``smallest`` is what could just be detected."""

    strength: float
    gain: float
    absorbed: float
    smallest: float
    column: np.ndarray


def basis(jacobian: np.ndarray) -> np.ndarray:
    """Orthonormal basis of a Jacobian's columns, shape ``(m, p)``; directions below 1e-6 of the largest are left out."""
    size = np.linalg.norm(jacobian, axis=0)
    scaled = jacobian[:, size > 0] / size[size > 0]
    if not scaled.shape[1]:
        return np.zeros((len(jacobian), 0))
    u, s, _ = np.linalg.svd(scaled, full_matrices=False)
    return u[:, s > 1e-6 * s[0]]


def project(q: np.ndarray, column: np.ndarray) -> np.ndarray:
    """What the basis leaves of a column."""
    return column - q @ (q.T @ column)


def score(q: np.ndarray, residual: np.ndarray, column: np.ndarray, plausible: tuple[float, float], absorbed_from: float) -> Score:
    """Scores one column against a residual that is projected already; ``plausible`` in the column's units.

    A column of which ``q`` holds more than the share ``absorbed_from`` gains nothing.
    """
    left = project(q, column)
    size, whole = float(left @ left), float(column @ column)
    if whole == 0.0 or not np.isfinite(whole):
        return Score(0.0, 0.0, float("nan"), float("inf"), left)
    if size <= (1.0 - absorbed_from) * whole:
        return Score(0.0, 0.0, 1.0 - size / whole, float("inf"), left)
    best = float(np.clip(-(left @ residual) / size, *plausible))
    gain = -2.0 * best * float(left @ residual) - best**2 * size
    return Score(best, max(gain, 0.0), 1.0 - size / whole, DETECTABLE / float(np.sqrt(size)), left)


def whiten(series: np.ndarray, coefficients: np.ndarray) -> np.ndarray:
    """A series (along the first axis) filtered so that autoregressive noise with these coefficients becomes white."""
    white = np.array(series, dtype=float)
    for lag, a in enumerate(coefficients, 1):
        white[lag:] -= a * series[:-lag]
    return white


def noise_model(series: np.ndarray) -> tuple[np.ndarray, float]:
    """Autoregressive coefficients and innovation's standard deviation of a residual's series."""
    coefficients, variance = autoregression(series - series.mean(), most=12)
    return coefficients, float(np.sqrt(max(variance, 1e-300)))


def p_value(
    columns: Mapping[str, np.ndarray], plausible: Mapping[str, tuple[float, float]], largest: float, seed: int, draws: int = 4000
) -> float:
    """Probability that noise alone gives a largest gain of at least ``largest``."""
    return float(np.mean(largest_by_noise(columns, plausible, seed, draws) >= largest))


def largest_by_noise(
    columns: Mapping[Any, np.ndarray], plausible: Mapping[Any, tuple[float, float]], seed: int, draws: int = 4000
) -> np.ndarray:
    """Largest gains that noise alone gives, shape ``(draws,)``: simulated with the columns' own correlations.

    Columns and plausible strengths have the same keys.
    """
    kept = {k: c for k, c in columns.items() if np.linalg.norm(c) > 0}
    if not kept:
        return np.full(draws, np.inf)
    sizes = np.array([np.linalg.norm(c) for c in kept.values()])
    unit = np.column_stack(list(kept.values())) / sizes
    correlation = unit.T @ unit
    values, vectors = np.linalg.eigh(correlation)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    z = np.random.default_rng(seed).standard_normal((draws, len(sizes))) @ root.T
    low = np.array([plausible[k][0] for k in kept]) * sizes
    high = np.array([plausible[k][1] for k in kept]) * sizes
    clipped = np.clip(z, low, high)
    return np.max(2.0 * clipped * z - clipped**2, axis=1)


def classes(columns: Mapping[str, np.ndarray], threshold: float = CLASS) -> list[set[str]]:
    """Effects that the data can hardly tell apart, by single linkage on the cosine between their projected columns."""
    groups: list[set[str]] = []
    unit = {k: c / np.linalg.norm(c) for k, c in columns.items() if np.linalg.norm(c) > 0}
    for key, column in unit.items():
        near = [g for g in groups if any(abs(float(column @ unit[other])) > threshold for other in g)]
        groups = [g for g in groups if g not in near]
        groups.append({key}.union(*near))
    return groups
