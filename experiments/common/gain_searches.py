"""Searches for gains without gradients, to compare with ``tune``.

They have the same objective and the same compiled rollouts, and a larger budget.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy.optimize

from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.tune import TuningResult, cost_function


class SearchResult(NamedTuple):
    """The result of a search without gradients.

    Attributes:
        point: The best point.
        cost: Its cost over that of the reference.
        reached: Rollouts until within 1 % of the reference; ``None`` if never.
        cost_at_equal_rollouts: Best cost over the reference's after as many rollouts as the reference took.
        cost_at_equal_time: Best cost over the reference's after as many seconds.
    """

    point: np.ndarray
    cost: float
    reached: int | None
    cost_at_equal_rollouts: float = np.inf
    cost_at_equal_time: float = np.inf


def differential_evolution(
    problem: TuningProblem, weights: Mapping[str, float], reference: TuningResult, budget: int, seconds: float = 0.0
) -> SearchResult:
    """Search by SciPy's differential evolution (storn1997).

    Args:
        problem: The tuning problem.
        weights: Weights of the objective's terms.
        reference: Result of the search by gradients.
        budget: Largest number of rollouts.
        seconds: Wall time that the reference took.
    """
    size = 15 * len(problem.names)
    options = {
        "popsize": 15,
        "maxiter": max(budget // (size * problem.count) - 1, 1),
        "rng": 0,
        "polish": False,
        "tol": 0.0,
    }
    bounds = [(0.0, 1.0)] * len(problem.names)
    return _run_search(
        problem,
        weights,
        reference,
        seconds,
        lambda cost: scipy.optimize.differential_evolution(cost, bounds, **options),
    )


def evolve_single_member(
    problem: TuningProblem, weights: Mapping[str, float], reference: TuningResult, budget: int
) -> int | None:
    """Count the rollouts until a population that is warm-started by one member is within 1 % of the reference.

    Args:
        problem: The tuning problem; differential evolution sees its first member only, as the reference does at first.
        weights: Weights of the objective's terms.
        reference: Result of the search by gradients.
        budget: Largest number of rollouts.

    Returns:
        The number of rollouts, ``None`` if it is never reached.
    """
    single_cost = cost_function(problem.single_member(), weights)
    full_cost = cost_function(problem, weights)
    reference_cost, best, rollouts, reached_after = full_cost(reference.point), np.inf, 0, None

    def cost(x: np.ndarray) -> float:
        nonlocal best, rollouts, reached_after
        rollouts += 1
        value = single_cost(point := np.clip(x, 0.0, 1.0))
        if value < best and reached_after is None:
            best, rollouts = value, rollouts + problem.count
            reached_after = rollouts if full_cost(point) <= 1.01 * reference_cost else None
        return value

    size = 15 * len(problem.names)
    scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * len(problem.names),
        popsize=15,
        maxiter=max(budget // size - 1, 1),
        rng=0,
        polish=False,
        tol=0.0,
        callback=lambda intermediate_result: reached_after is not None,
    )
    return reached_after


def nelder_mead(
    problem: TuningProblem, weights: Mapping[str, float], reference: TuningResult, budget: int, seconds: float = 0.0
) -> SearchResult:
    """Search by Nelder and Mead's simplex from the start gains.

    Args:
        problem: The tuning problem.
        weights: Weights of the objective's terms.
        reference: Result of the search by gradients.
        budget: Largest number of rollouts.
        seconds: Wall time that the reference took.
    """
    return _run_search(
        problem,
        weights,
        reference,
        seconds,
        lambda cost: scipy.optimize.minimize(
            cost, problem.start, method="Nelder-Mead", options={"maxfev": budget // problem.count}
        ),
    )


def verdict_under_budget(holds: bool, quick: bool) -> bool | None:
    """Return whether a claim about twenty times our rollouts holds; a smaller budget can refute it, but not show it."""
    return None if quick and holds else holds


def rollouts_to_optimum(reference: TuningResult) -> int:
    """Return the rollouts after which the reference search was within 1 % of its final cost."""
    return next(count for count, cost in reference.history if cost <= 1.01 * reference.history[-1][1])


def _run_search(
    problem: TuningProblem, weights: Mapping[str, float], reference: TuningResult, seconds: float, search: Callable
) -> SearchResult:
    """Run a search and record when it reaches the reference."""
    cost_of = cost_function(problem, weights)
    reference_cost, rollouts = cost_of(reference.point), 0
    best = SearchResult(problem.start, np.inf, None)
    began = time.perf_counter()

    def cost(x: np.ndarray) -> float:
        nonlocal rollouts, best
        rollouts += problem.count
        point = np.clip(x, 0.0, 1.0)
        value = cost_of(point) / reference_cost
        if value < best.cost:
            best = best._replace(point=point, cost=value)
        if best.reached is None and value <= 1.01:
            best = best._replace(reached=rollouts)
        if rollouts <= reference.rollouts:
            best = best._replace(cost_at_equal_rollouts=best.cost)
        if time.perf_counter() - began <= seconds:
            best = best._replace(cost_at_equal_time=best.cost)
        return value

    search(cost)
    return best
