"""Restoration of feasibility: from a design that violates constraints to one that keeps them, by gradients.

Each bound of a constraint has a slack, relative to the bound. The search minimises the sum of the slacks and, as a
small second term, the distance from the start:

    minimise  sum(slack) + 0.5 d |x - x0|^2   subject to   distance_i(x) + slack_i >= 0,   slack_i >= 0,   0 <= x <= 1

So there always is an answer: where all slacks are 0 the constraints hold, and elsewhere some of them contradict each
other.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from smajax.recordings.recording import Floats
from smajax.sweeps.constraints import as_constraints
from smajax.sweeps.evaluation import DesignEvaluator
from smajax.sweeps.pareto import constraint_violation
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis

# Iterations of SLSQP, and the change of the cost that ends it. Chosen by trial; tests/unit/sweeps/test_sweeps.py holds
# both.
_ITERATIONS = 60
_COST_TOLERANCE = 1e-9
# Weight d of the distance: a move across the whole space costs far less than a bound that is violated by its own size.
_DISTANCE_WEIGHT = 1e-3


class RestoredDesign(NamedTuple):
    """Where a search for feasibility ended.

    Args:
        design: The design, shape ``(axes,)``.
        metrics: Its metrics.
        before: Metrics of the start.
        violation: Violation of the constraints, see ``pareto.constraint_violation``; 0 if all are kept.
        simulations: Number of simulations.
    """

    design: Floats
    metrics: dict[str, float]
    before: dict[str, float]
    violation: float
    simulations: int


def restore_feasibility(
    problem: AbstractSweepProblem, axes: Sequence[Axis], start: Floats, limits: Mapping[str, tuple[float, float]]
) -> RestoredDesign:
    """Move a design that violates limits to where all of them hold.

    Where no such design is found, the result is the one with the smallest violation of all that were simulated. Whole
    axes are searched as if they were continuous, then rounded and held while the others are searched again.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space.
        start: The design, shape ``(axes,)``.
        limits: Lower and upper bound by metric.
    """
    whole = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    continuous = [replace(axis, whole=False) for axis in axes]
    relaxed = _resolved(problem, continuous, np.array(start, dtype=np.float64), limits)
    if not whole:
        return relaxed
    rounded = relaxed.design.copy()
    rounded[whole] = np.rint(rounded[whole])
    held = [replace(axis, values=(float(rounded[k]),)) if k in whole else axis for k, axis in enumerate(axes)]
    result = _resolved(problem, held, rounded, limits)
    return result._replace(before=relaxed.before, simulations=relaxed.simulations + result.simulations)


def _resolved(
    problem: AbstractSweepProblem, axes: Sequence[Axis], start: Floats, limits: Mapping[str, tuple[float, float]]
) -> RestoredDesign:
    """Searches with more and more steps, each from the end of the last one, until the steps resolve their end."""
    steps = problem.shared_steps(start)
    result, spent = _search(problem, axes, start, steps, limits), 0
    while (needed := problem.shared_steps(result.design)) > steps:
        steps, spent, before = needed, spent + result.simulations, result.before
        result = _search(problem, axes, result.design, steps, limits)._replace(before=before)
    return result._replace(simulations=spent + result.simulations)


def _search(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Floats,
    steps: int,
    limits: Mapping[str, tuple[float, float]],
) -> RestoredDesign:
    """One search whose unknowns are the shares of the free axes and the slacks."""
    evaluator = DesignEvaluator(problem, axes, start, steps)
    origin = evaluator.shares(start)
    before = dict(evaluator.evaluate(origin)[0])
    sizes = {n: abs(v) if np.isfinite(v) and v else 1.0 for n, v in before.items()}
    count = len(evaluator.free)
    (constraint,) = as_constraints(evaluator, limits, sizes)

    def cost(point: Floats) -> tuple[float, Floats]:
        moved, slack = point[:count] - origin, point[count:]
        value = float(np.sum(slack) + 0.5 * _DISTANCE_WEIGHT * np.sum(moved**2))
        return value, np.concatenate([_DISTANCE_WEIGHT * moved, np.ones(len(slack))])

    def distances(point: Floats) -> Floats:
        return constraint["fun"](point[:count]) + point[count:]

    def jacobian(point: Floats) -> Floats:
        rows = constraint["jac"](point[:count])
        return np.hstack([rows, np.eye(len(rows))])

    if count:
        slack = np.maximum(-constraint["fun"](origin), 0.0)
        minimize(
            cost,
            np.concatenate([origin, slack]),
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * count + [(0.0, None)] * len(slack),
            constraints=[{"type": "ineq", "fun": distances, "jac": jacobian}],
            options={"maxiter": _ITERATIONS, "ftol": _COST_TOLERANCE},
        )
    violations = {key: float(constraint_violation(values, limits)) for key, (values, _) in evaluator.evaluated.items()}
    # Of several designs that keep the constraints the last one is the nearest to the start.
    best = min(reversed(violations), key=lambda key: violations[key])
    return RestoredDesign(
        evaluator.design(np.frombuffer(best)),
        evaluator.evaluated[best][0],
        before,
        violations[best],
        evaluator.simulations,
    )
