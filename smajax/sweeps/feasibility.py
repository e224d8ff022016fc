"""Restoration of feasibility: a search by gradients from a design that violates constraints to a feasible one.

Each bound of a constraint has a slack, relative to the bound. The search minimises the sum of the slacks plus a small
multiple of the squared distance from the start:

    minimise  sum(slack) + 0.5 d |x - x0|^2   subject to   distance_i(x) + slack_i >= 0,   slack_i >= 0,   0 <= x <= 1

With slacks this problem always has a solution. The constraints hold if all slacks are 0; otherwise the search found no
feasible design.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float
from scipy.optimize import minimize

from smajax.sweeps.constraints import as_constraints
from smajax.sweeps.evaluation import DesignEvaluator
from smajax.sweeps.pareto import constraint_violation
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis

# Largest number of iterations of SLSQP, and the change of the cost that ends it. Chosen by trial;
# tests/unit/sweeps/test_sweeps.py restores designs with both.
_ITERATIONS = 60
_COST_TOLERANCE = 1e-9
# Weight d of the distance: a move across the whole space costs far less than the violation of a bound by its own size.
_DISTANCE_WEIGHT = 1e-3


class RestoredDesign(NamedTuple):
    """Result of a search for a feasible design.

    Attributes:
        design: The design in internal units, shape ``(axes,)``.
        metrics: Its metrics by name, in internal units.
        before: Metrics of the start.
        violation: Violation of the constraints, see ``pareto.constraint_violation``; 0 if all are satisfied.
        simulations: Number of simulations.
    """

    design: Float[np.ndarray, " axes"]
    metrics: dict[str, float]
    before: dict[str, float]
    violation: float
    simulations: int


def restore_feasibility(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    limits: Mapping[str, tuple[float, float]],
) -> RestoredDesign:
    """Search for a design that satisfies all limits, near one that violates some.

    If none is found, the result is the simulated design with the smallest violation. Axes of whole numbers are first
    relaxed to continuous ones; then they are fixed at the rounded values, and the search is repeated over the other
    axes.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space.
        start: The start in internal units, shape ``(axes,)``.
        limits: Lower and upper bound by metric, in internal units.
    """
    whole = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    continuous = [replace(axis, whole=False) for axis in axes]
    relaxed = _search_resolved(problem, continuous, np.array(start, dtype=np.float64), limits)
    if not whole:
        return relaxed
    rounded = relaxed.design.copy()
    rounded[whole] = np.rint(rounded[whole])
    fixed = [replace(axis, values=(float(rounded[k]),)) if k in whole else axis for k, axis in enumerate(axes)]
    result = _search_resolved(problem, fixed, rounded, limits)
    return result._replace(before=relaxed.before, simulations=relaxed.simulations + result.simulations)


def _search_resolved(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    limits: Mapping[str, tuple[float, float]],
) -> RestoredDesign:
    """Searches with increasing numbers of time steps, each from the previous result, until they resolve the result."""
    steps = problem.shared_steps(start)
    result, spent = _search(problem, axes, start, steps, limits), 0
    while (needed := problem.shared_steps(result.design)) > steps:
        steps, spent, before = needed, spent + result.simulations, result.before
        result = _search(problem, axes, result.design, steps, limits)._replace(before=before)
    return result._replace(simulations=spent + result.simulations)


def _search(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    steps: int,
    limits: Mapping[str, tuple[float, float]],
) -> RestoredDesign:
    """One search over the shares of the free axes and the slacks."""
    evaluator = DesignEvaluator(problem, axes, start, steps)
    origin = evaluator.shares(start)
    before = dict(evaluator.evaluate(origin)[0])
    sizes = {n: abs(v) if np.isfinite(v) and v else 1.0 for n, v in before.items()}
    count = len(evaluator.free)
    (constraint,) = as_constraints(evaluator, limits, sizes)

    def cost(point: Float[np.ndarray, " unknowns"]) -> tuple[float, Float[np.ndarray, " unknowns"]]:
        change, slack = point[:count] - origin, point[count:]
        value = float(np.sum(slack) + 0.5 * _DISTANCE_WEIGHT * np.sum(change**2))
        return value, np.concatenate([_DISTANCE_WEIGHT * change, np.ones(len(slack))])

    def distances(point: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, " bounds"]:
        return constraint["fun"](point[:count]) + point[count:]

    def jacobian(point: Float[np.ndarray, " unknowns"]) -> Float[np.ndarray, "bounds unknowns"]:
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
    # Of several feasible designs the last one is the nearest to the start.
    best = min(reversed(violations), key=lambda key: violations[key])
    return RestoredDesign(
        evaluator.design(np.frombuffer(best)),
        evaluator.evaluated[best][0],
        before,
        violations[best],
        evaluator.simulations,
    )
