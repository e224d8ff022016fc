"""The population searches and the gradient behind one interface: the same optimum, the same counting, the same manners."""

import importlib.util
import math
import sys
from types import SimpleNamespace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import InputError
from smajax.fitting.baselines import (
    gradient,
    meter,
    run_differential_evolution,
    run_evosax,
    run_genetic_algorithm,
    run_gradient_search,
)
from smajax.fitting.problem import Problem, build_problem
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate
from tests.support.plants import dead_weight

TRUTH = {"heat.h0": 112.0, "material.max_transformation_strain": 0.038}


def needs(package: str):
    """Skips where an extra is not installed."""
    return pytest.mark.skipif(
        importlib.util.find_spec(package) is None, reason=f"{package} is not installed (extra 'baselines')"
    )


def batched_de(problem, **options):
    return run_differential_evolution(problem, vectorized=True, **options)


def evosax_cma(problem, **options):
    with jax.numpy_rank_promotion("allow"):  # evosax is not written for the strictness of these tests
        return run_evosax(problem, **options)


def evosax_de(problem, **options):
    return evosax_cma(problem, strategy="DifferentialEvolution", **options)


POPULATIONS = [
    run_differential_evolution,
    batched_de,
    pytest.param(run_genetic_algorithm, marks=needs("pymoo")),
    pytest.param(evosax_cma, marks=needs("evosax")),
    pytest.param(evosax_de, marks=needs("evosax")),
]


def measured(name: str, level: float) -> Recording:
    """150 samples of a true plant, heated and let cool, without noise."""
    time = 0.05 * np.arange(150)
    current = level * ((time > 0.3) & (time < 4.0))
    empty = Recording.from_arrays(name, time, {"current": current}, {})
    truth = parameters.replace(dead_weight(), TRUTH)
    contraction = np.asarray(simulate(truth, empty).channels["displacement"])
    return Recording.from_arrays(name, time, {"current": current, "displacement": contraction}, {})


def fitted_to(*recordings: Recording) -> Problem:
    settings = SimpleNamespace(free=tuple(TRUTH), per_recording=(), initial=(), bounds={}, starts=1, seed=0)
    settings.observe, settings.noise = ("displacement",), {"displacement": 1e-5}
    return build_problem(dead_weight(), recordings, settings)


@pytest.fixture(scope="module")
def problem() -> Problem:
    """Two free parameters, one recording, cost zero at the truth."""
    return fitted_to(measured("a.csv", 0.36))


@pytest.fixture(scope="module")
def two_recordings() -> Problem:
    return fitted_to(measured("a.csv", 0.36), measured("b.csv", 0.31))


@pytest.fixture
def bowl(monkeypatch):
    """Replaces the simulation by a parabola with its minimum 0 at (1.3, 0.8), and notes every batch of points."""
    seen = []

    def costs(problem, vectors):
        seen.append(np.asarray(vectors))
        return np.sum((np.asarray(vectors) - [1.3, 0.8]) ** 2, axis=1)

    monkeypatch.setattr(meter, "costs", costs)
    return seen


residual = eqx.filter_jit(Problem.residual)


def errors(problem: Problem, vector: np.ndarray) -> list[float]:
    return [abs(x * u.scale / TRUTH[u.name] - 1) for x, u in zip(vector, problem.unknowns, strict=True)]


@pytest.mark.slow
@pytest.mark.parametrize("search", POPULATIONS)
def test_populations_find_the_truth(problem, search):
    result = search(problem, seed=1, budget=1200)
    assert max(errors(problem, result.vector)) < 0.03
    start, reached = (
        float(np.sum(np.asarray(residual(problem, jnp.asarray(v))) ** 2)) for v in (problem.nominal, result.vector)
    )
    assert result.cost < 1e-2 * start
    assert result.cost == pytest.approx(reached, rel=1e-6)


@pytest.mark.slow
def test_gradient_finds_the_truth_with_far_fewer_simulations(problem):
    steps = []
    result = run_gradient_search(problem, seed=1, progress=lambda step, cost: steps.append(cost))
    assert max(errors(problem, result.vector)) < 1e-4
    assert result.simulations == len(steps) * (1 + 2) < 100  # a residual and two tangents a step
    assert result.effort_to_reach(steps[0])[0] == 3
    assert result.end_reason == "settled" and result.failures == 0 and result.name == "gradient"


def test_gradient_counts_starts_and_recordings(two_recordings, monkeypatch):
    padded = jnp.zeros(two_recordings.size - 2)
    monkeypatch.setattr(
        gradient, "residual", lambda vector, problem: jnp.append(vector - jnp.asarray([1.3, 0.8]), padded)
    )
    monkeypatch.setattr(
        gradient, "screen_starts", lambda problem, starts, seed: (np.array([[1.0, 1.0], [0.5, 2.0]]), 96)
    )
    result = run_gradient_search(two_recordings, seed=1, starts=2, max_steps=4)
    assert result.name == "gradient, 2 starts" and result.cost < 1e-9
    assert [n for n, _, _ in result.history] == [
        96 + 2 * steps * 2 * (1 + 2) for steps in range(1, len(result.history) + 1)
    ]
    assert result.simulations == result.history[-1][0]


@pytest.mark.slow
@pytest.mark.parametrize("search", POPULATIONS)
def test_same_seed_same_search(problem, bowl, search):
    first, again, other = (search(problem, seed=s, budget=300) for s in (5, 5, 6))
    assert np.array_equal(first.vector, again.vector)
    assert [(n, c) for n, _, c in first.history] == [(n, c) for n, _, c in again.history]
    assert not np.array_equal(first.vector, other.vector)


@pytest.mark.slow
@pytest.mark.parametrize("search", POPULATIONS)
def test_budget_is_kept_to_the_last_simulation(problem, two_recordings, bowl, search):
    result = search(problem, seed=0, budget=157)
    assert result.simulations == 157 and result.end_reason == "budget"
    assert search(two_recordings, seed=0, budget=157).simulations == 156  # two recordings: two simulations a point
    with pytest.raises(
        InputError,
        match=r"^a budget of 1 simulations does not allow to simulate all recordings once: give a larger one$",
    ):
        search(two_recordings, seed=0, budget=1)


@pytest.mark.parametrize("search", POPULATIONS)
def test_search_stays_in_the_box(problem, bowl, search):
    search(problem, seed=0, budget=400)
    lower, upper = problem.search_bounds()
    points = np.concatenate(bowl)
    assert np.all(points >= lower - 1e-12) and np.all(points <= upper + 1e-12)
    assert np.ptp(points, axis=0) == pytest.approx(upper - lower, rel=0.5)


@pytest.mark.parametrize("search", POPULATIONS)
def test_target_ends_the_search(problem, bowl, search):
    result = search(problem, seed=0, budget=3000, target=0.02)
    assert result.end_reason == "target" and result.cost <= 0.02 and result.simulations < 3000
    assert result.effort_to_reach(0.02) == result.history[-2][:2]
    assert all(cost > 0.02 for _, _, cost in result.history[:-2])


def test_history_and_reach(problem, bowl):
    result = run_differential_evolution(problem, seed=0, budget=200)
    simulations, wall, cost = map(np.array, zip(*result.history, strict=True))
    assert np.all(np.diff(simulations) >= 0) and np.all(np.diff(wall) >= 0) and np.all(np.diff(cost) <= 0)
    assert simulations[-1] == result.simulations and cost[-1] == result.cost and wall[-1] == result.wall_time
    assert result.effort_to_reach(float(cost[0])) == (simulations[0], wall[0])
    assert result.effort_to_reach(-1.0) is None


def test_scipy_calls_are_the_simulations(problem, bowl):
    calls = []
    result = run_differential_evolution(problem, seed=0, budget=10**6, progress=lambda count, cost: calls.append(count))
    assert result.end_reason == "settled" and calls == list(range(1, result.simulations + 1))
    assert len(bowl) == result.simulations + 1  # one more to warm up
    assert result.cost < 1e-4


@needs("pymoo")
def test_genetic_algorithm_counts_as_the_paper_sets_it(problem, two_recordings, bowl):
    result = run_genetic_algorithm(problem, seed=0)
    assert (
        result.simulations == 10 + 99 * (8 + 3) and result.end_reason == "settled"
    )  # the first generation is the ten drawn ones
    assert run_genetic_algorithm(two_recordings, seed=0).simulations == 2 * result.simulations
    assert run_genetic_algorithm(problem, seed=0, generations=7, population=20).simulations == 20 + 6 * (16 + 6)


@needs("pymoo")
def test_genetic_algorithm_keeps_its_best(problem, bowl):
    progress = []
    run_genetic_algorithm(problem, seed=3, progress=lambda count, cost: progress.append(cost))
    assert len(progress) == 100 and np.all(np.diff(progress) <= 0) and progress[-1] < 0.01 * progress[0]


@pytest.mark.slow
@needs("evosax")
def test_evosax_counts_whole_generations(problem, bowl):
    assert evosax_cma(problem, seed=0, generations=9).simulations == 9 * 16
    assert evosax_cma(problem, seed=0, generations=9, population=6).simulations == 9 * 6
    assert evosax_de(problem, seed=0, generations=9).simulations == 10 * 30  # and the one it starts with


@pytest.mark.parametrize("search", POPULATIONS)
def test_costs_that_are_no_numbers_are_counted_and_survived(problem, bowl, monkeypatch, search):
    whole = meter.costs

    def half(problem, vectors):
        return np.where(np.asarray(vectors)[:, 0] > 1.4, np.nan, whole(problem, vectors))

    monkeypatch.setattr(meter, "costs", half)
    result = search(problem, seed=0, budget=900)
    assert 0 < result.failures < result.simulations
    assert result.cost < 0.01 and math.isfinite(result.cost)


@pytest.mark.parametrize("search", POPULATIONS)
def test_nothing_but_failures(problem, bowl, monkeypatch, search):
    monkeypatch.setattr(meter, "costs", lambda problem, vectors: np.full(len(vectors), np.inf))
    result = search(problem, seed=0, budget=100)
    assert 0 < result.failures == result.simulations <= 100
    assert result.cost == math.inf and np.array_equal(result.vector, problem.nominal)


@pytest.mark.parametrize("signal", [KeyboardInterrupt, StopIteration])
@pytest.mark.parametrize("search", POPULATIONS)
def test_interrupt_keeps_the_best_so_far(problem, bowl, search, signal):
    costs = []

    def stop(count, cost):
        costs.append(cost)
        if count == 3:
            raise signal

    result = search(problem, seed=0, progress=stop)
    assert result.end_reason == "interrupted" and result.cost == costs[-1] < math.inf
    assert result.cost == pytest.approx(float(np.sum((result.vector - np.array([1.3, 0.8])) ** 2)))


@pytest.mark.parametrize("signal", [KeyboardInterrupt, StopIteration])
def test_gradient_interrupted_keeps_the_best_so_far(problem, signal):
    def stop(step, cost):
        if step == 2:
            raise signal

    result = run_gradient_search(problem, seed=0, progress=stop)
    assert result.end_reason == "interrupted" and result.simulations == 2 * 3 and math.isfinite(result.cost)


@pytest.mark.parametrize(("search", "package"), [(run_genetic_algorithm, "pymoo"), (run_evosax, "evosax")])
def test_a_missing_extra_is_named(problem, monkeypatch, search, package):
    for name in [name for name in sys.modules if name.split(".")[0] == package]:
        monkeypatch.delitem(sys.modules, name)
    monkeypatch.setitem(sys.modules, package, None)
    with pytest.raises(InputError, match=rf'needs {package}: install it by pip install "smajax\[baselines\]"$'):
        search(problem, seed=0)


def test_unknown_strategy(problem):
    with pytest.raises(
        InputError, match=r"^there is no strategy 'CMAES' \(did you mean 'CMA_ES'\?\): choose one of CMA_ES, Diff"
    ):
        run_evosax(problem, seed=0, strategy="CMAES")
