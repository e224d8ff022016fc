"""Fit a plant's free parameters to recordings."""

import math
import time
from collections.abc import Callable, Sequence
from typing import NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.errors import NumericsError
from smajax.fitting import intervals
from smajax.fitting.abstract_problem import residual
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import SEQUENTIAL_FROM, MultiStartResult, MultiStartSolver, screen_starts
from smajax.fitting.noise import difference_noise
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import Estimate, FitResult, Response
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.diagnostics import describe_parameters
from smajax.simulation.status import SimulationStatus

# Searches that end within this factor of the best cost count as ends at the best. Chosen by trial.
_SAME_COST = 1.001
# A parameter this close to its bound, as a share of its value, is there up to rounding.
_BOUND_MARGIN_OF_VALUE = 1e-9
# The same as a share of the range between the bounds: steps towards a bound grow ever shorter. Chosen by trial,
# tests/unit/fitting/test_fit.py holds it.
_BOUND_MARGIN_OF_RANGE = 1e-6
# Least size of a scaled parameter in the direction of a collinear group, so that one near 0 does not divide by it.
_MIN_SIZE = 1e-3


def fit(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str = "hold",
    step: float | None = None,
    max_steps: int = 100,
    progress: Callable[[int, float], None] = lambda step, cost: None,
) -> FitResult:
    """Fit a plant's free parameters to recordings by bounded least squares from several starts.

    Args:
        plant: The plant with its start values.
        recordings: Training recordings.
        settings: Free parameters, bounds, observed channels, noise, starts and seed.
        holdout: Recordings that are only predicted.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``.
        step: Longest step in s; the plant's default if not given.
        max_steps: Most steps of the search.
        progress: Called after each step with its number and the best cost so far.

    Raises:
        InputError: Recordings and settings do not fit together.
        NumericsError: The simulation fails at every start.
    """
    began = time.perf_counter()
    problem = build_problem(plant, recordings, settings, interpolation=interpolation, step=step)
    starts, screened = screen_starts(problem, settings.starts, settings.seed)
    screening_time = time.perf_counter() - began if screened else 0.0
    solved = _start_searches(problem, starts, len(recordings)).advance(max_steps, progress).result()
    _check_starts(solved, problem, starts[0], plant)
    best, end = _best_end(problem, plant, recordings, settings, holdout, interpolation, step, solved)
    estimates, covariance, groups = _estimates(problem, end.vector, solved.residuals[best], end.jacobian)
    training = end.responses[: len(recordings)]
    return FitResult(
        problem=problem,
        plant=end.plant,
        plants=end.plants,
        estimates=tuple(estimates),
        covariance=covariance,
        collinear_groups=tuple(groups),
        responses=tuple(end.responses),
        noise_floor={c: max(difference_noise(r.residual(c)) for r in training) for c in settings.observe},
        cost=float(solved.costs[best]),
        starts_at_best=int(np.sum(solved.costs <= solved.costs[best] * _SAME_COST)),
        starts=len(starts),
        status=solved.statuses[best],
        steps=solved.steps,
        simulations=solved.simulations + screened,
        wall_time=solved.wall_time,
        compile_time=screening_time + _first_step_excess(solved),
        history=tuple(solved.history),
        seed=settings.seed,
        vector=end.vector,
        interpolation=interpolation,
        step=step,
        discretisation_errors=end.discretisation_errors,
    )


def _start_searches(problem: Problem, starts: np.ndarray, recordings: int) -> MultiStartSolver:
    """The searches at their starts."""
    sequential = recordings >= SEQUENTIAL_FROM
    return MultiStartSolver(residual, problem, starts, *problem.bounds, size=problem.size, sequential=sequential)


def _check_starts(solved: MultiStartResult, problem: Problem, start: np.ndarray, plant: Plant) -> None:
    """Raises ``NumericsError`` if the simulation fails at every start."""
    if any(status is not SolverStatus.failed for status in solved.statuses):
        return
    _, codes = eqx.filter_jit(lambda p, v: p.predict(v))(problem, jnp.asarray(start))
    status = SimulationStatus(int(jnp.max(codes)))
    raise NumericsError(f"{status.name} at the start values: {status.hint}; parameters: {describe_parameters(plant)}")


def _first_step_excess(solved: MultiStartResult) -> float:
    """Time by which the first step took longer than the later ones: that of compiling, s."""
    first = solved.history[0][1] if solved.history else 0.0
    later = (solved.wall_time - first) / max(len(solved.history) - 1, 1)
    return max(first - later, 0.0)


class _End(NamedTuple):
    """The end of one search.

    Attributes:
        vector: The problem's vector.
        jacobian: Jacobian of the residual there.
        plants: The plant of each recording.
        plant: The plant for a new recording.
        responses: Responses to all recordings.
        discretisation_errors: Error of the time steps by channel.
    """

    vector: np.ndarray
    jacobian: np.ndarray
    plants: tuple[Plant, ...]
    plant: Plant
    responses: list[Response]
    discretisation_errors: dict[str, float]


def _best_end(
    problem: Problem,
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    holdout: Sequence[Recording],
    interpolation: str,
    step: float | None,
    solved: MultiStartResult,
) -> tuple[int, _End]:
    """The index of the best search whose plant can simulate the training recordings on its own steps, and its end.

    Next to a thermal runaway the best end may be valid on the problem's steps, and not on those that the fitted plant
    asks for: then the next best counts. The best one is returned where none can.
    """
    order = [int(i) for i in np.argsort(solved.costs) if np.isfinite(solved.costs[i])]
    ends: dict[int, _End] = {}
    for index in order:
        vector, jacobian = problem.order_transformation_ends(solved.points[index], solved.jacobians[index])
        plants, general = _fitted_plants(problem, plant, vector, len(recordings))
        ends[index] = _End(
            vector,
            jacobian,
            plants,
            general,
            *simulate_responses(
                [*plants, *(general for _ in holdout)],
                [*recordings, *holdout],
                ["train"] * len(recordings) + ["holdout"] * len(holdout),
                settings.observe,
                interpolation,
                step,
            ),
        )
        if all(r.status is SimulationStatus.done for r in ends[index].responses if r.role == "train"):
            return index, ends[index]
    return order[0], ends[order[0]]


def _fitted_plants(
    problem: Problem, plant: Plant, vector: np.ndarray, recordings: int
) -> tuple[tuple[Plant, ...], Plant]:
    """The plant of each recording, and the one for a new recording.

    The latter has the mean of what each recording has for itself, and starts as the rig's ``plant`` does.
    """
    shared, own = problem.values(jnp.asarray(vector))
    fitted = parameters.replace(problem.plant, shared)
    plants = tuple(parameters.replace(fitted, {n: v[k] for n, v in own.items()}) for k in range(recordings))
    general = parameters.replace(fitted, {n: jnp.mean(v) for n, v in own.items() if not n.startswith("initial.")})
    for name in own:
        if name.startswith("initial."):
            key = name.removeprefix("initial.")
            general = eqx.tree_at(
                lambda p, key=key: getattr(p.initial, key),
                general,
                getattr(plant.initial, key),
                is_leaf=lambda x: x is None,
            )
    return plants, general


def _estimates(
    problem: Problem, vector: np.ndarray, residual: np.ndarray, jacobian: np.ndarray
) -> tuple[list[Estimate], np.ndarray, list[intervals.CollinearGroup]]:
    """The estimates with their intervals, their covariance (p, p), and the groups of collinear parameters."""
    held = _at_bounds(problem, vector, jacobian.T @ residual)
    count, free = int(np.sum(~held)), np.flatnonzero(~held)
    weight = problem.data.weight
    measured = np.asarray(weight).reshape(-1, weight.shape[-1]) > 0
    series = residual.reshape(measured.shape)
    columns = jacobian.reshape(*measured.shape, -1)[..., free]
    samples = int(np.sum(measured))
    scaled = intervals.estimate_covariance(
        [columns[k][m] for k, m in enumerate(measured)], [series[k][m] for k, m in enumerate(measured)], count
    )
    covariance = np.full((len(vector), len(vector)), np.nan)
    scales = np.array([u.scale for u in problem.unknowns])
    covariance[np.ix_(free, free)] = scaled * np.outer(scales[free], scales[free])
    quantile = intervals.student_quantile(samples, count)
    estimates = []
    for i, unknown in enumerate(problem.unknowns):
        value = float(vector[i] * unknown.scale)
        deviation = math.sqrt(covariance[i, i]) if np.isfinite(covariance[i, i]) else math.inf
        finite = math.isfinite(deviation)
        interval = (value - quantile * deviation, value + quantile * deviation) if finite else (None, None)
        bounds = (unknown.lower, unknown.upper)
        estimates.append(Estimate(unknown.label, value, *interval, unknown.unit, bool(held[i]), bounds))
    names = [problem.unknowns[i].label for i in free]
    sizes = np.array([max(abs(vector[i]), _MIN_SIZE) for i in free])
    return estimates, covariance, intervals.find_collinear_groups(jacobian[:, free], names, sizes)


def _at_bounds(problem: Problem, vector: np.ndarray, gradient: np.ndarray) -> np.ndarray:
    """Which parameters the data press against a bound, shape ``(p,)``."""
    lower, upper = problem.bounds
    span = np.where(np.isfinite(upper - lower), upper - lower, 0.0)
    margin = _BOUND_MARGIN_OF_VALUE * (1.0 + np.abs(vector)) + _BOUND_MARGIN_OF_RANGE * span
    return ((vector <= lower + margin) & (gradient >= 0)) | ((vector >= upper - margin) & (gradient <= 0))
