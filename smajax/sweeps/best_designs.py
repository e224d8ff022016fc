"""The best designs of a finished sweep: the feasible ones, the Pareto front, and the best of them refined."""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from smajax.recordings.recording import Floats
from smajax.sweeps.pareto import constraint_violation, feasible, objective_costs, pareto_front
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign, refine, restore_and_refine, separated_starts
from smajax.sweeps.sweep_file import SweepFile


class BestDesigns(NamedTuple):
    """The best designs of a sweep's table.

    Args:
        keeps: Which designs keep all constraints, shape ``(m,)``.
        costs: Costs of the objectives, smaller being better, shape ``(m, objectives)``.
        front_rows: Rows of the Pareto front.
    """

    keeps: np.ndarray
    costs: Floats
    front_rows: np.ndarray


def find_best_designs(sweep: SweepFile, columns: Mapping[str, np.ndarray]) -> BestDesigns:
    """Return the feasible designs and the Pareto front of a sweep's table."""
    keeps = feasible(columns, sweep.constraints)
    costs = objective_costs(columns, sweep.objectives) if sweep.objectives else np.zeros((len(keeps), 0))
    rows = np.zeros(0, int)
    if sweep.objectives and keeps.any():
        rows = np.flatnonzero(keeps)[pareto_front(costs[keeps])]
    return BestDesigns(keeps, costs, rows)


def refine_best_designs(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    columns: Mapping[str, np.ndarray],
    best: BestDesigns,
    report: Callable[[str], None],
) -> list[RefinedDesign]:
    """Refine the best designs in the first objective; no other objective gets worse than it is at the start.

    Where no design keeps the constraints, the designs with the smallest violation are moved to where they hold.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        columns: Columns of the sweep's table by name.
        best: The best designs.
        report: Called with a text before each refinement.
    """
    if not sweep.refine_starts or not np.any(columns["code"] == "done") or all(axis.values for axis in sweep.axes):
        return []
    designs = np.column_stack([columns[axis.name] for axis in sweep.axes])
    free = [k for k, axis in enumerate(sweep.axes) if not axis.values]
    shares = np.column_stack([sweep.axes[k].share(designs[:, k]) for k in free])
    if best.keeps.any():
        rows = best.front_rows if len(sweep.objectives) > 1 else np.flatnonzero(best.keeps)
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
