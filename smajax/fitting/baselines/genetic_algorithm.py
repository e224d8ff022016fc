"""A real-coded genetic algorithm on pymoo."""

import math
from typing import Any

import numpy as np

from smajax.errors import InputError
from smajax.fitting.abstract_problem import AbstractFitProblem
from smajax.fitting.baselines.meter import BaselineResult, CostMeter, Progress, no_progress

# Standard deviation of a mutation as a share of the range between the bounds. fast_rotary_actuator does not state it;
# chosen by trial.
_MUTATION_WIDTH = 0.1
# Keeps the weights of the roulette finite at a cost of zero.
_TINY = 1e-300


def _make_algorithm(size: int, population: int, generations: int, mating: Any, offspring: int, seed: int) -> Any:
    """Make pymoo's genetic algorithm on the unit cube with this mating."""
    from pymoo.algorithms.soo.nonconvex.ga import GA
    from pymoo.core.problem import Problem as UnitProblem

    algorithm = GA(pop_size=population, n_offsprings=offspring, mating=mating, eliminate_duplicates=False, seed=seed)
    algorithm.setup(
        UnitProblem(n_var=size, n_obj=1, xl=np.zeros(size), xu=np.ones(size)), termination=("n_gen", generations)
    )
    return algorithm


def run_genetic_algorithm(
    problem: AbstractFitProblem,
    *,
    seed: int,
    budget: int | None = None,
    target: float | None = None,
    population: int = 10,
    generations: int = 100,
    crossover: float = 0.8,
    adjustment: float = 0.05,
    mutation: float = 0.3,
    rate: float = 0.02,
    progress: Progress = no_progress,
) -> BaselineResult:
    """Run a genetic algorithm, by default with the settings of fast_rotary_actuator (Table 2).

    The percentages of the paper are taken as shares of the population; the best of the old and new members survive. The
    paper states neither the weights of the roulette nor the width of a mutation. The weights here are 1 / RMSE, since
    the cost in the paper is the RMSE; on the recordings of wires that were tried, they reached lower costs than weights
    of 1 / cost and than exponential weights.

    Args:
        problem: The problem.
        seed: Seed of the search.
        budget: Most simulations.
        target: Cost at which the search ends.
        population: Members.
        generations: Most generations.
        crossover: Number of children per generation over the population; parents are chosen by roulette.
        adjustment: Each gene is between those of its parents, or beyond them by up to this share of their distance.
        mutation: Number of mutants per generation over the population.
        rate: Share of a mutant's genes, at least one gene, that change; the change is normal, with a standard deviation
            of a tenth of the range between the bounds.
        progress: Called with the number of calls of the compiled program and the best cost so far.

    Returns:
        The best point, its cost, and the effort.

    Raises:
        InputError: pymoo is not installed, or the budget does not allow one evaluation of all recordings.

    Source: fast_rotary_actuator, Table 2.
    """
    try:
        from pymoo.core.population import Population
    except ImportError:
        raise InputError('the genetic algorithm needs pymoo: install it by pip install "smajax[baselines]"') from None
    pairs, mutants = math.ceil(crossover * population / 2), round(mutation * population)
    lower, upper = problem.search_bounds()
    meter = CostMeter(problem, max(population, 2 * pairs + mutants), budget, target, progress)
    mating = _breeding(Population, pairs, mutants, adjustment, rate)
    algorithm = _make_algorithm(len(lower), population, generations, mating, 2 * pairs + mutants, seed)

    def run() -> None:
        while algorithm.has_next():
            offspring: Any = algorithm.ask()
            offspring.set("F", meter(lower + offspring.get("X") * (upper - lower))[:, None])
            algorithm.tell(infills=offspring)

    return meter.search("genetic algorithm", run)


def _breeding(population_class: Any, pairs: int, mutants: int, adjustment: float, rate: float) -> Any:
    """The pymoo operator that makes a generation's children and mutants."""
    from pymoo.core.infill import InfillCriterion

    class Breeding(InfillCriterion):
        """Children and mutants of a population, pairs of children first."""

        def _do(self, problem: Any, pop: Any, n_offsprings: int, random_state: Any = None, **kwargs: Any) -> Any:
            x, odds = pop.get("X"), 1.0 / np.sqrt(np.maximum(pop.get("F")[:, 0], _TINY))
            first, second = x[random_state.choice(len(x), (2, pairs), p=odds / odds.sum())]
            blend = random_state.uniform(-adjustment, 1.0 + adjustment, first.shape)
            mutated = x[random_state.integers(len(x), size=mutants)]
            genes = math.ceil(rate * x.shape[1])
            mask = random_state.permuted(np.tile(np.arange(x.shape[1]) < genes, (mutants, 1)), axis=1)
            mutated = mutated + _MUTATION_WIDTH * mask * random_state.standard_normal(mutated.shape)
            offspring = np.concatenate(
                [blend * first + (1.0 - blend) * second, blend * second + (1.0 - blend) * first, mutated]
            )
            return population_class.new("X", np.clip(offspring, 0.0, 1.0))

    return Breeding()
