"""Strategies of evosax: CMA-ES and differential evolution, each generation simulated as one batch."""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError, suggestion
from smajax.fitting.abstract_problem import AbstractFitProblem
from smajax.fitting.baselines.meter import BaselineResult, CostMeter, Progress, no_progress

# Costs (m,) of members (m, p) of the unit cube.
CostFunction = Callable[[np.ndarray], np.ndarray]

_STRATEGIES = ("CMA_ES", "DifferentialEvolution")
# Members of CMA-ES; chosen by trial.
_CMA_ES_POPULATION = 16
# Members per parameter of differential evolution: SciPy's default.
_MEMBERS_PER_PARAMETER = 15
# CMA-ES begins at the middle of the unit cube with this standard deviation: about a third of the range, as is usual.
_INITIAL_DEVIATION = 0.3


def run_evosax(
    problem: AbstractFitProblem,
    *,
    seed: int,
    strategy: str = "CMA_ES",
    budget: int | None = None,
    target: float | None = None,
    population: int | None = None,
    generations: int = 1000,
    progress: Progress = no_progress,
) -> BaselineResult:
    """Run CMA-ES or differential evolution of evosax with its default settings.

    The bounds are scaled to the unit cube; members outside are moved to its boundary.

    Args:
        problem: The problem.
        seed: Seed of the search.
        strategy: ``CMA_ES`` or ``DifferentialEvolution``.
        budget: Most simulations.
        target: Cost at which the search ends.
        population: Members; by default 16, or 15 per parameter for differential evolution.
        generations: Most generations.
        progress: Called with the number of calls of the compiled program and the best cost so far.

    Returns:
        The best point, its cost, and the effort.

    Raises:
        InputError: evosax is not installed, it has no such strategy, or the budget does not allow one evaluation of all
            recordings.

    Source: hansen2001 (CMA-ES), storn1997 (differential evolution).
    """
    if strategy not in _STRATEGIES:
        raise InputError(
            f"there is no strategy '{strategy}'{suggestion(strategy, _STRATEGIES)}: choose one of "
            f"{', '.join(_STRATEGIES)}"
        )
    try:
        import evosax.algorithms
    except ImportError:
        raise InputError('this search needs evosax: install it by pip install "smajax[baselines]"') from None
    lower, upper = problem.search_bounds()
    size = len(lower)
    population = population or (_CMA_ES_POPULATION if strategy == "CMA_ES" else _MEMBERS_PER_PARAMETER * size)
    evolution = getattr(evosax.algorithms, strategy)(population_size=population, solution=jnp.zeros(size))

    def evolve(cost: CostFunction, generations: int) -> None:
        _evolve(evolution, strategy, population, size, seed, cost, generations)

    meter = CostMeter(problem, population, budget, target, progress)
    # Two generations on any cost compile evosax's own programs before the clock starts.
    evolve(lambda members: np.sum((members - 0.4) ** 2, axis=1), 2)
    meter.start()
    return meter.search(
        f"evosax {strategy}", lambda: evolve(lambda members: meter(lower + members * (upper - lower)), generations)
    )


def _evolve(
    evolution: Any, strategy: str, population: int, size: int, seed: int, cost: CostFunction, generations: int
) -> None:
    """Run a strategy for some generations in the unit cube."""
    settings = evolution.default_params
    key, first = jax.random.split(jax.random.key(seed))
    if strategy == "CMA_ES":
        deviation = settings.replace(std_init=jnp.asarray(_INITIAL_DEVIATION))
        state = evolution.init(first, jnp.full(size, 0.5), deviation)
    else:
        members = jax.random.uniform(first, (population, size))
        state = evolution.init(first, members, jnp.asarray(cost(np.asarray(members))), settings)
    for _ in range(generations):
        key, ask, tell = jax.random.split(key, 3)
        members, state = evolution.ask(ask, state, settings)
        members = jnp.clip(members, 0.0, 1.0)
        state, _ = evolution.tell(tell, members, jnp.asarray(cost(np.asarray(members))), state, settings)
