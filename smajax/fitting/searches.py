"""The searches of a fit: the choice of their starts, and the solver."""

import time
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import jax.numpy as jnp
import numpy as np
import optimistix as optx

from smajax.errors import NumericsError
from smajax.fitting.abstract_problem import residual
from smajax.fitting.levenberg_marquardt import BoundedLevenbergMarquardt, SolverStatus
from smajax.fitting.multi_start import (
    LAZY_FROM,
    MultiStartResult,
    MultiStartSolver,
    screen_displaced_starts,
    screen_starts,
)
from smajax.fitting.optimistix_search import OptimistixSearch
from smajax.fitting.problem import Problem
from smajax.fitting.transformation_check import TransformationGap, displacement_direction
from smajax.fitting.unknowns import Settings
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.plant.plant import Plant
from smajax.simulation.diagnostics import describe_parameters
from smajax.simulation.status import SimulationStatus

Solver: TypeAlias = optx.AbstractLeastSquaresSolver[Any, Any, Any, Any] | optx.AbstractMinimiser[Any, Any, Any]

# Least number of starts where nothing transforms at the nominal values: transformation temperatures may have to change
# by 100 K, and a search finds them from about 15 K away. Chosen by trial; tests/unit/fitting/test_transformation.py
# holds it.
_DISPLACED_STARTS = 7


class Searches(NamedTuple):
    """The searches of a fit.

    Attributes:
        starts: Start points (s, p).
        result: The ends of the searches.
        screening_simulations: Simulations that chose the starts.
        screening_time: Time until the starts were chosen, s; 0 where none were.
    """

    starts: np.ndarray
    result: MultiStartResult
    screening_simulations: int
    screening_time: float


def search_from_starts(
    problem: Problem,
    settings: Settings,
    recordings: int,
    max_steps: int,
    solver: Solver | None,
    progress: Callable[[int, float], object],
    began: float,
    gap: TransformationGap | None,
    parts: tuple[bool, int],
    start: np.ndarray | None,
) -> Searches:
    """Choose the starts and search from all of them.

    Where nothing transforms at the nominal values, starts are laid over values at which the wire transforms.

    Args:
        problem: The problem.
        settings: Settings with the number of starts and the seed.
        recordings: Number of recordings.
        max_steps: Most steps of the search.
        solver: The solver of ``fit``.
        progress: Called after each step.
        began: Time at which the fit began, s.
        gap: How far the wire is from transforming; ``None`` where it transforms.
        parts: The result of ``smajax.fitting.memory.search_in_parts``.
        start: The only start (p,); ``None`` to choose them.
    """
    direction = np.zeros(len(problem.unknowns)) if gap is None else displacement_direction(problem)
    if start is not None:
        starts, screening_simulations = start[None], 0
    elif gap is not None and np.any(direction):
        count = max(_DISPLACED_STARTS, settings.starts - 1)
        arguments = (problem, count, settings.seed, direction, gap.displacements, parts[1])
        starts, screening_simulations = screen_displaced_starts(*arguments)
    else:
        starts, screening_simulations = screen_starts(problem, settings.starts, settings.seed, parts[1])
    screening_time = time.perf_counter() - began if screening_simulations else 0.0
    arguments = (residual, problem, starts, *problem.bounds)
    solver = BoundedLevenbergMarquardt() if solver is None else solver
    if isinstance(solver, BoundedLevenbergMarquardt):
        options = search_options(problem, recordings)
        workers = 1 if parts[0] else None
        searches = MultiStartSolver(*arguments, **options, rtol=float(solver.rtol), workers=workers)
    else:
        searches = OptimistixSearch(solver, *arguments, size=problem.size)
    return Searches(starts, searches.advance(max_steps, progress).result(), screening_simulations, screening_time)


def search_options(problem: Problem, recordings: int) -> dict[str, Any]:
    """Return the options of ``MultiStartSolver`` on which the compiled program of a search depends.

    Args:
        problem: The problem.
        recordings: Number of recordings.
    """
    return {
        "size": problem.size,
        "lazy_jacobian": recordings >= LAZY_FROM or problem.has_structure,
        "secant_updates": problem.has_structure,
    }


def check_starts(search: Searches, problem: Problem, plant: Plant) -> None:
    """Check that the simulation works at one of the starts.

    Args:
        search: The searches.
        problem: Their problem.
        plant: The plant with its start values, for the message.

    Raises:
        NumericsError: It fails at all of them.
    """
    if any(status is not SolverStatus.failed for status in search.result.statuses):
        return
    _, codes = jit_with_kernels(lambda p, v: p.predict(v))(problem, jnp.asarray(search.starts[0]))
    status = SimulationStatus(int(jnp.max(codes)))
    raise NumericsError(f"{status.name} at the start values: {status.hint}; parameters: {describe_parameters(plant)}")


def first_step_excess(result: MultiStartResult) -> float:
    """Return the time by which the first step took longer than the later ones: that of compiling, s.

    Args:
        result: The searches.
    """
    first = result.history[0][1] if result.history else 0.0
    later = (result.wall_time - first) / max(len(result.history) - 1, 1)
    return max(first - later, 0.0)
