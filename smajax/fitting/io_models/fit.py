"""Fit an input-output model to recordings.

The search for models of few parameters, and the result of any fit: the model, its parameters and their intervals. The
search for networks is in ``smajax.fitting.io_models.networks``.
"""

import dataclasses
import math
import time
from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jax.flatten_util import ravel_pytree

from smajax.errors import Cancelled, NumericsError
from smajax.fitting.abstract_problem import compiled_residual, costs, residual
from smajax.fitting.bounds import parameters_at_bounds, parameters_near_bounds
from smajax.fitting.compilation import SEARCH_OPTIONS
from smajax.fitting.intervals import confidence_half_widths, covariance_under_autocorrelation
from smajax.fitting.io_models.networks import fit_network
from smajax.fitting.io_models.problem import (
    IOModelProblem,
    ModelSpec,
    Series,
    build_io_problem,
    check_rows,
    check_sampling,
)
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver
from smajax.laws import response
from smajax.laws.base import AbstractInputOutputModel
from smajax.numerics.stored_programs import stored
from smajax.progress import CallbackStop, stoppable

# All constants of the search were chosen by trial on the recordings of tests/unit/laws/test_input_output_models.py,
# which holds the errors of the fits.
# A parameter whose bounds differ by more than this factor has an unknown order of magnitude: its logarithm is drawn.
_LOGARITHMIC_FACTOR = 30.0
# Random points per start.
_POINTS_PER_START = 8
# Share of the entries of a random point that are taken from the first guess.
_FIRST_GUESS_SHARE = 0.5
# Most rounds of starts.
_MAX_ROUNDS = 5
# Points near the best end so far at which each round but the first begins.
_POINTS_PER_ROUND = 3
# Standard deviation of these points, as a share of the distance between the bounds.
_ROUND_SPREAD = 0.01
# The last round is the first that lowers the cost by less than this share.
_MIN_DECREASE = 1e-3


@dataclasses.dataclass(frozen=True)
class IOModelFit:
    """A fitted input-output model.

    Attributes:
        spec: The kind of model.
        model: The model.
        parameters: Its parameters, a pytree.
        rmse: Pooled RMSE of the training series, in the output's unit.
        samples: Measured rows.
        simulations: Simulations that the search took.
        wall_time: Time including compiling, s.
        step: Time between the rows that it was fitted to, s.
        ridge: Strength of the ridge on a network's weights; 0 for other models.
        divergence_rate: Share of reordered inputs on which a network diverges; 0 for other models.
        half_widths: Half-widths of the parameters' 95 % intervals, a pytree: infinite where the recording does not
            determine the parameter, NaN for fixed parameters and for those at a bound. ``None`` for networks, whose
            weights have no intervals.
        held: Whether a bound holds each parameter, a pytree of the structure of ``parameters``.
        interrupted: Whether the fit was stopped before its end.
    """

    spec: ModelSpec
    model: AbstractInputOutputModel
    parameters: Any
    rmse: float
    samples: int
    simulations: int
    wall_time: float
    step: float
    ridge: float = 0.0
    divergence_rate: float = 0.0
    half_widths: Any = None
    held: Any = None
    interrupted: bool = False

    def _leaves(self) -> Iterator[tuple[str, np.ndarray, np.ndarray, np.ndarray, np.ndarray]]:
        """Name, value, lower and upper bound, and half-width of each leaf of the parameters."""
        trees = (
            self.parameters,
            self.spec.lower,
            self.spec.upper,
            self.parameters if self.half_widths is None else self.half_widths,
        )
        for (path, value), *others in zip(*(jax.tree_util.tree_leaves_with_path(tree) for tree in trees), strict=True):
            low, high, half = (np.asarray(other) for _, other in others)
            half = half if self.half_widths is not None else np.full(low.shape, np.nan)
            yield ".".join(str(key.key) for key in path), np.asarray(value), low, high, half

    @property
    def values(self) -> dict[str, dict[str, Any]]:
        """The parameters by name, as lists, with the ends of their 95 % intervals; ``None`` where there are none."""

        def finite_or_none(values: Any) -> Any:
            return np.asarray(np.where(np.isfinite(values), values, None)).tolist()

        return {
            name: {
                "value": finite_or_none(value),
                "lower95": finite_or_none(value - half),
                "upper95": finite_or_none(value + half),
                "free": bool(np.any(low < high)),
            }
            for name, value, low, high, half in self._leaves()
        }

    @property
    def undetermined(self) -> tuple[str, ...]:
        """The free parameters whose interval is wider than their bounds; for an array, with the number of entries."""
        names = []
        for name, value, low, high, half in self._leaves():
            wider = 2.0 * half > high - low
            if np.any(wider):
                names.append(f"{name} ({np.sum(wider)} of {value.size})" if value.ndim else name)
        return tuple(names)

    @property
    def at_bound(self) -> tuple[str, ...]:
        """The free parameters that ended at a bound, with that bound; for an array, with the number of entries."""
        names = []
        for (name, value, low, high, _), mask in zip(self._leaves(), jax.tree.leaves(self.held), strict=True):
            if np.any(mask):
                end = low if np.all(value - low < high - value) else high
                names.append(f"{name} ({f'{np.sum(mask)} of {mask.size}' if mask.ndim else f'{float(end):.4g}'})")
        return tuple(names)

    def respond(self, series: Series) -> np.ndarray:
        """Compute the model's output on a series.

        Args:
            series: A series; only its times and inputs are used.

        Returns:
            The output (n,), in the unit of the training outputs.

        Raises:
            InputError: The model needs rows of the step that it was fitted to, and these have another step.
        """
        check_sampling(self.spec, series, self.step)
        return np.asarray(_respond(self.model, jnp.asarray(series.time), jnp.asarray(series.input), evenly_spaced=True))


_respond = stored(response.compute_response, compiler_options=SEARCH_OPTIONS)


class _SearchEnd(NamedTuple):
    """End of a search; residual and Jacobian at the vector are ``None`` for networks."""

    vector: np.ndarray | None
    simulations: int
    ridge: float = 0.0
    divergence_rate: float = 0.0
    residual: np.ndarray | None = None
    jacobian: np.ndarray | None = None


def fit_io_model(
    spec: ModelSpec,
    series: Sequence[Series],
    *,
    starts: int = 8,
    seed: int = 0,
    max_steps: int = 150,
    progress: Callable[[int, float], object] = lambda step, cost: None,
) -> IOModelFit:
    """Fit an input-output model to series by least squares from several starts.

    Args:
        spec: The kind of model.
        series: Training recordings.
        starts: Number of starts.
        seed: Seed of the random starts.
        max_steps: Most steps of each search.
        progress: Called after each step of a search with its number and its cost; ends the fit with the best point so
            far if it raises ``StopIteration``, as Ctrl-C does. Networks call it after each search.

    Returns:
        The fitted model, its parameters and their 95 % intervals.

    Raises:
        InputError: There are not more measured rows than parameters, or the rows are not evenly sampled where the model
            needs that.
        NumericsError: The residual is not finite at any start.
        Cancelled: The fit was stopped before it had a result.
    """
    began = time.perf_counter()
    try:
        result = _fit(spec, series, starts, seed, max_steps, _StopRequest(progress))
    except (CallbackStop, KeyboardInterrupt):
        raise Cancelled(f"the fit of {spec.name} was cancelled before it had a result") from None
    return dataclasses.replace(result, wall_time=time.perf_counter() - began)


class _StopRequest:
    """A progress callback that goes on stopping all searches of a fit once one was stopped.

    Attributes:
        is_set: Whether the fit is to be stopped.
    """

    def __init__(self, progress: Callable[[int, float], object]):
        self._progress, self.is_set = stoppable(progress), False

    def __call__(self, step: int, cost: float) -> None:
        """Report a step; raises ``CallbackStop`` if the fit is to be stopped."""
        try:
            self._progress(step, cost)
        except CallbackStop:
            self.is_set = True
        if self.is_set:
            raise CallbackStop


def _fit(
    spec: ModelSpec, series: Sequence[Series], starts: int, seed: int, max_steps: int, stop: _StopRequest
) -> IOModelFit:
    """The fit of a model and of those nested in it, without its wall time."""
    problem = build_io_problem(spec, series)
    samples = int(np.sum(np.asarray(problem.data.weight) > 0))
    check_rows(" and ".join(s.name for s in series), samples, spec.size, spec.name)
    nested = []
    if spec.weight_mask is None:
        nested = [(_fit(simpler, series, starts, seed, max_steps, stop), embed) for simpler, embed in spec.nested]
        nested_points = [problem.scaled_vector(embed(simpler.parameters)) for simpler, embed in nested]
        end = _least_squares(problem, spec, nested_points, starts, seed, max_steps, stop)
        end = end._replace(simulations=end.simulations + sum(simpler.simulations for simpler, _ in nested))
    else:
        mask = ravel_pytree(spec.weight_mask)[0]
        network = fit_network(problem, mask, starts, seed, max_steps, stop)
        stop.is_set |= network.interrupted
        end = _SearchEnd(network.vector, network.simulations, network.ridge, network.divergence_rate)
    if end.vector is None:
        raise NumericsError(
            f"{spec.name}: its residual is not finite at any point between its bounds: check the recordings' units"
        )
    result = dataclasses.replace(_fit_at(problem, spec, series, samples, end), interrupted=stop.is_set)
    if spec.prefers_simpler:
        simpler = nested[-1][0]
        # Difference of Schwarz's criterion (BIC): 2 ln of the likelihoods' ratio against ln n per parameter.
        gain = 2.0 * samples * math.log(simpler.rmse / result.rmse)
        if gain < (spec.size - simpler.spec.size) * math.log(samples):
            return dataclasses.replace(simpler, simulations=end.simulations)
    return result


def _fit_at(
    problem: IOModelProblem, spec: ModelSpec, series: Sequence[Series], samples: int, end: _SearchEnd
) -> IOModelFit:
    """The fit at the end of a search, without its wall time."""
    vector: Any = end.vector
    weighted = np.asarray(compiled_residual(jnp.asarray(vector), problem)) / float(jnp.max(problem.data.weight))
    flat = problem.lower + jnp.asarray(vector) * problem.width
    maker: Any = problem.make
    half_widths, held = None, _held_parameters(problem, end)
    if end.residual is not None and end.jacobian is not None:
        half_widths = maker.unravel(jnp.asarray(_half_widths(problem, held, end.residual, end.jacobian)))
    return IOModelFit(
        spec=spec,
        model=problem.make(flat),
        parameters=maker.unravel(flat),
        rmse=float(np.sqrt(np.sum(weighted**2) / samples)),
        samples=samples,
        simulations=end.simulations,
        wall_time=0.0,
        step=float(np.median(np.diff(series[0].time))),
        ridge=end.ridge,
        divergence_rate=end.divergence_rate,
        half_widths=half_widths,
        held=jax.tree.map(lambda leaf: np.asarray(leaf) > 0.0, maker.unravel(jnp.asarray(held, float))),
    )


def _held_parameters(problem: IOModelProblem, end: _SearchEnd) -> np.ndarray:
    """Mask (p,) of the free parameters that a bound holds.

    The scale of a parameter is its value, or its first guess if that is larger.
    """
    vector: Any = end.vector
    (low, high), width, bottom = problem.bounds, np.asarray(problem.width), np.asarray(problem.lower)
    sizes = [np.abs(bottom + width * position) for position in (vector, problem.nominal)]
    scales = np.maximum(*sizes) / np.where(width > 0.0, width, 1.0)
    if end.residual is None or end.jacobian is None:
        held = parameters_near_bounds(vector, low, high, scales)
    else:
        held = parameters_at_bounds(vector, low, high, end.residual, end.jacobian, scales)
    return held & (low < high)


def _half_widths(problem: IOModelProblem, held: np.ndarray, residual: np.ndarray, jacobian: np.ndarray) -> np.ndarray:
    """Half-widths (p,) of the parameters' 95 % intervals at the end of a fit, as in ``IOModelFit``."""
    low, high = problem.bounds
    free = np.flatnonzero((low < high) & ~held)
    measured = np.asarray(problem.data.weight) > 0
    residuals, columns = (v.reshape(*measured.shape, *v.shape[1:]) for v in (residual, jacobian))
    covariance = covariance_under_autocorrelation(
        [columns[k][rows][:, free] for k, rows in enumerate(measured)],
        [residuals[k][rows] for k, rows in enumerate(measured)],
        len(free),
    )
    half = np.full(len(held), np.nan)
    half[free] = confidence_half_widths(covariance, int(np.sum(measured)), len(free))
    return half * np.asarray(problem.width)


def _least_squares(
    problem: IOModelProblem,
    spec: ModelSpec,
    nested_points: Sequence[np.ndarray],
    starts: int,
    seed: int,
    max_steps: int,
    stop: _StopRequest,
) -> _SearchEnd:
    """Levenberg-Marquardt from the first guess, the fits of nested models, and the best of many random points.

    A stopped search ends with the best point so far; one that is stopped before it began, with the fit of the nested
    model.
    """
    lower, upper = problem.bounds
    guesses = (np.clip(problem.scaled_vector(guess), lower, upper)[None] for guess in spec.extra_starts)
    screened = np.vstack([_random_points(problem, _POINTS_PER_START * starts, seed), *guesses])
    screened_costs = np.asarray(costs(problem, jnp.asarray(screened)))
    order = np.argsort(np.where(np.isfinite(screened_costs), screened_costs, np.inf))
    nested = [np.clip(point, lower, upper)[None] for point in nested_points]
    points = np.vstack([problem.nominal, *nested, screened[order[: starts - 1]]])
    if stop.is_set and nested:
        points = nested[-1]
    rng, simulations, best, least = np.random.default_rng(seed), len(screened), _SearchEnd(None, 0), math.inf
    for _ in range(_MAX_ROUNDS):
        before = least
        for point in points:
            solver = MultiStartSolver(residual, problem, point[None], lower, upper, size=problem.size)
            result = solver.advance(max_steps, stop).result()
            simulations += result.simulations
            if result.costs[0] < least:
                least = float(result.costs[0])
                best = _SearchEnd(result.points[0], 0, residual=result.residuals[0], jacobian=result.jacobians[0])
            if SolverStatus.interrupted in result.statuses:
                stop.is_set = True
            if stop.is_set:
                break
        if stop.is_set and best.vector is None:
            raise CallbackStop
        if stop.is_set or best.vector is None or not spec.nonsmooth or not least < (1.0 - _MIN_DECREASE) * before:
            break
        points = best.vector + _ROUND_SPREAD * rng.standard_normal((_POINTS_PER_ROUND, len(best.vector)))
    return best._replace(simulations=simulations * problem.data.measured.shape[0])


def _random_points(problem: IOModelProblem, count: int, seed: int) -> np.ndarray:
    """Random points (count, p) between the bounds; half of their entries are taken from the first guess.

    Of parameters whose order of magnitude is unknown, such as time constants, the logarithm is drawn.
    """
    low, width = np.asarray(problem.lower), np.asarray(problem.width)
    rng = np.random.default_rng(seed)
    share = rng.uniform(*problem.bounds, (count, len(low)))
    wide = (low > 0.0) & (low + width > _LOGARITHMIC_FACTOR * low)
    safe = np.where(wide, low, 1.0)
    logarithmic = safe * (((safe + width) / safe) ** share - 1.0) / np.where(width > 0.0, width, 1.0)
    points = np.where(wide, logarithmic, share)
    return np.where(rng.random(points.shape) < _FIRST_GUESS_SHARE, problem.nominal, points)
