"""The population searches that people fit with today, behind one interface, to compare the gradient with on the same compiled simulator.

Each takes a problem and gives a ``Search``. All search the box from which the fit draws its starts, all are compiled before their
clock starts, and all count simulations alike: the cost of a point with ``r`` recordings is ``r`` simulations, a residual with its Jacobian
in ``p`` parameters ``r (1 + p)``. A cost that is not a number is none that these searches could use; it counts as a failure and is shown to
them as ``UNUSABLE``.

pymoo and evosax are extras of the package and imported where they are used.
"""

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any, Literal

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.errors import InputError, nearest
from smajax.fit import least_squares
from smajax.fit.fit import draw_starts
from smajax.fit.searchable import Searchable, costs, residual

# Far above any cost of a simulation that ran, and its square is still a float.
UNUSABLE = 1e30

Ended = Literal["settled", "target", "budget", "interrupted"]
Progress = Callable[[int, float], None]


@dataclasses.dataclass(frozen=True)
class Search:
    """What a search found and what it cost.

    ``vector``, shape ``(p,)``, is the best point in the problem's scaled units and ``cost`` its sum of squares (infinite, at the nominal
    point, if nothing could be simulated). ``wall`` is in s and leaves out ``compile``, the s until the warmed-up program stood ready.
    ``history`` has a row (simulations, wall, best cost) for each improvement and one for the end; ``failures`` counts the simulations of
    points whose cost was not a number.
    """

    name: str
    vector: np.ndarray
    cost: float
    simulations: int
    wall: float
    compile: float
    history: tuple[tuple[int, float, float], ...]
    failures: int
    ended: Ended

    def reach(self, cost: float) -> tuple[int, float] | None:
        """Simulations and wall seconds until the best cost was at or below ``cost``; ``None`` if it never was."""
        return next(((simulations, wall) for simulations, wall, best in self.history if best <= cost), None)


class _Enough(Exception):
    """Thrown out of a search when its target is met or its budget spent; carries which."""


class _Meter:
    """The cost of up to ``size`` points at once, which counts, clocks, keeps the best and ends the search."""

    def __init__(self, problem: Searchable, size: int, budget: int | None, target: float | None, progress: Progress) -> None:
        if budget is not None and budget < problem.data.measured.shape[0]:
            raise InputError(f"a budget of {budget} simulations allows not one look at all recordings: give a larger one")
        self._problem, self._size, self._progress = problem, size, progress
        self._budget = math.inf if budget is None else budget
        self._target = -math.inf if target is None else target
        self._each = problem.data.measured.shape[0]
        self._calls = self._simulations = self._failures = 0
        self._vector, self._cost = problem.nominal, math.inf
        self._history: list[tuple[int, float, float]] = []
        self._created = time.perf_counter()
        self._run(self._vector[None])
        self.start()

    def start(self) -> None:
        """Starts the clock; all before it was compiling."""
        self._began = time.perf_counter()

    def _run(self, vectors: np.ndarray) -> np.ndarray:
        filled = np.resize(vectors, (self._size, vectors.shape[1]))  # repeats: one program serves every number of points
        return np.array(costs(self._problem, jnp.asarray(filled)))[: len(vectors)]

    def __call__(self, vectors: np.ndarray) -> np.ndarray:
        """Costs, shape ``(m,)``, of points, shape ``(m, p)``; throws ``_Enough``."""
        allowed = int(min(len(vectors), (self._budget - self._simulations) // self._each))
        if allowed == 0:
            raise _Enough("budget")
        found = self._run(vectors[:allowed])
        self._calls += 1
        self._simulations += allowed * self._each
        unusable = ~np.isfinite(found)
        self._failures += int(np.sum(unusable)) * self._each
        found[unusable] = UNUSABLE
        best = int(np.argmin(found))
        if found[best] < min(self._cost, UNUSABLE):
            self._vector, self._cost = np.array(vectors[best]), float(found[best])
            self._note()
        self._progress(self._calls, self._cost)
        if self._cost <= self._target:
            raise _Enough("target")
        if allowed < len(vectors):
            raise _Enough("budget")
        return found

    def _note(self) -> None:
        self._history.append((self._simulations, time.perf_counter() - self._began, self._cost))

    def search(self, name: str, run: Callable[[], Any]) -> Search:
        """Runs a search that calls this meter to wherever it ends."""
        ended: Ended = "settled"
        try:
            run()
        except _Enough as enough:
            ended = enough.args[0]
        except KeyboardInterrupt:
            ended = "interrupted"
        self._note()
        return Search(
            name=name,
            vector=self._vector,
            cost=self._cost,
            simulations=self._simulations,
            wall=self._history[-1][1],
            compile=self._began - self._created,
            history=tuple(self._history),
            failures=self._failures,
            ended=ended,
        )


def _nothing(calls: int, cost: float) -> None:
    pass


def gradient(problem: Searchable, *, seed: int, starts: int = 1, max_steps: int = 100, progress: Progress = _nothing) -> Search:
    """The fit's own search: Levenberg-Marquardt from the nominal point and ``starts - 1`` screened ones.

    Ctrl-C keeps the best so far, and so do the searches below. ``progress`` is called with the number of calls of the compiled program and
    the best cost so far.
    """
    created = time.perf_counter()
    least_squares.Search(residual, problem, draw_starts(problem, starts, seed)[0], *problem.box, size=problem.size).advance(1)
    began = time.perf_counter()
    points, screened = draw_starts(problem, starts, seed)
    spent = time.perf_counter() - began
    solved = least_squares.Search(residual, problem, points, *problem.box, size=problem.size).advance(max_steps, progress).result()
    each = problem.data.measured.shape[0]
    ended = np.where(np.isfinite(solved.costs), solved.costs, np.inf)
    best = int(np.argmin(ended))
    history = [(screened + each * simulations, spent + wall, cost) for simulations, wall, cost in solved.history]
    return Search(
        name="gradient" if starts == 1 else f"gradient, {starts} starts",
        vector=solved.points[best],
        cost=float(ended[best]),
        simulations=screened + each * solved.simulations,
        wall=spent + solved.wall,
        compile=began - created,
        history=tuple(history),
        failures=each * sum(stop is least_squares.Stop.failed for stop in solved.stops),
        ended="interrupted" if least_squares.Stop.interrupted in solved.stops else "settled",
    )


def differential_evolution(
    problem: Searchable,
    *,
    seed: int,
    budget: int | None = None,
    target: float | None = None,
    population: int = 15,
    vectorized: bool = False,
    polish: bool = False,
    settles: bool = True,
    progress: Progress = _nothing,
) -> Search:
    """SciPy's differential evolution with its own defaults, but for the local search at its end, which ``polish`` switches on.

    ``population`` is the number of members per parameter. ``vectorized`` simulates each generation as one batch and so replaces members
    only between generations. It ends at a cost of ``target``, at ``budget`` simulations, or, unless ``settles`` is off, when SciPy finds
    the population settled.
    """
    lower, upper = problem.search_box()
    meter = _Meter(problem, population * len(lower) if vectorized else 1, budget, target, progress)

    def cost(x: np.ndarray) -> Any:
        return meter(x.T) if x.ndim == 2 else float(meter(x[None])[0])

    def run() -> None:
        scipy.optimize.differential_evolution(
            cost,
            list(zip(lower, upper, strict=True)),
            popsize=population,
            maxiter=10**9,
            tol=0.01 if settles else 0.0,
            rng=seed,
            polish=polish,
            updating="deferred" if vectorized else "immediate",
            vectorized=vectorized,
        )

    return meter.search("SciPy DE, batched" if vectorized else "SciPy DE", run)


def genetic_algorithm(
    problem: Searchable,
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
    progress: Progress = _nothing,
) -> Search:
    """A real-coded genetic algorithm on pymoo, by default with the settings of the rotary paper (its Table 2).

    The percentages are read as those of the population: each generation adds ``crossover`` times as many children of parents drawn by
    roulette, each gene between its parents' or up to ``adjustment`` of their distance beyond, and ``mutation`` times as many mutants, in
    which a share ``rate`` of the genes, at least one, moves by a normal tenth of the box. The best of old and new survive. The paper gives
    neither the roulette's weights nor the width of a mutation. The weights here are 1 / RMSE, as its cost is the RMSE; on the recordings of
    wires that we tried, they find lower costs than 1 / cost and than exponential weights do.

    Raises ``InputError`` if pymoo is not installed.
    """
    try:
        from pymoo.algorithms.soo.nonconvex.ga import GA
        from pymoo.core.infill import InfillCriterion
        from pymoo.core.population import Population
        from pymoo.core.problem import Problem as Box
    except ImportError:
        raise InputError('the genetic algorithm needs pymoo: install it by pip install "smajax[baselines]"') from None

    pairs, mutants = math.ceil(crossover * population / 2), round(mutation * population)

    class Breeding(InfillCriterion):
        """Children and mutants of a population, pairs of children first."""

        def _do(self, problem: Any, pop: Any, n_offsprings: int, random_state: Any = None, **kwargs: Any) -> Any:
            x, odds = pop.get("X"), 1.0 / np.sqrt(np.maximum(pop.get("F")[:, 0], 1e-300))
            first, second = x[random_state.choice(len(x), (2, pairs), p=odds / odds.sum())]
            blend = random_state.uniform(-adjustment, 1.0 + adjustment, first.shape)
            mutated = x[random_state.integers(len(x), size=mutants)]
            genes = math.ceil(rate * x.shape[1])
            moved = random_state.permuted(np.tile(np.arange(x.shape[1]) < genes, (mutants, 1)), axis=1)
            mutated = mutated + 0.1 * moved * random_state.standard_normal(mutated.shape)
            born = np.concatenate([blend * first + (1.0 - blend) * second, blend * second + (1.0 - blend) * first, mutated])
            return Population.new("X", np.clip(born, 0.0, 1.0))

    lower, upper = problem.search_box()
    meter = _Meter(problem, max(population, 2 * pairs + mutants), budget, target, progress)
    algorithm = GA(pop_size=population, n_offsprings=2 * pairs + mutants, mating=Breeding(), eliminate_duplicates=False, seed=seed)
    algorithm.setup(Box(n_var=len(lower), n_obj=1, xl=np.zeros(len(lower)), xu=np.ones(len(lower))), termination=("n_gen", generations))

    def run() -> None:
        while algorithm.has_next():
            born: Any = algorithm.ask()
            born.set("F", meter(lower + born.get("X") * (upper - lower))[:, None])
            algorithm.tell(infills=born)

    return meter.search("genetic algorithm", run)


_STRATEGIES = ("CMA_ES", "DifferentialEvolution")


def evosax_search(
    problem: Searchable,
    *,
    seed: int,
    strategy: str = "CMA_ES",
    budget: int | None = None,
    target: float | None = None,
    population: int | None = None,
    generations: int = 1000,
    progress: Progress = _nothing,
) -> Search:
    """CMA-ES or differential evolution of evosax at its own settings, each generation simulated as one batch.

    It searches the box scaled to the unit cube, CMA-ES from its middle with a deviation of 0.3; members outside are put on the boundary.
    ``population`` is 16 unless given, for differential evolution 15 per parameter as SciPy has it. Ends after ``generations``. Raises
    ``InputError`` if evosax is not installed or the strategy is another.
    """
    if strategy not in _STRATEGIES:
        raise InputError(f"there is no strategy '{strategy}'{nearest(strategy, _STRATEGIES)}: choose of {', '.join(_STRATEGIES)}")
    try:
        import evosax.algorithms
    except ImportError:
        raise InputError('this search needs evosax: install it by pip install "smajax[baselines]"') from None
    lower, upper = problem.search_box()
    size = len(lower)
    population = population or (16 if strategy == "CMA_ES" else 15 * size)
    evolution = getattr(evosax.algorithms, strategy)(population_size=population, solution=jnp.zeros(size))
    settings = evolution.default_params

    def evolve(cost: Callable[[np.ndarray], np.ndarray], generations: int) -> None:
        key, first = jax.random.split(jax.random.key(seed))
        if strategy == "CMA_ES":
            state = evolution.init(first, jnp.full(size, 0.5), settings.replace(std_init=jnp.asarray(0.3)))
        else:
            members = jax.random.uniform(first, (population, size))
            state = evolution.init(first, members, jnp.asarray(cost(np.asarray(members))), settings)
        for _ in range(generations):
            key, ask, tell = jax.random.split(key, 3)
            members, state = evolution.ask(ask, state, settings)
            members = jnp.clip(members, 0.0, 1.0)
            state, _ = evolution.tell(tell, members, jnp.asarray(cost(np.asarray(members))), state, settings)

    meter = _Meter(problem, population, budget, target, progress)
    evolve(lambda members: np.sum((members - 0.4) ** 2, axis=1), 2)  # compiles evosax's own programs
    meter.start()
    return meter.search(f"evosax {strategy}", lambda: evolve(lambda members: meter(lower + members * (upper - lower)), generations))
