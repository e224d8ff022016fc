"""Best designs of a finished sweep: the feasible designs, the Pareto front, and their refinement."""

from collections.abc import Callable, Collection, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float, Int

from smajax.sweeps.constraints import safe_bounds
from smajax.sweeps.pareto import constraint_violation, feasible_mask, objective_costs, pareto_front
from smajax.sweeps.population import evolve_designs
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign, refine, restore_and_refine, separated_starts
from smajax.sweeps.space import Axis
from smajax.sweeps.sweep_file import SweepFile

# Refined designs count as one if they differ by less than this share of each axis, a hundredth: a wire of the same
# length within what clamps leave open.
_SAME_SHARE = 0.01


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
    the diameters of a catalogue, are fixed in these refinements. With one objective populations then search all axes,
    and their best designs are refined.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        best: The best designs of the table.
        report: Called with a message before each refinement.

    Returns:
        The distinct results of all starts, the best first; empty if the sweep has no refinement, no simulated design,
        or listed values only.
    """
    if not sweep.refine_starts or not np.any(columns["code"] == "done") or all(axis.values for axis in sweep.axes):
        return []
    designs = np.column_stack([columns[axis.name] for axis in sweep.axes])
    # Of listed values, any two are far from each other.
    shares = np.column_stack(
        [designs[:, k] / _gap(axis) if axis.values else axis.share(designs[:, k]) for k, axis in enumerate(sweep.axes)]
    )
    order = _order_of_starts(sweep, columns, best)
    inside = feasible_mask(columns, safe_bounds(sweep.constraints))
    refined: list[RefinedDesign] = []
    for row in separated_starts(shares, order, sweep.refine_starts):
        report(f"refining design {int(columns['design'][row])} ({len(refined) + 1})")
        refined.append(_refine_design(sweep, problem, designs[row], bool(best.feasible[row]), bool(inside[row])))
    if len(sweep.objectives) == 1:
        refined += _refine_populations(sweep, problem, designs[order], refined, report)
    return distinct_designs(sweep.axes, sorted(refined, key=lambda result: _rank(sweep, result)))


def distinct_designs(axes: Sequence[Axis], refined: Sequence[RefinedDesign]) -> list[RefinedDesign]:
    """Return the refined designs without those that a person would build alike.

    Args:
        axes: Axes of the space.
        refined: Refined designs; of several that are alike the first is kept, with the simulations of all.
    """
    distinct: list[RefinedDesign] = []
    for result in refined:
        for k, other in enumerate(distinct):
            if other.better == result.better and _are_same(axes, other.design, result.design):
                distinct[k] = other._replace(simulations=other.simulations + result.simulations)
                break
        else:
            distinct.append(result)
    return distinct


def _are_same(axes: Sequence[Axis], first: Float[np.ndarray, " axes"], second: Float[np.ndarray, " axes"]) -> bool:
    """Whether a person would build one and the same design."""
    return all(
        first[k] == second[k]
        or (not axis.values and not axis.whole and abs(axis.share(first[k]) - axis.share(second[k])) < _SAME_SHARE)
        for k, axis in enumerate(axes)
    )


def _refine_design(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    design: Float[np.ndarray, " axes"],
    feasible: bool,
    feasible_inside: bool,
) -> RefinedDesign:
    """Refine a design within bounds that leave room for the error of the time steps; at the bounds if there is none.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        design: The design, shape ``(axes,)``.
        feasible: Whether it satisfies all constraints.
        feasible_inside: Whether it satisfies them with that room.
    """
    inner = safe_bounds(sweep.constraints)
    if feasible_inside:
        return refine(problem, sweep.axes, design, sweep.objectives, inner)
    result = restore_and_refine(problem, sweep.axes, design, sweep.objectives, inner)
    if not feasible:
        return result
    if result.better and _is_better(sweep, result):
        return result._replace(restored=False)
    outer = refine(problem, sweep.axes, design, sweep.objectives, sweep.constraints)
    return outer._replace(simulations=outer.simulations + result.simulations)


def _is_better(sweep: SweepFile, result: RefinedDesign) -> bool:
    """Whether a feasible design is better than its start in the first objective."""
    name, goal = next(iter(sweep.objectives.items()))
    after, before = result.metrics[name], result.before[name]
    return after > before if goal == "max" else after < before


def _refine_populations(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    designs: Float[np.ndarray, "designs axes"],
    refined: Sequence[RefinedDesign],
    report: Callable[[str], None],
) -> list[RefinedDesign]:
    """Refine the best designs of populations: of one over all axes, and then of one for each listed value next to
    those of the best result, until none is better.

    Args:
        sweep: The sweep.
        problem: Maps a design to its metrics.
        designs: The sampled designs, the best first.
        refined: Refined designs so far.
        report: Called with a message before each population.
    """
    results: list[RefinedDesign] = []
    tried: set[tuple[float, ...]] = set()
    axes: Sequence[Axis] | None = sweep.axes
    while axes is not None:
        report(f"searching with a population ({len(refined) + len(results) + 1})")
        results.append(_refine_population(sweep, problem, axes, designs, [*refined, *results]))
        tried.add(_listed_values(axes) or _listed_values(sweep.axes, results[-1].design))
        axes = _untried_neighbour(sweep, [*refined, *results], tried)
    return results


def _refine_population(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    designs: Float[np.ndarray, "designs axes"],
    refined: Sequence[RefinedDesign],
) -> RefinedDesign:
    """Refine the best design of a population over axes, of which some may have one value only."""
    objective = next(iter(sweep.objectives.items()))
    best_first = sorted(refined, key=lambda result: _rank(sweep, result))
    starts = np.vstack([*(result.design for result in best_first if result.better), designs])
    evolved = evolve_designs(problem, axes, starts, objective, safe_bounds(sweep.constraints), sweep.seed)
    result = _refine_design(sweep, problem, evolved.design, evolved.feasible, evolved.feasible)
    return result._replace(
        simulations=result.simulations + evolved.simulations, better=result.better or evolved.feasible
    )


def _listed_values(axes: Sequence[Axis], design: Float[np.ndarray, " axes"] | None = None) -> tuple[float, ...]:
    """Values of a design on the axes with listed values; without a design those of axes of one value, or none."""
    listed = [(k, axis) for k, axis in enumerate(axes) if axis.values]
    if design is not None:
        return tuple(float(design[k]) for k, _ in listed)
    return tuple(axis.values[0] for _, axis in listed) if all(len(axis.values) == 1 for _, axis in listed) else ()


def _untried_neighbour(
    sweep: SweepFile, refined: Sequence[RefinedDesign], tried: Collection[tuple[float, ...]]
) -> list[Axis] | None:
    """Axes with the listed values next to those of the best result that no population had yet; ``None`` if all had."""
    feasible = [result for result in refined if constraint_violation(result.metrics, sweep.constraints) <= 0.0]
    if not feasible:
        return None
    top = min(feasible, key=lambda result: _rank(sweep, result)[1]).design
    for k, axis in enumerate(sweep.axes):
        values = sorted(set(axis.values))
        place = values.index(float(top[k])) if values else 0
        for value in values if axis.labels else values[max(0, place - 1) : place + 2]:
            wanted = top.copy()
            wanted[k] = value
            if _listed_values(sweep.axes, wanted) not in tried:
                return [
                    replace(other, values=(float(wanted[j]),)) if other.values else other
                    for j, other in enumerate(sweep.axes)
                ]
    return None


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
