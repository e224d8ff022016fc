"""Gains within limits: an augmented Lagrangian, then quadratic models, and for several members a population.

Source: nocedal2006, algorithm 17.4, for the augmented Lagrangian.
"""

import math

import jax.numpy as jnp
import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax.control.tuning.population import evolve_population
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.search import BATCH, Candidate, GainSearch, limit_violations, rank
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS, unconstrained

# All constants were chosen by trial on the loops of tests/unit/control/test_tuning.py, which holds them
# (test_within_a_limit_nothing_on_a_grid_is_better).

# Largest violation of a point at which the augmented Lagrangian starts: one of order one.
_GROSS_VIOLATION = 1.0
# Largest number of updates of the multipliers. Chosen by trial.
_UPDATES = 8
# Ratio of a violation to the previous one above which the penalty grows, and the factor by which it grows.
_TOO_SLOW = 0.5
_PENALTY_GROWTH = 4.0
# Largest number of steps of L-BFGS-B between two updates, and the factor of the coordinates, which bounds the first
# step.
_STEPS = 10
_COORDINATE_SCALE = 20.0
# Largest change of the point between two updates, in sizes of the box: after larger changes the search may stay at
# gains so small that the loop does not move.
_MAX_DISTANCE = 0.06
# Number of points of the box that one member evaluates to find another start.
_SCAN = 64
# Ratio of a cost to the best one below which another start is searched from although the limits do not bind.
_PROMISING = 1.5
# First radius, last radius and largest number of evaluations of COBYQA with one member.
_COBYQA_SINGLE = (0.15, 0.004, 80)


def augmented_lagrangian(search: GainSearch, points: Float[np.ndarray, "starts gains"]) -> Float[np.ndarray, " gains"]:
    """Minimise the terms within the limits.

    A search without limits, with a single member, comes first. If its point violates a limit, an augmented Lagrangian
    follows; if the violation is large, it starts from the best point so far. COBYQA follows, since the limits of a loop
    that becomes unstable, or does not move, have no useful gradient. With several members, differential evolution
    (``population``) follows as well. If no limit is violated and several starts are allowed, COBYQA is used only if a
    scan of the box finds a promising point.

    Args:
        search: The search.
        points: Starts in the unit box, shape ``(k, p)``, the search's own start first.

    Returns:
        The best point, shape ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
    """
    previous_rollouts = search.rollouts
    without_limits = GainSearch(
        search.problem.single_member(),
        search.objective_without_limits,
        lambda count, cost: search.progress(previous_rollouts + count, cost),
        reached=search.reached,
    )
    point = unconstrained(without_limits, points)
    search.rollouts += without_limits.rollouts
    candidates = search.candidates(np.vstack([point, points]))
    first, best = candidates[0], min(candidates, key=rank)
    best = _update_multipliers(search, best.point if first.violation > _GROSS_VIOLATION else point, first, best)
    limits_do_not_bind = first.violation == 0.0
    if limits_do_not_bind and len(points) == 1:
        return best.point
    # Another start: the best point within the limits may be a loop that does not move, which no local search leaves.
    single = search.problem.single_member(_hardest_member(search, points[0]))
    other = _scan(search, single, len(point))
    if not limits_do_not_bind or rank(other) < (0.0, _PROMISING * best.cost):
        starts = {p.tobytes(): p for p in (best.point, first.point, points[0], other.point)}.values()
        best_of_single = min((search.search_by_cobyqa(p, single, *_COBYQA_SINGLE) for p in starts), key=rank)
        best = _refine_with_all_members(search, best_of_single.point, best)
        if search.problem.count > 1:
            best = _refine_with_all_members(search, evolve_population(search, best_of_single.point).point, best)
    return best.point


def _update_multipliers(search: GainSearch, point: np.ndarray, first: Candidate, best: Candidate) -> Candidate:
    """The best candidate of searches that alternate with updates of multipliers and penalty.

    ``first`` is the minimum without limits: if it keeps them, one evaluation is enough.
    """
    multipliers, last_violation, penalty = search.zero_multipliers, math.inf, 1.0
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
            penalty *= _PENALTY_GROWTH
        last_violation = candidate.violation
        violations = limit_violations(search.problem, jnp.asarray(point), search.objective)
        multipliers = jnp.maximum(multipliers + penalty * violations, 0.0)
        search.rollouts += search.problem.count
        point = search.descend_by_lbfgs(
            point, search.objective, multipliers, penalty, _STEPS, _COORDINATE_SCALE, _MAX_DISTANCE
        ).point
    return best


def _scan(search: GainSearch, single: TuningProblem, size: int) -> Candidate:
    """The best of ``_SCAN`` points that cover the box evenly, with one member."""
    points = scipy.stats.qmc.Sobol(size, scramble=False).random(_SCAN) + 0.5 / _SCAN
    batches = (search.candidates(points[k : k + BATCH], single) for k in range(0, _SCAN, BATCH))
    return min((candidate for batch in batches for candidate in batch), key=rank)


def _refine_with_all_members(search: GainSearch, point: np.ndarray, best: Candidate) -> Candidate:
    """The better of ``best`` and the result of COBYQA from a point with all members."""
    return min(best, search.search_by_cobyqa(point, search.problem, *COBYQA_ALL_MEMBERS), key=rank)


def _hardest_member(search: GainSearch, point: np.ndarray) -> int:
    """Number of the member with the largest violation at a point; gains that suit it suit most others."""
    if search.problem.count == 1:
        return 0
    search.rollouts += search.problem.count
    violations = np.asarray(limit_violations(search.problem, jnp.asarray(point), search.objective))
    largest = np.max(violations, axis=(1, 2))
    return int(np.argmax(np.nan_to_num(largest, nan=np.inf)))
