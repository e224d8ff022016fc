"""Best designs of a finished sweep: the feasible designs, the Pareto front, and their refinement."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from smajax.sweeps.pareto import constraint_violation, feasible_mask, objective_costs, pareto_front
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign, refine, restore_and_refine, separated_starts
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

    If no design is feasible, the designs with the smallest violation are made feasible first.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        best: The best designs of the table.
        report: Called with a message before each refinement.

    Returns:
        A result for each start; empty if the sweep has no refinement, no simulated design, or listed values only.
    """
    if not sweep.refine_starts or not np.any(columns["code"] == "done") or all(axis.values for axis in sweep.axes):
        return []
    designs = np.column_stack([columns[axis.name] for axis in sweep.axes])
    free = [k for k, axis in enumerate(sweep.axes) if not axis.values]
    shares = np.column_stack([sweep.axes[k].share(designs[:, k]) for k in free])
    if best.feasible.any():
        rows = best.front_rows if len(sweep.objectives) > 1 else np.flatnonzero(best.feasible)
        rows = rows[~np.isnan(best.costs[rows, 0])]
        order, improve = rows[np.argsort(best.costs[rows, 0], kind="stable")], refine
    else:
        rows = np.flatnonzero(columns["code"] == "done")
        violation = constraint_violation(columns, sweep.constraints)[rows]
        order, improve = rows[np.argsort(violation, kind="stable")], restore_and_refine
    refined = []
    for k, row in enumerate(separated_starts(shares, order, sweep.refine_starts)):
        report(f"refining design {int(columns['design'][row])} ({k + 1})")
        refined.append(improve(problem, sweep.axes, designs[row], sweep.objectives, sweep.constraints))
    return refined
