"""Gains within limits: an augmented Lagrangian, then quadratic models, and for several members a population.

Source: nocedal2006, algorithm 17.4, for the augmented Lagrangian.
"""

import math

import jax.numpy as jnp
import numpy as np
import scipy.stats

from smajax.control.tuning.population import evolve_population
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.search import BATCH, Candidate, GainSearch, limit_violations, rank
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS, unconstrained

# All constants were chosen by trial on the loops of tests/unit/control/test_tuning.py, which holds them
# (test_within_a_limit_nothing_on_a_grid_is_better).

# A violation of order one: from a point beyond it the augmented Lagrangian does not start.
_GROSS_VIOLATION = 1.0
# Largest number of updates of the multipliers.
_UPDATES = 8
# Violation, over the last one, above which the penalty grows, and by which factor.
_TOO_SLOW = 0.5
_PENALTY_GROWTH = 4.0
# Steps of L-BFGS-B between two updates, and the factor of the coordinates, which bounds the first step.
_STEPS = 10
_COORDINATE_SCALE = 20.0
# Largest distance between two updates, in sizes of the box: gains that go further may end where nothing moves, and stay
# there.
_MAX_DISTANCE = 0.06
# Points of the box that one member evaluates, to start elsewhere.
_SCAN = 64
# Cost, over the best one, below which a point elsewhere is worth a search though the limits do not bind.
_PROMISING = 1.5
# First radius, last radius and evaluations of COBYQA with one member.
_COBYQA_SINGLE = (0.15, 0.004, 80)


def augmented_lagrangian(search: GainSearch, points: np.ndarray) -> np.ndarray:
    """Minimise the terms within the limits, from where they are smallest without limits, to one member at least.

    If that point violates a limit, an augmented Lagrangian follows; from the best known point if the violation is
    gross. COBYQA follows, since the limit of a loop that turns unstable, or does not move, has no useful slope. Several
    members whose limits conflict are led by a population as well. If no limit is violated, several starts are used all
    the same where another point of the box looks better.

    Args:
        search: The search.
        points: Starts, shape ``(k, p)``, the search's own start first.

    Returns:
        The best point, shape ``(p,)``.
    """
    spent = search.rollouts
    without_limits = GainSearch(
        search.problem.single_member(),
        search.objective_without_limits,
        lambda count, cost: search.progress(spent + count, cost),
    )
    point = unconstrained(without_limits, points)
    search.rollouts += without_limits.rollouts
    tried = search.candidates(np.vstack([point, points]))
    best = min(tried, key=rank)
    best = _update_multipliers(search, best.point if tried[0].violation > _GROSS_VIOLATION else point, tried[0], best)
    limits_do_not_bind = tried[0].violation == 0.0
    if limits_do_not_bind and len(points) == 1:
        return best.point
    # Another start: the best point within the limits may be a loop that does not move, which no local search leaves.
    single = search.problem.single_member(_hardest_member(search, points[0]))
    other = _scan(search, single, len(point))
    if not limits_do_not_bind or rank(other) < (0.0, _PROMISING * best.cost):
        starts = {p.tobytes(): p for p in (best.point, tried[0].point, points[0], other.point)}.values()
        of_single = min((search.search_by_cobyqa(p, single, *_COBYQA_SINGLE) for p in starts), key=rank)
        best = _refined_by_all(search, of_single.point, best)
        if search.problem.count > 1:
            best = _refined_by_all(search, evolve_population(search, of_single.point).point, best)
    return best.point


def _update_multipliers(search: GainSearch, point: np.ndarray, first: Candidate, best: Candidate) -> Candidate:
    """Searches and updates of multipliers and penalty in turn; the best candidate.

    ``first`` is the candidate that is smallest without limits: if it keeps them, one evaluation is enough.
    """
    multipliers, last_violation, mu = search.zero_multipliers, math.inf, 1.0
    for update in range(_UPDATES):
        candidate = search.candidates(point[None])[0]
        if rank(candidate) < rank(best):
            best = candidate
            if candidate.violation == 0.0:
                search.history.append((search.rollouts, candidate.cost))
        is_start = update == 0 and first.violation != 0.0
        if candidate.violation == 0.0 and not is_start and not bool(jnp.any(multipliers > 0.0)):
            break
        if candidate.violation > _TOO_SLOW * last_violation:
            mu *= _PENALTY_GROWTH
        last_violation = candidate.violation
        violations = limit_violations(search.problem, jnp.asarray(point), search.objective)
        multipliers = jnp.maximum(multipliers + mu * violations, 0.0)
        search.rollouts += search.problem.count
        point = search.descend_by_lbfgs(
            point, search.objective, multipliers, mu, _STEPS, _COORDINATE_SCALE, _MAX_DISTANCE
        ).point
    return best


def _scan(search: GainSearch, single: TuningProblem, size: int) -> Candidate:
    """The best of points in the middle of equal cells of the box, with one member."""
    points = scipy.stats.qmc.Sobol(size, scramble=False).random(_SCAN) + 0.5 / _SCAN
    batches = (search.candidates(points[k : k + BATCH], single) for k in range(0, _SCAN, BATCH))
    return min((candidate for batch in batches for candidate in batch), key=rank)


def _refined_by_all(search: GainSearch, point: np.ndarray, best: Candidate) -> Candidate:
    """The better of ``best`` and what COBYQA finds from a point with all members."""
    return min(best, search.search_by_cobyqa(point, search.problem, *COBYQA_ALL_MEMBERS), key=rank)


def _hardest_member(search: GainSearch, point: np.ndarray) -> int:
    """The member with the largest violation at a point: gains that are good for it are good for most others."""
    if search.problem.count == 1:
        return 0
    search.rollouts += search.problem.count
    violations = np.asarray(limit_violations(search.problem, jnp.asarray(point), search.objective))
    largest = np.max(violations, axis=(1, 2))
    return int(np.argmax(np.nan_to_num(largest, nan=np.inf)))
