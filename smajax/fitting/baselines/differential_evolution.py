"""SciPy's differential evolution."""

from typing import Any

import numpy as np
import scipy.optimize

from smajax.fitting.abstract_problem import AbstractFitProblem
from smajax.fitting.baselines.meter import BaselineResult, CostMeter, Progress, no_progress

# SciPy's default tolerance of a population that has converged.
_TOLERANCE = 0.01
# No limit to the generations: target, budget or convergence end the search.
_MAX_GENERATIONS = 10**9


def run_differential_evolution(
    problem: AbstractFitProblem,
    *,
    seed: int,
    budget: int | None = None,
    target: float | None = None,
    population: int = 15,
    vectorized: bool = False,
    polish: bool = False,
    settles: bool = True,
    progress: Progress = no_progress,
) -> BaselineResult:
    """Run SciPy's differential evolution with its own defaults, by default without the local search at its end.

    Args:
        problem: The problem.
        seed: Seed of the search.
        budget: Most simulations.
        target: Cost at which the search ends.
        population: Members per parameter.
        vectorized: Simulate each generation as one batch; then members are replaced between generations only.
        polish: Run the local search at the end.
        settles: Whether the search ends when SciPy finds the population converged.
        progress: Called with the number of calls of the compiled program and the best cost so far.

    Returns:
        The best point, its cost, and the effort.

    Raises:
        InputError: The budget does not allow one evaluation of all recordings.

    Source: storn1997.
    """
    lower, upper = problem.search_bounds()
    meter = CostMeter(problem, population * len(lower) if vectorized else 1, budget, target, progress)

    def cost(x: np.ndarray) -> Any:
        return meter(x.T) if x.ndim == 2 else float(meter(x[None])[0])

    def run() -> None:
        scipy.optimize.differential_evolution(
            cost,
            list(zip(lower, upper, strict=True)),
            popsize=population,
            maxiter=_MAX_GENERATIONS,
            tol=_TOLERANCE if settles else 0.0,
            rng=seed,
            polish=polish,
            updating="deferred" if vectorized else "immediate",
            vectorized=vectorized,
        )

    return meter.search("SciPy DE, batched" if vectorized else "SciPy DE", run)
