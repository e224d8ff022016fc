"""Refinement of the best designs of a sweep by gradients, within the space and the constraints.

The optimiser is SciPy's sequential quadratic programming (SLSQP) over the shares of the axes (``evaluation``). For a
design that violates constraints, feasibility is restored first (``feasibility``).

A search runs with a number of time steps that resolves its start. If its result needs more steps, the search continues
from there with more steps, until they resolve the result. So a better design is better with steps that resolve it.
"""

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Int
from scipy.optimize import minimize

from smajax.sweeps.constraints import INFINITE, as_constraints
from smajax.sweeps.evaluation import DesignEvaluator
from smajax.sweeps.feasibility import restore_feasibility
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis

# Largest number of iterations of SLSQP, and the change of the scaled cost that ends it. Chosen by trial;
# tests/unit/sweeps/test_sweeps.py refines designs with both.
_ITERATIONS = 60
_COST_TOLERANCE = 1e-8
# Smallest distance of two starts in the axis on which they differ most, as a share of that axis, so that their searches
# do not end at the same design. Chosen by trial.
_START_DISTANCE = 0.15


class RefinedDesign(NamedTuple):
    """Result of a refinement.

    Attributes:
        design: The design in internal units, shape ``(axes,)``.
        metrics: Its metrics by name, in internal units.
        before: Metrics of the start.
        simulations: Number of simulations.
        better: Whether it is better than its start; a feasible design is better than one that is not.
        restored: Whether its start violated the constraints.
    """

    design: Float[np.ndarray, " axes"]
    metrics: dict[str, float]
    before: dict[str, float]
    simulations: int
    better: bool
    restored: bool = False


class _Goal(NamedTuple):
    """Optimisation problem: the objective and its sign (cost = sign times metric), other objectives, and limits."""

    problem: AbstractSweepProblem
    objective: str
    sign: float
    other_objectives: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]

    def limits_at(self, before: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The limits, tightened so that the other objectives are not worse than ``before``."""
        limits = dict(self.limits)
        for name, goal in self.other_objectives.items():
            low, high = limits.get(name, (-np.inf, np.inf))
            limits[name] = (max(low, before[name]), high) if goal == "max" else (low, min(high, before[name]))
        return limits

    def improves(self, metrics: Mapping[str, float], before: Mapping[str, float], best: Mapping[str, float]) -> bool:
        """Whether ``metrics`` are better than ``best``, satisfy the limits, and are not worse than ``before``."""
        better = self.sign * metrics[self.objective] < self.sign * best[self.objective]
        return better and _is_feasible(self.limits_at(before), metrics)


def _is_feasible(limits: Mapping[str, tuple[float, float]], metrics: Mapping[str, float]) -> bool:
    return all(low <= metrics[n] <= high for n, (low, high) in limits.items())


def refine(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> RefinedDesign:
    """Improve the first objective of a feasible design, without a loss in the other objectives.

    The result is the best simulated design that satisfies the limits, so it is never worse than the start. There is no
    search if the objective is infinite at the start, since an infinite metric has no gradient. Axes of whole numbers
    are first relaxed to continuous ones; then they are fixed at the rounded values, and the search is repeated over the
    other axes. Another search fixes them at the values of the start, and the better result counts.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space; axes of listed values are fixed.
        start: The start in internal units, shape ``(axes,)``, which satisfies all limits.
        objectives: ``max`` or ``min`` by metric.
        limits: Lower and upper bound by metric, in internal units.
    """
    (name, goal), *others = objectives.items()
    target = _Goal(problem, name, -1.0 if goal == "max" else 1.0, dict(others), limits)
    whole = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    if not whole:
        return _search_resolved(target, axes, start)
    relaxed = _search_resolved(target, [replace(axis, whole=False) for axis in axes], start)

    def rounded(design: Float[np.ndarray, " axes"]) -> tuple[list[Axis], Float[np.ndarray, " axes"]]:
        design = np.array(design, dtype=np.float64)
        design[whole] = np.rint(design[whole])
        fixed = [replace(axis, values=(float(design[k]),)) if k in whole else axis for k, axis in enumerate(axes)]
        return fixed, design

    same_counts = _search_resolved(target, *rounded(start))
    new_counts = _search_resolved(target, *rounded(relaxed.design), same_counts.before)
    improves = target.improves(new_counts.metrics, same_counts.before, same_counts.metrics)
    best = new_counts if improves else same_counts
    return best._replace(
        before=same_counts.before,
        simulations=relaxed.simulations + same_counts.simulations + new_counts.simulations,
        better=improves or same_counts.better,
    )


def restore_and_refine(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> RefinedDesign:
    """Make a design feasible, and refine it from there.

    If no feasible design is found, the result is the one with the smallest violation, and is not ``better``.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space; axes of listed values are fixed.
        start: The start in internal units, shape ``(axes,)``, which violates limits.
        objectives: ``max`` or ``min`` by metric.
        limits: Lower and upper bound by metric, in internal units.
    """
    feasible = restore_feasibility(problem, axes, start, limits)
    if feasible.violation > 0.0:
        return RefinedDesign(feasible.design, feasible.metrics, feasible.before, feasible.simulations, False, True)
    refined = refine(problem, axes, feasible.design, objectives, limits)
    return refined._replace(
        before=feasible.before, simulations=feasible.simulations + refined.simulations, better=True, restored=True
    )


def _search_resolved(
    target: _Goal, axes: Sequence[Axis], start: Float[np.ndarray, " axes"], before: Mapping[str, float] | None = None
) -> RefinedDesign:
    """Searches with increasing numbers of time steps, each from the previous result, until they resolve the result.

    The other objectives must not be worse than in ``before``, by default the metrics of the start.
    """
    steps = target.problem.shared_steps(start)
    result, spent = _search(target, axes, start, start, steps, before), 0
    while (needed := target.problem.shared_steps(result.design)) > steps:
        steps, spent = needed, spent + result.simulations
        result = _search(target, axes, start, result.design, steps, before)
    if before is None and not result.better:
        result = result._replace(design=np.array(start, dtype=np.float64), metrics=result.before)
    return result._replace(simulations=spent + result.simulations)


def _search(
    target: _Goal,
    axes: Sequence[Axis],
    start: Float[np.ndarray, " axes"],
    begin: Float[np.ndarray, " axes"],
    steps: int,
    reference: Mapping[str, float] | None,
) -> RefinedDesign:
    """One search with ``steps`` from the design ``begin``; its result must be better than ``start``."""
    name, sign = target.objective, target.sign
    evaluator = DesignEvaluator(target.problem, axes, start, steps)
    origin, first = evaluator.shares(start), evaluator.shares(begin)
    before = dict(evaluator.evaluate(origin)[0])
    if not np.isfinite(before[name]):
        return RefinedDesign(evaluator.design(origin), before, before, evaluator.simulations, False)
    limits = target.limits_at(before if reference is None else reference)
    scales = {n: max(abs(v), 1e-300) if np.isfinite(v) else 1.0 for n, v in before.items()}

    def cost(shares: Float[np.ndarray, " free"]) -> tuple[float, Float[np.ndarray, " free"]]:
        metrics, slopes = evaluator.evaluate(shares)
        if not np.isfinite(metrics[name]) or not np.all(np.isfinite(slopes[name])):
            return (-INFINITE if sign * metrics[name] == -np.inf else INFINITE), np.zeros(len(evaluator.free))
        return sign * metrics[name] / scales[name], sign * slopes[name] / scales[name]

    if evaluator.free:
        minimize(
            cost,
            first,
            jac=True,
            method="SLSQP",
            bounds=[(0.0, 1.0)] * len(evaluator.free),
            constraints=as_constraints(evaluator, limits, scales),
            options={"maxiter": _ITERATIONS, "ftol": _COST_TOLERANCE},
        )
    costs = {
        key: sign * metrics[name]
        for key, (metrics, _) in evaluator.evaluated.items()
        if not np.isnan(metrics[name]) and _is_feasible(limits, metrics)
    }
    best = min(costs, key=lambda key: costs[key]) if costs else origin.tobytes()
    better = bool(costs) and sign * evaluator.evaluated[best][0][name] < sign * before[name]
    design = evaluator.design(np.frombuffer(best))
    return RefinedDesign(design, evaluator.evaluated[best][0], before, evaluator.simulations, better)


def separated_starts(
    shares: Float[np.ndarray, "designs axes"],
    order: Int[np.ndarray, " rows"],
    count: int,
    min_distance: float = _START_DISTANCE,
) -> list[int]:
    """Choose starts that are not close to each other, the first in ``order`` first.

    Args:
        shares: Shares of designs, shape ``(designs, axes)``.
        order: Rows of the designs, best first, shape ``(rows,)``.
        count: Largest number of starts.
        min_distance: Smallest distance of two starts in the axis on which they differ most, as a share of that axis.

    Returns:
        Rows of the chosen designs.
    """
    chosen: list[int] = []
    for row in order:
        if all(np.max(np.abs(shares[row] - shares[other])) >= min_distance for other in chosen):
            chosen.append(int(row))
        if len(chosen) == count:
            break
    return chosen
