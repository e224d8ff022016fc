"""Differential evolution over the box and near the best point, for limits that hold for several members."""

import math

import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax.control.tuning.search import Candidate, GainSearch, rank
from smajax.numerics.evolution import evolve_in_unit_box

# Size of the populations, and number of their generations; chosen by experiments/control/random_tuning_tasks.py.
_POPULATION = 48
_NEAR_POPULATION = 32
_GENERATIONS = 30
# Number of points that are drawn for them: Sobol sequences are even for powers of 2 only.
_SPREAD = 64
# Number of the best points so far in the first population: with more of them, and of points near them, it converges to
# the minimum that the local searches have found. Chosen by the same experiment.
_BEST = 2
# Distance from the best point within which the second population begins, in sizes of the box: limits that hold for all
# members have a jagged edge, along which the first one finds little. Chosen by the same experiment.
_NEAR = 0.3
# Upper bound of the cost, and penalty of a violation in the logarithm of the cost: larger than the logarithm of any
# bounded cost.
_MAX_COST = 1e6
_VIOLATION_PENALTY = 1e3


def evolve_population(search: GainSearch, point: Float[np.ndarray, " gains"]) -> Candidate:
    """Run differential evolution with all members, over the box and then near the best point.

    Gains that suit one member may violate the limits of another, and the region of gains that keep the limits of all
    members may be too small for gradients and quadratic models to find it.

    Args:
        search: The search; the best points that it evaluated are part of the first population.
        point: Start in the unit box, shape ``(p,)``.

    Returns:
        The best candidate of the whole search.
    """
    best_points = [candidate.point for candidate in sorted(search.evaluated, key=rank)[:_BEST]]
    spread = scipy.stats.qmc.Sobol(len(point), rng=0).random(_SPREAD)
    _evolve(search, np.vstack([point, *best_points, spread])[:_POPULATION])
    return evolve_near(search, min(search.evaluated, key=rank).point)


def evolve_near(search: GainSearch, point: Float[np.ndarray, " gains"]) -> Candidate:
    """Run differential evolution with all members from a population near a point.

    Args:
        search: The search.
        point: The point of the unit box, shape ``(p,)``; it is one of the population.

    Returns:
        The best candidate of the whole search.
    """
    spread = scipy.stats.qmc.Sobol(len(point), rng=1).random(_SPREAD)[:_NEAR_POPULATION]
    first = np.clip(point + _NEAR * (2.0 * spread - 1.0), 0.0, 1.0)
    first[0] = point
    _evolve(search, first)
    return min(search.evaluated, key=rank)


def _evolve(search: GainSearch, first: Float[np.ndarray, "points gains"]) -> None:
    """Evolve a population; the search records what it evaluates."""

    def cost(points: np.ndarray) -> np.ndarray:
        candidates = search.candidates(points.T)
        search.progress(search.rollouts, min(candidates, key=rank).cost)
        return np.array([_log_cost(candidate) for candidate in candidates])

    evolve_in_unit_box(cost, first, _GENERATIONS, seed=0)


def _log_cost(candidate: Candidate) -> float:
    """Logarithm of the bounded cost, plus a penalty if a limit is violated."""
    penalty = _VIOLATION_PENALTY * (1.0 + candidate.violation) if candidate.violation else 0.0
    return math.log(min(max(candidate.cost, 1e-300), _MAX_COST)) + penalty
