"""Differential evolution over a design space, for constraints that leave small or separate feasible regions.

A gradient-based search ends at the nearest local optimum, and hysteresis gives the metrics kinks at which it may stop
before. The population finds the region of the best design, also over listed values and whole numbers, and gradients
refine it there.
"""

import math
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax.numerics.ensemble import parallel_batches
from smajax.numerics.evolution import evolve_in_unit_box
from smajax.numerics.jax_setup import on_cpu
from smajax.sweeps.chunks import evaluate_designs
from smajax.sweeps.constraints import MARGIN, safe_bounds
from smajax.sweeps.pareto import constraint_violation
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.space import Axis, to_designs
from smajax.sweeps.step_levels import next_power_of_two

# Size of the population, that of a batch, and number of generations. Chosen by trial; experiments/speed/design_tasks.py
# compares the results with the best of 100,000 samples.
_POPULATION = 64
_GENERATIONS = 40
# Cost above which a design violates constraints, relative to the objective of the best start.
_VIOLATION_COST = 1e9


class EvolvedDesign(NamedTuple):
    """Result of a search by a population.

    Attributes:
        design: The best design, shape ``(axes,)``.
        feasible: Whether it satisfies all constraints.
        simulations: Number of simulated designs.
    """

    design: Float[np.ndarray, " axes"]
    feasible: bool
    simulations: int


def evolve_designs(
    problem: AbstractSweepProblem,
    axes: Sequence[Axis],
    starts: Float[np.ndarray, "starts axes"],
    objective: tuple[str, str],
    limits: Mapping[str, tuple[float, float]],
    seed: int,
) -> EvolvedDesign:
    """Search for the best design within limits.

    Args:
        problem: Maps a design to its metrics.
        axes: Axes of the space.
        starts: Designs of the first population, the best first, shape ``(starts, axes)``; others are drawn.
        objective: Metric, and ``max`` or ``min``.
        limits: Lower and upper bound by metric, in internal units.
        seed: Seed of the random numbers.
    """
    name, sign = objective[0], -1.0 if objective[1] == "max" else 1.0
    tightened = safe_bounds(limits, MARGIN)
    shares = np.column_stack([_shares(axis, starts[:, k]) for k, axis in enumerate(axes)])[: _POPULATION // 2]
    drawn = scipy.stats.qmc.Sobol(len(axes), rng=np.random.default_rng(seed)).random(_POPULATION)
    first = np.clip(np.vstack([shares, drawn])[:_POPULATION], 0.0, 1.0)
    count, scale = 0, 0.0

    def cost(population: Float[np.ndarray, "axes designs"]) -> Float[np.ndarray, " designs"]:
        """Objective of feasible designs over that of the best start; far larger costs of all others."""
        nonlocal count, scale
        count += population.shape[1]
        values = _evaluate(problem, to_designs(axes, population.T))
        violation = constraint_violation(values, tightened)
        size = np.where(np.isnan(values[name]), math.inf, sign * values[name])
        # The first population begins with the best start.
        scale = scale or max((abs(v) for v in size[np.isfinite(size)][:1]), default=0.0) or 1.0
        costs = np.clip(size / scale, -_VIOLATION_COST, _VIOLATION_COST)
        return np.where(violation > 0.0, _VIOLATION_COST * (2.0 + violation), costs)

    point, least = evolve_in_unit_box(cost, first, _GENERATIONS, seed)
    return EvolvedDesign(to_designs(axes, point[None])[0], least < _VIOLATION_COST, count)


def _shares(axis: Axis, values: Float[np.ndarray, " designs"]) -> Float[np.ndarray, " designs"]:
    """Shares at which an axis has given values, also listed ones and whole numbers."""
    if axis.values:
        listed = np.asarray(axis.values)
        return (np.argmin(np.abs(listed[None, :] - values[:, None]), axis=1) + 0.5) / len(listed)
    if axis.whole and not axis.log:
        return (values - axis.lower + 0.5) / (axis.upper - axis.lower + 1.0)
    return np.asarray(axis.share(values))


def _evaluate(problem: AbstractSweepProblem, designs: Float[np.ndarray, "designs axes"]) -> dict[str, np.ndarray]:
    """Metrics of designs, each with the number of steps of a refinement near it; NaN where a simulation failed."""
    steps = np.array([next_power_of_two(int(n)) for n in problem.steps(designs)])
    columns = {n: np.full(len(designs), np.nan) for n in problem.units}
    with on_cpu():
        for level in np.unique(steps):
            rows = steps == level
            values = evaluate_designs(problem, designs[rows], int(level), workers=parallel_batches())
            for n in columns:
                columns[n][rows] = np.where(values["code"] == "done", values[n], np.nan)
    return columns
