"""Best designs of a finished sweep: the feasible designs, the Pareto front, and their refinement."""

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from smajax.sweeps.pareto import constraint_violation, feasible_mask, objective_costs, pareto_front
from smajax.sweeps.population import evolve_designs
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
    the diameters of a catalogue, are fixed in these refinements. With one objective a population then searches all
    axes, and its best design is refined.

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
        report(f"searching with a population ({len(refined) + 1})")
        refined.append(_refine_evolved(sweep, problem, designs[order], refined))
    return sorted(refined, key=lambda result: _rank(sweep, result))


def _refine_evolved(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    designs: Float[np.ndarray, "designs axes"],
    refined: Sequence[RefinedDesign],
) -> RefinedDesign:
    """Refine the best design of a population that begins with refined designs and with the best sampled ones."""
    objective = next(iter(sweep.objectives.items()))
    starts = np.vstack([*(result.design for result in refined if result.better), designs])
    evolved = evolve_designs(problem, sweep.axes, starts, objective, sweep.constraints, sweep.seed)
    improve = refine if evolved.feasible else restore_and_refine
    result = improve(problem, sweep.axes, evolved.design, sweep.objectives, sweep.constraints)
    return result._replace(
        simulations=result.simulations + evolved.simulations, better=result.better or evolved.feasible
    )


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
