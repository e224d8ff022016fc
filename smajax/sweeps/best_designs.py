"""Best designs of a finished sweep: the feasible designs, the Pareto front, and their refinement."""

from collections.abc import Callable, Collection, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from smajax.sweeps.pareto import constraint_violation, feasible_mask, objective_costs, pareto_front
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign, refine, restore_and_refine, separated_starts
from smajax.sweeps.space import Axis
from smajax.sweeps.sweep_file import SweepFile


class BestDesigns(NamedTuple):
    """Best designs in the table of a sweep.

    Attributes:
        feasible: Mask of the designs that satisfy all constraints, shape ``(m,)``.
        costs: Costs of the objectives, to be minimised, shape ``(m, objectives)``.
        front_rows: Rows of the Pareto front in the table, shape ``(front,)``.
    """

    feasible: Bool[np.ndarray, " designs"]
    costs: Float[np.ndarray, "designs objectives"]
    front_rows: Int[np.ndarray, " front"]


def find_best_designs(sweep: SweepFile, columns: Mapping[str, np.ndarray]) -> BestDesigns:
    """Find the feasible designs and the Pareto front in the table of a sweep.

    Args:
        sweep: The sweep.
        columns: Columns of its table by name, shape ``(m,)`` each.
    """
    feasible = feasible_mask(columns, sweep.constraints)
    costs = objective_costs(columns, sweep.objectives) if sweep.objectives else np.zeros((len(feasible), 0))
    rows = np.zeros(0, int)
    if sweep.objectives and feasible.any():
        rows = np.flatnonzero(feasible)[pareto_front(costs[feasible])]
    return BestDesigns(feasible, costs, rows)


def refine_best_designs(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    columns: Mapping[str, np.ndarray],
    best: BestDesigns,
    report: Callable[[str], None],
) -> list[RefinedDesign]:
    """Refine the best designs in the first objective, without a loss in the other objectives.

    If no design is feasible, the designs with the smallest violation are made feasible first. Listed values, such as
    the diameters of a catalogue, are fixed in a refinement; with one objective, the values next to those of the best
    result are tried as well, from the best sampled design that has them, until none is better.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        best: The best designs of the table.
        report: Called with a message before each refinement.

    Returns:
        A result for each start, the best first; empty if the sweep has no refinement, no simulated design, or listed
        values only.
    """
    if not sweep.refine_starts or not np.any(columns["code"] == "done") or all(axis.values for axis in sweep.axes):
        return []
    designs = np.column_stack([columns[axis.name] for axis in sweep.axes])
    # Of listed values, any two are far from each other.
    shares = np.column_stack(
        [designs[:, k] / _gap(axis) if axis.values else axis.share(designs[:, k]) for k, axis in enumerate(sweep.axes)]
    )
    order = _order_of_starts(sweep, columns, best)
    refined: list[RefinedDesign] = []

    def refine_row(row: int) -> None:
        report(f"refining design {int(columns['design'][row])} ({len(refined) + 1})")
        improve = refine if best.feasible[row] else restore_and_refine
        refined.append(improve(problem, sweep.axes, designs[row], sweep.objectives, sweep.constraints))

    for row in separated_starts(shares, order, sweep.refine_starts):
        refine_row(row)
    if len(sweep.objectives) == 1:
        tried = {_listed_values(sweep, result.design) for result in refined}
        while (row := _untried_neighbour(sweep, columns, best, designs, refined, tried)) is not None:
            refine_row(row)
            tried.add(_listed_values(sweep, designs[row]))
    return sorted(refined, key=lambda result: _rank(sweep, result))


def _gap(axis: Axis) -> float:
    """Smallest distance of two listed values; 1 if there is only one."""
    values = np.unique(axis.values)
    return float(np.min(np.diff(values))) if len(values) > 1 else 1.0


def _order_of_starts(
    sweep: SweepFile, columns: Mapping[str, np.ndarray], best: BestDesigns
) -> Int[np.ndarray, " rows"]:
    """Rows of the designs from which a refinement may start, the best first."""
    if best.feasible.any():
        rows = best.front_rows if len(sweep.objectives) > 1 else np.flatnonzero(best.feasible)
        rows = rows[~np.isnan(best.costs[rows, 0])]
        return rows[np.argsort(best.costs[rows, 0], kind="stable")]
    rows = np.flatnonzero(columns["code"] == "done")
    return rows[np.argsort(constraint_violation(columns, sweep.constraints)[rows], kind="stable")]


def _rank(sweep: SweepFile, result: RefinedDesign) -> tuple[bool, float]:
    """Sort key of a refined design: those that are better than their starts first, by the first objective."""
    name, goal = next(iter(sweep.objectives.items()))
    cost = result.metrics[name] * (-1.0 if goal == "max" else 1.0)
    return not result.better, cost if np.isfinite(cost) else np.inf


def _listed_values(sweep: SweepFile, design: Float[np.ndarray, " axes"]) -> tuple[float, ...]:
    return tuple(float(value) for value, axis in zip(design, sweep.axes, strict=True) if axis.values)


def _untried_neighbour(
    sweep: SweepFile,
    columns: Mapping[str, np.ndarray],
    best: BestDesigns,
    designs: Float[np.ndarray, "designs axes"],
    refined: Sequence[RefinedDesign],
    tried: Collection[tuple[float, ...]],
) -> int | None:
    """Row of the best sampled design whose listed values are next to those of the best result, and not tried yet."""
    feasible = [result for result in refined if constraint_violation(result.metrics, sweep.constraints) <= 0.0]
    if not feasible:
        return None
    top = min(feasible, key=lambda result: _rank(sweep, result)[1])
    violation = np.where(columns["code"] == "done", constraint_violation(columns, sweep.constraints), np.inf)
    cost = np.nan_to_num(best.costs[:, 0], nan=np.inf)
    for k, axis in enumerate(sweep.axes):
        values = sorted(set(axis.values))
        if not values:
            continue
        place = values.index(float(top.design[k]))
        nearby = values if axis.labels else values[max(0, place - 1) : place + 2]
        for value in nearby:
            wanted = top.design.copy()
            wanted[k] = value
            if _listed_values(sweep, wanted) in tried:
                continue
            same = np.all([designs[:, j] == wanted[j] for j, other in enumerate(sweep.axes) if other.values], axis=0)
            rows = np.flatnonzero(same & np.isfinite(violation))
            if len(rows):
                return int(rows[np.lexsort((cost[rows], violation[rows]))[0]])
    return None
