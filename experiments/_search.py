"""Searches without gradients for what ``tune`` finds with them: the same objective, the same compiled rollouts, a larger budget."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
import scipy.optimize

from smajax.control.tune import Tuned, objective_of
from smajax.control.tuning import Tuning


class Found(NamedTuple):
    """The best ``point`` of a search, its ``cost`` over ours, and the rollouts after which it was within 1 % of ours (``None``: never)."""

    point: np.ndarray
    cost: float
    reached: int | None


def evolved(one: Tuning, weights: Mapping[str, float], ours: Tuned, budget: int) -> Found:
    """SciPy's differential evolution."""
    size = 15 * len(one.names)
    options = {"popsize": 15, "maxiter": max(budget // (size * one.count) - 1, 1), "rng": 0, "polish": False, "tol": 0.0}
    bounds = [(0.0, 1.0)] * len(one.names)
    return _found(one, weights, ours, lambda cost: scipy.optimize.differential_evolution(cost, bounds, **options))


def simplex(one: Tuning, weights: Mapping[str, float], ours: Tuned, budget: int) -> Found:
    """Nelder and Mead's simplex from the start gains."""
    return _found(
        one,
        weights,
        ours,
        lambda cost: scipy.optimize.minimize(cost, one.start, method="Nelder-Mead", options={"maxfev": budget // one.count}),
    )


def judged(holds: bool, quick: bool) -> bool | None:
    """Whether a claim about twenty times our rollouts is met: a smaller budget can refute it, but not show it."""
    return None if quick and holds else holds


def spent(ours: Tuned) -> int:
    """The rollouts after which our search was within 1 % of its own end."""
    return next(count for count, cost in ours.history if cost <= 1.01 * ours.history[-1][1])


def _found(one: Tuning, weights: Mapping[str, float], ours: Tuned, search: Callable) -> Found:
    cost_of = objective_of(one, weights)
    mark, counted = cost_of(ours.point), 0
    best = Found(one.start, np.inf, None)

    def cost(x: np.ndarray) -> float:
        nonlocal counted, best
        counted += one.count
        point = np.clip(x, 0.0, 1.0)
        value = cost_of(point) / mark
        if value < best.cost:
            best = Found(point, value, best.reached)
        if best.reached is None and value <= 1.01:
            best = best._replace(reached=counted)
        return value

    search(cost)
    return best
