"""Searches without gradients for what ``tune`` finds with them.

The same objective, the same compiled rollouts, a larger budget.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy.optimize

from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.tune import TuningResult, cost_function


class Found(NamedTuple):
    """Best ``point`` of a search, ``cost`` relative to ours, rollouts until within 1 % of ours (``None``: never).

    ``in_rollouts`` is its cost over ours after as many rollouts as ours took, ``in_time`` after as many seconds.
    """

    point: np.ndarray
    cost: float
    reached: int | None
    in_rollouts: float = np.inf
    in_time: float = np.inf


def evolved(
    one: TuningProblem, weights: Mapping[str, float], ours: TuningResult, budget: int, seconds: float = 0.0
) -> Found:
    """SciPy's differential evolution; ``seconds`` are what ours took."""
    size = 15 * len(one.names)
    options = {
        "popsize": 15,
        "maxiter": max(budget // (size * one.count) - 1, 1),
        "rng": 0,
        "polish": False,
        "tol": 0.0,
    }
    bounds = [(0.0, 1.0)] * len(one.names)
    return _found(
        one, weights, ours, seconds, lambda cost: scipy.optimize.differential_evolution(cost, bounds, **options)
    )


def evolved_by_one(one: TuningProblem, weights: Mapping[str, float], ours: TuningResult, budget: int) -> int | None:
    """Rollouts until a population warm-started by one member is within 1 % of ours.

    ``None`` if it never is. Ours begins by one member, too.
    """
    by_one, by_all = cost_function(one.single_member(), weights), cost_function(one, weights)
    mark, best, counted, reached = by_all(ours.point), np.inf, 0, None

    def cost(x: np.ndarray) -> float:
        nonlocal best, counted, reached
        counted += 1
        value = by_one(point := np.clip(x, 0.0, 1.0))
        if value < best and reached is None:
            best, counted = value, counted + one.count
            reached = counted if by_all(point) <= 1.01 * mark else None
        return value

    size = 15 * len(one.names)
    scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * len(one.names),
        popsize=15,
        maxiter=max(budget // size - 1, 1),
        rng=0,
        polish=False,
        tol=0.0,
        callback=lambda intermediate_result: reached is not None,
    )
    return reached


def simplex(
    one: TuningProblem, weights: Mapping[str, float], ours: TuningResult, budget: int, seconds: float = 0.0
) -> Found:
    """Nelder and Mead's simplex from the start gains; ``seconds`` are what ours took."""
    return _found(
        one,
        weights,
        ours,
        seconds,
        lambda cost: scipy.optimize.minimize(
            cost, one.start, method="Nelder-Mead", options={"maxfev": budget // one.count}
        ),
    )


def judged(holds: bool, quick: bool) -> bool | None:
    """Whether a claim about twenty times our rollouts is met: a smaller budget can refute it, but not show it."""
    return None if quick and holds else holds


def spent(ours: TuningResult) -> int:
    """The rollouts after which our search was within 1 % of its own end."""
    return next(count for count, cost in ours.history if cost <= 1.01 * ours.history[-1][1])


def _found(
    one: TuningProblem, weights: Mapping[str, float], ours: TuningResult, seconds: float, search: Callable
) -> Found:
    cost_of = cost_function(one, weights)
    mark, counted = cost_of(ours.point), 0
    best, began = Found(one.start, np.inf, None), time.perf_counter()

    def cost(x: np.ndarray) -> float:
        nonlocal counted, best
        counted += one.count
        point = np.clip(x, 0.0, 1.0)
        value = cost_of(point) / mark
        if value < best.cost:
            best = best._replace(point=point, cost=value)
        if best.reached is None and value <= 1.01:
            best = best._replace(reached=counted)
        if counted <= ours.rollouts:
            best = best._replace(in_rollouts=best.cost)
        if time.perf_counter() - began <= seconds:
            best = best._replace(in_time=best.cost)
        return value

    search(cost)
    return best
