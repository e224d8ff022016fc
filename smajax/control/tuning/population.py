"""Differential evolution from the best evaluated points, for limits that hold for several members."""

import math

import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax.control.tuning.search import BATCH, Candidate, GainSearch, rank
from smajax.numerics.evolution import evolve_in_unit_box

# Size of the population, and number of generations; test_a_population_finds_gains_that_keep_all_limits of
# tests/unit/control/test_tuning.py holds the number of evaluations.
_POPULATION = 32
_GENERATIONS = 15
# Largest distance from the start, in sizes of the box, of the points that are drawn near it; chosen by trial.
_NEAR = 0.15
# Upper bound of the cost, and penalty of a violation in the logarithm of the cost: larger than the logarithm of any
# bounded cost.
_MAX_COST = 1e6
_VIOLATION_PENALTY = 1e3


def evolve_population(search: GainSearch, point: Float[np.ndarray, " gains"]) -> Candidate:
    """Run differential evolution with all members, and return the best candidate of the whole search.

    Gains that suit one member may violate the limits of another, and the region of gains that keep the limits of all
    members may be too small for gradients and quadratic models to find it.

    Args:
        search: The search; the best points that it evaluated are part of the first population.
        point: Start in the unit box, shape ``(p,)``.
    """
    best_points = [candidate.point for candidate in sorted(search.evaluated, key=rank)[: _POPULATION // 4]]
    spread = scipy.stats.qmc.Sobol(len(point), rng=0).random(_POPULATION)
    near = point + _NEAR * (2.0 * spread[::2] - 1.0)
    first = np.clip(np.vstack([point, *best_points, near, spread])[:_POPULATION], 0.0, 1.0)

    def cost(points: np.ndarray) -> np.ndarray:
        candidates = [c for k in range(0, points.shape[1], BATCH) for c in search.candidates(points.T[k : k + BATCH])]
        return np.array([_log_cost(candidate) for candidate in candidates])

    evolve_in_unit_box(cost, first, _GENERATIONS, seed=0)
    return min(search.evaluated, key=rank)


def _log_cost(candidate: Candidate) -> float:
    """Logarithm of the bounded cost, plus a penalty if a limit is violated."""
    penalty = _VIOLATION_PENALTY * (1.0 + candidate.violation) if candidate.violation else 0.0
    return math.log(min(max(candidate.cost, 1e-300), _MAX_COST)) + penalty
