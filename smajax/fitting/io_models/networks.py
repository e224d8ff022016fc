"""The fit of networks, which have more weights than a recording can determine.

A ridge regularises the weights, and training goes from open to closed loop.

The cost is the mean square of the residual over the output's variance, plus ``ridge**2`` times the sum of squares of
the weights' changes from the first guess. Ridges are tried from the strongest to the weakest. Under the strongest, with
which a network is nearly a linear model, each start is trained in open loop, over longer and longer stretches, and then
in closed loop; under each weaker one in closed loop only, from the ends so far and from points near them. Most starts
end at the same point; where neurons with equal weights become different, the points near it lead to different ends.
Networks that start at random under a weak ridge often diverge in closed loop; networks trained in this way seldom do.

The network that fits one order of inputs best may still diverge on another. Each end is therefore simulated on the
training inputs in other orders, and the ends that diverge on the fewest of them are preferred (``divergence_rate``).
"""

import contextlib
import dataclasses
import functools
import math
from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx
from jaxtyping import Array, Float

from smajax.fitting.abstract_problem import AbstractFitProblem, costs, residual
from smajax.fitting.compilation import SEARCH_OPTIONS
from smajax.fitting.io_models.problem import IOModelProblem, SeriesData
from smajax.fitting.multi_start import MultiStartSolver
from smajax.numerics.ensemble import share_among_cores
from smajax.numerics.nonsmooth import clip
from smajax.numerics.stored_programs import stored
from smajax.progress import CallbackStop, stoppable

# All constants were chosen by trial on the recordings of tests/unit/laws/test_input_output_models.py, which holds the
# fits.
# Ridges, from one with which a network is nearly a linear model to one that hardly affects its weights.
_RIDGES = (0.3, 0.1, 0.03, 0.01, 3e-3, 1e-3)
# Distance from the first guess at which a search begins, as a share of the range between the bounds.
_START_SPREAD = 0.05
# The same from the end of a search.
_NEARBY_SPREAD = 0.005
# Number of stretches of the measured rows that are held out in turn.
_FOLDS = 4
# Ridges whose prediction errors are within this factor are equally good.
_EQUAL_ERROR = 1.1
# Numbers of rows after which a network's past outputs are reset to the measured ones; after these stages, never.
_RESET_INTERVALS = (1, 5, 25, 125)
# Relative decrease of the cost at which an intermediate search ends.
_INTERMEDIATE_RTOL = 1e-3
# The same for the last search.
_FINAL_RTOL = 1e-6
# An intermediate search has the number of steps of the last one divided by this.
_FEWER_STEPS = 4
# Ends whose costs agree within this factor count as the same.
_SAME_COST = 1.001
# Ends beyond this factor of the least cost are dropped.
_MAX_COST_RATIO = 1.25
# Most ends that are kept.
_MAX_ENDS = 3
# A network diverges on reordered inputs if its output is outside the measured range by more than this share of it.
_DIVERGENCE_MARGIN = 0.5
# Pieces into which the inputs are cut to be reordered.
_PIECES = 12
# Number of random orders; each is simulated forwards and backwards.
_ORDERS = 8
# Relative tolerance of BFGS.
_BFGS_RTOL = 1e-6
# Absolute tolerance of BFGS.
_BFGS_ATOL = 1e-9
# Most steps of BFGS.
_BFGS_STEPS = 300
# A gradient in reverse mode costs about three simulations.
_SIMULATIONS_PER_GRADIENT = 3


class RidgeProblem(AbstractFitProblem):
    """A problem with a ridge, a penalty on changes from the first guess.

    Attributes:
        data: The series.
        problem: The problem without the ridge.
        penalty: Weight of each parameter's change (p,).
    """

    data: SeriesData
    problem: IOModelProblem
    penalty: jax.Array

    @property
    def size(self) -> int:
        """Length of the residual."""
        return self.problem.size + self.penalty.shape[0]

    @property
    def nominal(self) -> np.ndarray:
        """The first guess, shape ``(p,)``."""
        return self.problem.nominal

    @property
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the problem without the ridge, each of shape ``(p,)``."""
        return self.problem.bounds

    def residual(self, vector: Float[Array, " p"]) -> Float[Array, " size"]:
        """Return the problem's residual, followed by the weighted changes from the first guess, ``(r * n + p,)``."""
        return jnp.append(self.problem.residual(vector), self.penalty * (vector - self.problem.first_guess))


class NetworkFit(NamedTuple):
    """The end of a network's fit.

    Attributes:
        vector: The problem's vector (p,); ``None`` where the cost is not finite at any start.
        simulations: Number of simulations.
        ridge: Strength of the ridge.
        divergence_rate: Share of the reordered inputs on which the network diverges.
        interrupted: Whether the fit was stopped before its end.
    """

    vector: np.ndarray | None
    simulations: int
    ridge: float
    divergence_rate: float
    interrupted: bool = False


def fit_network(
    problem: IOModelProblem,
    weight_mask: jax.Array,
    starts: int,
    seed: int,
    max_steps: int,
    progress: Callable[[int, float], object] = lambda step, cost: None,
) -> NetworkFit:
    """Fit a network under weaker and weaker ridges, and choose the ridge by cross-validation.

    With each ridge the network is fitted to all rows and to all but one stretch of them, each stretch in turn. The
    prediction error of a ridge is that on the stretches that were left out, of the worst of the ends: under a ridge
    with which networks diverge, a single end may still predict well by chance. The strongest ridge is chosen whose
    error is within 10 % of the least, since other recordings differ from the training recordings; the search stops
    after two ridges in a row that are not better than those before. Among the ends of a ridge, and among the ridges,
    those with the lowest divergence rate are preferred.

    Args:
        problem: The problem.
        weight_mask: 1 for parameters that the ridge penalises, 0 for the others (p,).
        starts: Number of starts.
        seed: Seed of the random starts.
        max_steps: Most steps of each search.
        progress: Called after the first search and after each ridge with its number and the cost of the best end; if it
            raises ``StopIteration``, the ridges so far are compared, and the chosen end is not refined. Ctrl-C after
            the first search does the same.

    Returns:
        The end of the fit under the chosen ridge.
    """
    path = _fit_ridges(problem, weight_mask, starts, seed, max_steps // _FEWER_STEPS, stoppable(progress))
    lowest_rate, least = min(path.errors)
    chosen = min(k for k, error in enumerate(path.errors) if error <= (lowest_rate, _EQUAL_ERROR * least))
    ridge_problem, rows = _with_ridge(problem, weight_mask, _RIDGES[chosen]), problem.data.time.shape[1]
    last = None
    if not path.stopped:
        with contextlib.suppress(KeyboardInterrupt):
            last = _train(ridge_problem, path.best[chosen], (rows,), max_steps, _FINAL_RTOL)
    if last is None:
        rate = float(divergence_rate(problem, path.best[chosen])[0])
        simulations = path.simulations * problem.data.measured.shape[0]
        return NetworkFit(path.best[chosen][0], simulations, _RIDGES[chosen], rate, interrupted=True)
    candidates = np.vstack([last.vectors, path.best[chosen]])
    rates = divergence_rate(problem, candidates)
    vector = candidates[np.argmin(rates)] if last.costs[0] < math.inf else None
    simulations = (path.simulations + last.simulations) * problem.data.measured.shape[0]
    return NetworkFit(vector, simulations, _RIDGES[chosen], float(np.min(rates)))


class _RidgePath(NamedTuple):
    """The fits under each ridge.

    Attributes:
        errors: Divergence rate and prediction error on the stretches that were left out, for each ridge.
        best: The end of lowest divergence rate, shape ``(1, p)``, for each ridge.
        simulations: Number of simulations per recording.
        stopped: Whether the fits were stopped before the last ridge.
    """

    errors: list[tuple[float, float]]
    best: list[np.ndarray]
    simulations: int
    stopped: bool = False


def _fit_ridges(
    problem: IOModelProblem,
    weight_mask: jax.Array,
    starts: int,
    seed: int,
    max_steps: int,
    progress: Callable[[int, float], object],
) -> _RidgePath:
    """Fit the problem and its folds under each ridge, from the strongest to the weakest."""
    (lower, upper), rng = problem.bounds, np.random.default_rng(seed)
    width = upper > lower

    def near(point: np.ndarray, spread: float, count: int) -> np.ndarray:
        return np.clip(point + spread * width * rng.standard_normal((count, len(lower))), lower, upper)

    def train(part: IOModelProblem, ridge: float, points: np.ndarray, intervals: tuple[int, ...]) -> _TrainingEnds:
        return _train(_with_ridge(part, weight_mask, ridge), points, intervals, max_steps, _INTERMEDIATE_RTOL)

    folds, rows = blocked_k_fold(problem), problem.data.time.shape[1]
    problems = [problem, *(training for training, _ in folds)]
    first = train(problem, _RIDGES[0], near(problem.nominal, _START_SPREAD, starts), (*_RESET_INTERVALS, rows))
    ends, simulations, errors, best = [first] * len(problems), first.simulations, [], []
    for number, ridge in enumerate(_RIDGES):
        points = [
            np.vstack([end.vectors, near(end.vectors[0], _NEARBY_SPREAD, _MAX_ENDS - len(end.vectors))]) for end in ends
        ]
        try:
            progress(number + 1, float(ends[0].costs[0]))
            pairs = list(zip(problems, points, strict=True))
            ends = share_among_cores(lambda pair, ridge=ridge: train(pair[0], ridge, pair[1], (rows,)), pairs)
        except (CallbackStop, KeyboardInterrupt):
            # Before the first ridge there is the end of the first search alone.
            errors, best = errors or [(0.0, math.inf)], best or [first.vectors[:1]]
            return _RidgePath(errors, best, simulations, stopped=True)
        simulations += sum(end.simulations for end in ends)
        fold_errors = [np.max(_rms(holdout, end.vectors)) for (_, holdout), end in zip(folds, ends[1:], strict=True)]
        rates = divergence_rate(problem, ends[0].vectors)
        errors.append((float(np.min(rates)), float(np.sqrt(np.mean(np.square(fold_errors))))))
        best.append(ends[0].vectors[[np.argmin(rates)]])
        if len(errors) > 2 and min(errors[-2:]) >= min(errors[:-2]) and min(errors)[0] == 0.0:
            break
    return _RidgePath(errors, best, simulations)


def divergence_rate(problem: IOModelProblem, vectors: np.ndarray) -> np.ndarray:
    """Compute the share of reordered inputs on which each network diverges.

    The training inputs are cut into pieces and joined in random orders, forwards and backwards. A network diverges
    where its output is outside the measured range by more than half of it, or not finite.

    Args:
        problem: The problem.
        vectors: The problem's vectors (s, p), one for each network.

    Returns:
        The shares (s,), from 0 to 1.
    """
    data, rng = problem.data, np.random.default_rng(0)
    pieces = np.array_split(np.arange(data.input.shape[1]), _PIECES)
    measured = np.asarray(data.measured)[np.asarray(data.weight) > 0]
    margin = _DIVERGENCE_MARGIN * np.ptp(measured)
    bounded = []
    for direction in _ORDERS * (1, -1):
        rows = np.concatenate([pieces[k] for k in rng.permutation(_PIECES)])[::direction]
        reordered = dataclasses.replace(problem, data=dataclasses.replace(data, input=data.input[:, rows]))
        outputs = np.asarray(_outputs(reordered, jnp.asarray(vectors)))
        # NaN counts as divergence, since comparisons with it are false.
        inside = (measured.min() - margin <= outputs) & (outputs <= measured.max() + margin)
        bounded.append(np.all(inside, axis=(1, 2)))
    return 1.0 - np.mean(bounded, axis=0)


@functools.partial(stored, compiler_options=SEARCH_OPTIONS)
def _outputs(problem: IOModelProblem, vectors: jax.Array) -> jax.Array:
    """Outputs at points, shape ``(s, r, n)``."""
    return jax.lax.map(problem.predict, vectors)


def _rms(problem: IOModelProblem, vectors: np.ndarray) -> np.ndarray:
    """Root mean square of the residual at each point, shape ``(s,)``; infinite where it is not finite."""
    samples = max(int(jnp.sum(problem.data.weight > 0)), 1)
    values = np.sqrt(np.asarray(costs(problem, jnp.asarray(vectors))) / samples)
    return np.where(np.isfinite(values), values, math.inf)


def blocked_k_fold(problem: IOModelProblem) -> list[tuple[IOModelProblem, IOModelProblem]]:
    """Split the measured rows into stretches for cross-validation.

    Args:
        problem: The problem.

    Returns:
        For each stretch the problem with the rows of all others, and the problem with its own rows.
    """
    measured = np.cumsum(np.asarray(problem.data.weight) > 0, axis=1)
    stretch = np.minimum(_FOLDS * (measured - 1) // np.maximum(measured[:, -1:], 1), _FOLDS - 1)

    def restricted_to(rows: np.ndarray) -> IOModelProblem:
        weight = jnp.where(jnp.asarray(rows), problem.data.weight, 0.0)
        return dataclasses.replace(problem, data=dataclasses.replace(problem.data, weight=weight))

    return [(restricted_to(stretch != k), restricted_to(stretch == k)) for k in range(_FOLDS)]


def _with_ridge(problem: IOModelProblem, weight_mask: jax.Array, ridge: float) -> RidgeProblem:
    penalty = ridge * jnp.sqrt(jnp.sum(problem.data.weight > 0)) * weight_mask * problem.width
    return RidgeProblem(problem.data, problem, penalty)


class _TrainingEnds(NamedTuple):
    """The few best ends that differ, best first.

    Attributes:
        vectors: The problem's vectors (s, p).
        costs: Sums of squares (s,); infinite where not finite.
        simulations: Number of simulations per recording.
    """

    vectors: np.ndarray
    costs: np.ndarray
    simulations: int


def _train(
    ridge_problem: RidgeProblem, points: np.ndarray, reset_intervals: tuple[int, ...], max_steps: int, rtol: float
) -> _TrainingEnds:
    """Train from each point over longer and longer stretches by Levenberg-Marquardt, then in closed loop by BFGS.

    Points are trained one after another: a batch takes as long per start, and runs until its last search has ended.
    """
    ends, end_costs, simulations = [], [], 0
    lower, upper = ridge_problem.bounds
    for point in points:
        for interval in reset_intervals:
            problem = dataclasses.replace(
                ridge_problem.problem, resets_outputs=True, reset_interval=jnp.asarray(interval)
            )
            stage = dataclasses.replace(ridge_problem, problem=problem)
            solver = MultiStartSolver(residual, stage, point[None], lower, upper, size=stage.size, rtol=rtol)
            result = solver.advance(max_steps).result()
            simulations += result.simulations
            point = result.points[0]
        vector, steps = _minimise_closed_loop(
            jnp.asarray(point), ridge_problem, (jnp.asarray(lower), jnp.asarray(upper))
        )
        pair = np.stack([point, np.asarray(vector)])
        pair_costs = np.asarray(costs(ridge_problem, jnp.asarray(pair)))
        pair_costs = np.where(np.isfinite(pair_costs), pair_costs, math.inf)
        best = int(np.argmin(pair_costs))
        ends.append(pair[best])
        end_costs.append(pair_costs[best])
        simulations += _SIMULATIONS_PER_GRADIENT * int(steps)
    chosen = _distinct_ends(end_costs)
    return _TrainingEnds(np.stack(ends)[chosen], np.array(end_costs)[chosen], simulations)


def _distinct_ends(end_costs: list[float]) -> list[int]:
    """Indices of the best ends whose costs differ, best first."""
    order = np.argsort(end_costs, stable=True).tolist()
    chosen = [order[0]]
    for k in order[1:]:
        if _SAME_COST * end_costs[chosen[-1]] < end_costs[k] < _MAX_COST_RATIO * end_costs[chosen[0]]:
            chosen.append(k)
    return chosen[:_MAX_ENDS]


@functools.partial(stored, compiler_options=SEARCH_OPTIONS)
def _minimise_closed_loop(
    point: jax.Array, ridge_problem: RidgeProblem, bounds: tuple[jax.Array, jax.Array]
) -> tuple[jax.Array, jax.Array]:
    """The end of BFGS (p,) and its number of steps; outside the bounds the cost is that of the nearest point inside."""

    def cost(vector: jax.Array, ridge_problem: RidgeProblem) -> jax.Array:
        return jnp.mean(ridge_problem.residual(clip(vector, *bounds)) ** 2)

    solver = optx.BFGS(rtol=_BFGS_RTOL, atol=_BFGS_ATOL)
    solution = optx.minimise(cost, solver, point, args=ridge_problem, max_steps=_BFGS_STEPS, throw=False)
    return clip(solution.value, *bounds), solution.stats["num_steps"]
