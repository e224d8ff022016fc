"""Differential evolution from the best evaluated points, for limits that several members have to keep."""

import math

import numpy as np
import scipy.optimize
import scipy.stats

from smajax.control.tuning.search import BATCH, Candidate, GainSearch, rank

# Size of the population, and its generations; test_a_population_finds_what_keeps_the_limits_of_all of
# tests/unit/control/test_tuning.py holds the number of evaluations.
_POPULATION = 32
_GENERATIONS = 15
# Largest distance of the points that are drawn near the start, in sizes of the box; chosen by trial.
_NEAR = 0.15
# Largest cost, and what any violated limit costs: more than the logarithm of any cost.
_MAX_COST = 1e6
_VIOLATED = 1e3


def evolve_population(search: GainSearch, point: np.ndarray) -> Candidate:
    """Return the best candidate of a population, with all members.

    Gains that are good for one member violate limits of another, and those that keep the limits of all may lie in
    regions that are too small for gradients and quadratic models.

    Args:
        search: The search; the best points that it evaluated are part of the first population.
        point: Start, shape ``(p,)``.
    """
    known = [candidate.point for candidate in sorted(search.evaluated, key=rank)[: _POPULATION // 4]]
    spread = scipy.stats.qmc.Sobol(len(point), rng=0).random(_POPULATION)
    near = point + _NEAR * (2.0 * spread[::2] - 1.0)
    first = np.clip(np.vstack([point, *known, near, spread])[:_POPULATION], 0.0, 1.0)

    def cost(points: np.ndarray) -> np.ndarray:
        candidates = [c for k in range(0, points.shape[1], BATCH) for c in search.candidates(points.T[k : k + BATCH])]
        return np.array([_log_cost(candidate) for candidate in candidates])

    scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * len(point),
        init=first,  # pyright: ignore[reportArgumentType]
        maxiter=_GENERATIONS,
        tol=0.0,
        polish=False,
        rng=0,
        vectorized=True,
        updating="deferred",
    )
    return min(search.evaluated, key=rank)


def _log_cost(candidate: Candidate) -> float:
    penalty = _VIOLATED * (1.0 + candidate.violation) if candidate.violation else 0.0
    return math.log(min(max(candidate.cost, 1e-300), _MAX_COST)) + penalty
