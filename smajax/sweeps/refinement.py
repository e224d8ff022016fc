"""Refinement: the best designs of a sweep, improved along the metrics' gradients within the space and the constraints.

The search is SciPy's sequential quadratic programming (SLSQP) over the design's shares of the axes (``evaluation``).
From a design that violates constraints, feasibility is restored first (``feasibility``).

A search runs with steps that resolve its start. Its end may be faster; then the search continues from there with more
steps, until they resolve its end. So whatever is called better is so with steps that resolve it.
"""

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from scipy.optimize import minimize

from smajax.recordings.recording import Floats
from smajax.sweeps.constraints import INFINITE, as_constraints
from smajax.sweeps.evaluation import DesignEvaluator
from smajax.sweeps.feasibility import restore_feasibility
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis

# Iterations of SLSQP, and the change of the scaled cost that ends it. Chosen by trial; tests/unit/sweeps/test_sweeps.py
# holds both.
_ITERATIONS = 60
_COST_TOLERANCE = 1e-8
# Least distance of two starts on one axis at least, as a share of the axis, so that they do not lead to the same
# design. Chosen by trial.
_START_DISTANCE = 0.15


class RefinedDesign(NamedTuple):
    """A refined design.

    Args:
        design: The design, shape ``(axes,)``.
        metrics: Its metrics.
        before: Metrics of the start.
        simulations: Number of simulations.
        better: Whether it is better than its start; a design that keeps the constraints is better than one that does
            not.
        restored: Whether its start violated the constraints.
    """

    design: Floats
    metrics: dict[str, float]
    before: dict[str, float]
    simulations: int
    better: bool
    restored: bool = False


class _Goal(NamedTuple):
    """What is improved: the objective and its sign (cost = sign times metric), other objectives, and limits."""

    problem: AbstractSweepProblem
    objective: str
    sign: float
    other_objectives: Mapping[str, str]
    limits: Mapping[str, tuple[float, float]]

    def limits_at(self, before: Mapping[str, float]) -> dict[str, tuple[float, float]]:
        """The limits, and those that hold the other objectives at their values at the start."""
        limits = dict(self.limits)
        for name, goal in self.other_objectives.items():
            low, high = limits.get(name, (-np.inf, np.inf))
            limits[name] = (max(low, before[name]), high) if goal == "max" else (low, min(high, before[name]))
        return limits

    def improves(self, metrics: Mapping[str, float], before: Mapping[str, float], best: Mapping[str, float]) -> bool:
        """Whether metrics are better than the best ones, keep the limits, and are nowhere worse than the start."""
        better = self.sign * metrics[self.objective] < self.sign * best[self.objective]
        return better and _keeps(self.limits_at(before), metrics)


def _keeps(limits: Mapping[str, tuple[float, float]], metrics: Mapping[str, float]) -> bool:
    return all(low <= metrics[n] <= high for n, (low, high) in limits.items())


def refine(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    start: Floats,
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> RefinedDesign:
    """Improve the first objective from a design that keeps all limits; no other objective gets worse than it is there.

    The result is the best of all simulated designs that keep the limits, so that it is never worse than the start. From
    a design whose objective is infinite nothing is searched, since an infinite metric has no slope. Whole axes are
    searched as if they were continuous, then rounded and held while the others are searched again; a second search
    holds them at the start's values.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space; axes of listed values are held.
        start: The design, shape ``(axes,)``.
        objectives: ``max`` or ``min`` by metric.
        limits: Lower and upper bound by metric.
    """
    (name, goal), *others = objectives.items()
    target = _Goal(problem, name, -1.0 if goal == "max" else 1.0, dict(others), limits)
    whole = [k for k, axis in enumerate(axes) if axis.whole and not axis.values]
    if not whole:
        return _resolved(target, axes, start)
    relaxed = _resolved(target, [replace(axis, whole=False) for axis in axes], start)

    def rounded(design: Floats) -> tuple[list[Axis], Floats]:
        design = np.array(design, dtype=np.float64)
        design[whole] = np.rint(design[whole])
        held = [replace(axis, values=(float(design[k]),)) if k in whole else axis for k, axis in enumerate(axes)]
        return held, design

    same_counts = _resolved(target, *rounded(start))
    new_counts = _resolved(target, *rounded(relaxed.design), same_counts.before)
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
    start: Floats,
    objectives: Mapping[str, str],
    limits: Mapping[str, tuple[float, float]],
) -> RefinedDesign:
    """Refine from a design that violates limits: it moves to where they hold, and is improved from there.

    Where no such design is found, the result is the one with the smallest violation, and is not ``better``. Arguments
    as of ``refine``.
    """
    feasible = restore_feasibility(problem, axes, start, limits)
    if feasible.violation > 0.0:
        return RefinedDesign(feasible.design, feasible.metrics, feasible.before, feasible.simulations, False, True)
    refined = refine(problem, axes, feasible.design, objectives, limits)
    return refined._replace(
        before=feasible.before, simulations=feasible.simulations + refined.simulations, better=True, restored=True
    )


def _resolved(
    target: _Goal, axes: Sequence[Axis], start: Floats, before: Mapping[str, float] | None = None
) -> RefinedDesign:
    """Searches with more and more steps, each from the end of the last one, until the steps resolve their end.

    ``before`` are the metrics that the other objectives must not fall behind, by default those of the start.
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
    start: Floats,
    begin: Floats,
    steps: int,
    reference: Mapping[str, float] | None,
) -> RefinedDesign:
    """One search with ``steps`` that begins at a design; ``start`` is what its result has to be better than."""
    name, sign = target.objective, target.sign
    evaluator = DesignEvaluator(target.problem, axes, start, steps)
    origin, first = evaluator.shares(start), evaluator.shares(begin)
    before = dict(evaluator.evaluate(origin)[0])
    if not np.isfinite(before[name]):
        return RefinedDesign(evaluator.design(origin), before, before, evaluator.simulations, False)
    limits = target.limits_at(before if reference is None else reference)
    scales = {n: max(abs(v), 1e-300) if np.isfinite(v) else 1.0 for n, v in before.items()}

    def cost(shares: Floats) -> tuple[float, Floats]:
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
        if not np.isnan(metrics[name]) and _keeps(limits, metrics)
    }
    best = min(costs, key=lambda key: costs[key]) if costs else origin.tobytes()
    better = bool(costs) and sign * evaluator.evaluated[best][0][name] < sign * before[name]
    design = evaluator.design(np.frombuffer(best))
    return RefinedDesign(design, evaluator.evaluated[best][0], before, evaluator.simulations, better)


def separated_starts(
    shares: Floats, order: Iterable[int], count: int, min_distance: float = _START_DISTANCE
) -> list[int]:
    """Return up to ``count`` rows of designs' shares ``(m, axes)``, taken in ``order``.

    Any two of them are at least ``min_distance`` apart on some axis.
    """
    chosen: list[int] = []
    for row in order:
        if all(np.max(np.abs(shares[row] - shares[other])) >= min_distance for other in chosen):
            chosen.append(int(row))
        if len(chosen) == count:
            break
    return chosen
