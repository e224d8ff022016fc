"""Tuning of gains by gradients through the rollout, from one start or several, within limits or without.

Objective and limits decide which search runs: ``unconstrained`` without limits, ``constrained`` within limits, and
``minimise_settling_time`` for the shortest settling time, or for one below a limit. A population may follow, since the
cost of a closed loop has several minima, and gradients lead to the nearest one.
"""

import math
from collections.abc import Callable, Mapping
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

from smajax.control.analysis.step_response import SETTLING_BAND
from smajax.control.tuning.constrained import constrained
from smajax.control.tuning.minimise_settling_time import (
    START_WEIGHTS,
    longest_settling,
    meet_settling_limit,
    settle_within_limits,
    settling_rank,
)
from smajax.control.tuning.objective import LIMITS, TERMS, make_objective
from smajax.control.tuning.population import evolve_near, evolve_population
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.search import BATCH, VIOLATION_TOLERANCE, GainSearch, rank
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS, unconstrained
from smajax.errors import InputError

# Smallest number of random points that are evaluated to choose several starts; chosen by trial.
_MIN_SCREENED = 16
# Number of points that are evaluated to find the best one of a search that was stopped: the last improvements of the
# local search that was running, and the ends of those before.
_LATEST_REACHED = 8
# Largest number of alternatives, and smallest ratio of the costs of two of them: they differ in gains that matter.
# Chosen by experiments/control/random_tuning_tasks.py.
_ALTERNATIVES = 16
_COST_RATIO = 1.03
# Populations of a search: none, over the box and near the best gains, or near the loop's own gains.
Populations = Literal["none", "all", "near"]


class TuningResult(NamedTuple):
    """Best gains of a search.

    Attributes:
        point: The point in the unit box, shape ``(p,)``.
        gains: Gains by name, internal units.
        terms: Terms by name (``objective.TERMS``), relative to those at the start.
        violations: Largest violation of each limit by name, dimensionless; at most 0 if the limit is kept.
        feasible: Whether all limits are kept.
        settling: Longest settling time of all jumps and members, s.
        rollouts: Number of rollouts.
        history: A row (rollouts; settling time in s, or sum of the weighted terms) for each improvement that keeps all
            limits.
        interrupted: Whether the search was stopped; the gains are then the best ones so far.
        alternatives: Other points that keep all limits and cost little more, the best first.
    """

    point: np.ndarray
    gains: dict[str, float]
    terms: dict[str, float]
    violations: dict[str, float]
    feasible: bool
    settling: float
    rollouts: int
    history: tuple[tuple[int, float], ...]
    interrupted: bool = False
    alternatives: tuple[np.ndarray, ...] = ()


def violation_rank(result: TuningResult) -> tuple[bool, float, float]:
    """Return the sort key of results that may violate limits: smaller is better.

    A settling limit counts after the others, and by the settling time: its violation is the error outside the band,
    which does not measure how late the loop settles.
    """
    violations = (v for name, v in result.violations.items() if name != "settling" and v > VIOLATION_TOLERANCE)
    return not result.feasible, sum(violations, 0.0), result.settling if "settling" in result.violations else 0.0


def cost_function(problem: TuningProblem, weights: Mapping[str, float]) -> Callable[[np.ndarray], float]:
    """Return the weighted terms that ``tune`` minimises as a function of a point, to compare searches.

    Args:
        problem: The tuning problem.
        weights: Weights of ``objective.TERMS`` by name.

    Returns:
        A function that maps a point of the unit box, shape ``(p,)``, to the cost; infinite where that is NaN.
    """
    search = GainSearch(problem, make_objective(weights, {}), lambda steps, cost: None)
    return lambda point: search.candidates(np.asarray(point)[None])[0].cost


def tune(
    problem: TuningProblem,
    weights: Mapping[str, float],
    limits: Mapping[str, float],
    *,
    settle: bool = False,
    population: Populations = "none",
    starts: int = 1,
    seed: int = 0,
    band: float = SETTLING_BAND,
    progress: Callable[[int, float], None] = lambda steps, cost: None,
) -> TuningResult:
    """Tune the gains from the loop's own ones and, with ``starts`` above 1, from the best of random gains.

    Args:
        problem: The tuning problem.
        weights: Weights of ``objective.TERMS`` by name.
        limits: Limits of ``objective.LIMITS`` by name, internal units.
        settle: Whether the settling time is minimised within the other limits, after a search that minimises the terms.
        population: Populations for the smallest terms: ``all`` after the other searches, ``near`` instead of them.
        starts: Number of starts.
        seed: Seed of the random starts.
        band: Settling band as a share of the jump.
        progress: Called with the number of rollouts so far and the cost of the last evaluated point; it may raise
            ``KeyboardInterrupt`` to stop the search.

    Returns:
        The best gains of all searches, or of what was searched until ``KeyboardInterrupt``; never worse than the
        loop's own.

    Raises:
        InputError: if there are neither weights nor ``settle``, or the reference has no jump to settle after.
        NumericsError: if no point has a finite cost.
    """
    _check_objective(problem, weights, settle)
    search = GainSearch(problem, make_objective(weights or START_WEIGHTS, limits, band), progress, settle)
    interrupted = False
    try:
        points = _starts(search, starts, seed)
        if settle:
            point = settle_within_limits(search, points)
        else:
            point = _minimise_terms(search, points, population)
            if limits.get("settling", math.inf) < math.inf:
                point = meet_settling_limit(search, point, points)
    except KeyboardInterrupt:
        point, interrupted = _best_so_far(search, settle), True
    terms, violations = search.evaluate(point[None])
    return TuningResult(
        point=point,
        gains={name: float(v) for name, v in problem.gains(point).items()},
        terms={t: float(v) for t, v in zip(TERMS, terms[0] / search.scale, strict=True)},
        violations={k: float(v) for k, v in zip(LIMITS, violations[0], strict=True) if k in limits},
        feasible=float(np.max(violations[0])) <= VIOLATION_TOLERANCE,
        settling=longest_settling(problem, point, band),
        rollouts=search.rollouts,
        history=tuple(search.history),
        interrupted=interrupted,
        alternatives=() if settle or not limits else _alternatives(search),
    )


def _check_objective(problem: TuningProblem, weights: Mapping[str, float], settle: bool) -> None:
    """Refuse a search without an objective."""
    if not weights and not settle:
        raise InputError(
            f"there is no objective: give a weight to one of {', '.join(TERMS)}, or minimise the settling time"
        )
    if settle and not np.any(np.asarray(problem.reference.jump_size)):
        raise InputError(
            "the reference never jumps and holds, so there is no settling time to minimise: choose tracking instead"
        )


def _minimise_terms(
    search: GainSearch, points: Float[np.ndarray, "starts gains"], population: Populations
) -> Float[np.ndarray, " gains"]:
    """The best point within the limits, if there are any, shape ``(p,)``."""
    if population == "near":
        evolved = evolve_near(search, points[0])
    else:
        point = (unconstrained if search.has_no_limits else constrained)(search, points)
        if population == "none":
            return point
        evolved = evolve_population(search, point)
    search.search_by_cobyqa(evolved.point, search.problem, *COBYQA_ALL_MEMBERS)
    return search.best().point


def _best_so_far(search: GainSearch, settle: bool) -> Float[np.ndarray, " gains"]:
    """The best point of a search that was stopped: one that all members evaluated, or one reached last.

    Points that were reached are evaluated with all members first, since a local search may use some of them only, or a
    cost that is not the objective.
    """
    start = search.evaluated[0]
    best = min(search.evaluated, key=rank)
    latest = list({point.tobytes(): point for point in search.reached[-_LATEST_REACHED:]}.values())
    candidates = [start, best, *(search.candidates(point[None])[0] for point in latest)]
    if not settle:
        return min(candidates, key=rank).point
    return min(candidates, key=lambda candidate: settling_rank(search, candidate)).point


def _alternatives(search: GainSearch) -> tuple[np.ndarray, ...]:
    """Points that all members evaluated and that keep all limits, in the order of their costs, which differ."""
    kept = sorted((c for c in search.evaluated if c.violation == 0.0), key=lambda c: c.cost)
    chosen = kept[:1]
    for candidate in kept:
        if candidate.cost >= _COST_RATIO * chosen[-1].cost:
            chosen.append(candidate)
    return tuple(candidate.point for candidate in chosen[1 : 1 + _ALTERNATIVES])


def _starts(search: GainSearch, starts: int, seed: int) -> Float[np.ndarray, "starts gains"]:
    """The loop's own gains and the best of many random points, by violations first, then by terms; shape ``(k, p)``."""
    own = search.problem.start[None]
    if starts <= 1:
        return own
    count = max(_MIN_SCREENED, BATCH * -(-starts // 2))
    points = np.random.default_rng(seed).uniform(size=(count, own.shape[1]))
    members = search.problem.single_member() if search.has_no_limits else search.problem
    candidates = sorted(search.candidates(points, members), key=rank)
    return np.vstack([own, *(candidate.point for candidate in candidates[: starts - 1])])
