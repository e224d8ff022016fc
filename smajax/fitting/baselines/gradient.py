"""The fit's own search, with its effort counted like that of the population searches."""

import time

import numpy as np

from smajax.fitting.abstract_problem import AbstractFitProblem, residual
from smajax.fitting.baselines.meter import BaselineResult, Progress, no_progress
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver, screen_starts


def run_gradient_search(
    problem: AbstractFitProblem, *, seed: int, starts: int = 1, max_steps: int = 100, progress: Progress = no_progress
) -> BaselineResult:
    """Run Levenberg-Marquardt from the nominal point and ``starts - 1`` screened ones.

    Ctrl-C, or ``StopIteration`` in ``progress``, keeps the best so far.

    Args:
        problem: The problem.
        seed: Seed of the random starts.
        starts: Number of starts.
        max_steps: Most steps.
        progress: Called after each step with its number and the best cost so far.

    Returns:
        The best point, its cost, and the effort.

    Source: marquardt1963.
    """
    created = time.perf_counter()
    warm_up = MultiStartSolver(
        residual, problem, screen_starts(problem, starts, seed)[0], *problem.bounds, size=problem.size
    )
    warm_up.advance(1)
    began = time.perf_counter()
    points, screened = screen_starts(problem, starts, seed)
    screening_time = time.perf_counter() - began
    solver = MultiStartSolver(residual, problem, points, *problem.bounds, size=problem.size)
    result = solver.advance(max_steps, progress).result()
    recordings = problem.data.measured.shape[0]
    final_costs = np.where(np.isfinite(result.costs), result.costs, np.inf)
    best = int(np.argmin(final_costs))
    history = [
        (screened + recordings * simulations, screening_time + wall, cost) for simulations, wall, cost in result.history
    ]
    return BaselineResult(
        name="gradient" if starts == 1 else f"gradient, {starts} starts",
        vector=result.points[best],
        cost=float(final_costs[best]),
        simulations=screened + recordings * result.simulations,
        wall_time=screening_time + result.wall_time,
        compile_time=began - created,
        history=tuple(history),
        failures=recordings * sum(status is SolverStatus.failed for status in result.statuses),
        end_reason="interrupted" if SolverStatus.interrupted in result.statuses else "settled",
    )
