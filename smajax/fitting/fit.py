"""Fit a plant's free parameters to recordings."""

import dataclasses
import functools
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from smajax import parameters
from smajax.errors import Cancelled, InputError
from smajax.fitting.bounds import parameters_at_bounds
from smajax.fitting.electrical_noise import (
    RIPPLE_COST,
    InputNoise,
    as_ripple,
    corrected_recordings,
    find_input_noise,
    shares,
)
from smajax.fitting.estimates import estimates_with_intervals, noise_floor, widen
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.memory import fit_memory, search_in_parts
from smajax.fitting.multi_start import (
    MultiStartResult,
)
from smajax.fitting.noisy_inputs import FitEnd, decide_kinds, input_covariance, simulate_errors
from smajax.fitting.problem import Problem, build_problem, require_channels
from smajax.fitting.residual_offsets import residual_offsets
from smajax.fitting.responses import simulate_responses
from smajax.fitting.result import FitResult, Response
from smajax.fitting.searches import Searches, Solver, check_starts, first_step_excess, search_from_starts
from smajax.fitting.transformation_check import (
    needs_transformation,
    transformation_gap,
)
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.status import SimulationStatus

# Most steps of a search unless more are asked for; fits of rigs that converge take 5 to 60.
MAX_STEPS = 100
# Searches that end within this factor of the best cost count as ended at the best one. Chosen by trial.
_SAME_COST = 1.001


def fit(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    *,
    holdout: Sequence[Recording] = (),
    interpolation: str | None = None,
    step: float | None = None,
    max_steps: int = MAX_STEPS,
    solver: Solver | None = None,
    progress: Callable[[int, float], object] = lambda step, cost: None,
) -> FitResult:
    """Fit a plant's free parameters to recordings by bounded least squares from several starts.

    Args:
        plant: The plant with its start values.
        recordings: Training recordings.
        settings: Free parameters, bounds, observed channels, noise, noise of the electrical inputs, starts and seed.
        holdout: Recordings that are only predicted.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; the plant's default if not given.
        max_steps: Most steps of the search.
        solver: Any optimistix least-squares solver or minimiser, which searches within the bounds by a transformation
            to unbounded unknowns (where a parameter ends at its bound, Gauss-Newton and Dogleg may not get there); by
            default ``BoundedLevenbergMarquardt``, whose ``rtol`` counts if it is given, and whose bounds are those of
            ``settings``.
        progress: Called after each step with its number and the best cost so far; stops the search with the best point
            so far if it raises ``StopIteration``, as Ctrl-C does.

    Returns:
        Estimates with 95 % intervals, the fitted plants, and the responses to all recordings, under the inputs that
        a wire most likely gets (``smajax.fitting.electrical_noise``).

    Raises:
        InputError: A channel is missing, a parameter does not exist, nothing is free, or ``solver`` is no
            solver, or ``max_steps`` is not positive.
        NumericsError: The simulation fails at every start.
        Cancelled: The search was stopped in its first step; later, the best point is returned.
    """
    check_solver(solver)
    if max_steps < 1:
        raise InputError(f"max_steps = {max_steps}: give a positive number of steps")
    interpolation = interpolation or plant.interpolation
    require_channels(plant, recordings, settings.observe)
    options = (interpolation, step, max_steps, solver, progress)
    run = functools.partial(_fit_with_noise, plant, recordings, settings, holdout, options)
    return _with_input_noise(run, recordings, find_input_noise(plant, recordings, settings), settings.seed)


def check_solver(solver: Any) -> None:
    """Check that a solver is one of optimistix, or ``None``.

    Args:
        solver: The solver.

    Raises:
        InputError: It is something else.
    """
    if solver is not None and not isinstance(solver, optx.AbstractLeastSquaresSolver | optx.AbstractMinimiser):
        raise InputError(
            f"solver: give an optimistix least-squares solver, such as optimistix.Dogleg(1e-8, 1e-8), not {solver!r}"
        )


def _with_input_noise(
    run: Callable[..., tuple[FitResult, FitEnd]],
    recordings: Sequence[Recording],
    noises: tuple[InputNoise, ...],
    seed: int,
) -> FitResult:
    """Fit with ``run``, again where the wire gets a part of the noise, and widen the intervals by the rest of it."""
    result, end = run(noises)
    inputs = corrected_recordings(recordings, noises, training=True)
    errors = simulate_errors(end, inputs, noises, seed)
    decided, undecided = decide_kinds(end, inputs, noises, errors)
    if result.status is not SolverStatus.interrupted:
        refitted = _refit(run, result, end, noises, decided)
        if refitted is not None:
            result, end, decided = refitted
            undecided = undecided[:0]
            inputs = corrected_recordings(recordings, decided, training=True)
            errors = simulate_errors(end, inputs, decided, seed)
    added = input_covariance(end, errors) + undecided.T @ undecided
    return dataclasses.replace(
        result,
        estimates=widen(result.estimates, result.covariance, result.covariance + added),
        covariance=result.covariance + added,
        input_noise=decided,
    )


def _refit(
    run: Callable[..., tuple[FitResult, FitEnd]],
    result: FitResult,
    end: FitEnd,
    noises: tuple[InputNoise, ...],
    decided: tuple[InputNoise, ...],
) -> tuple[FitResult, FitEnd, tuple[InputNoise, ...]] | None:
    """Fit again, from the end of a fit with the means of plateaus, where the wire gets a part of the scatter.

    Where it is not clear that this is none or all of it, the recorded inputs are fitted as well, and taken where their
    residual is smaller. Returns the fit, its end and the noise of the inputs; ``None`` for the first fit.
    """
    kept = shares(decided) == shares(noises)
    recorded = as_ripple(decided, noises)
    trials = [] if kept else [decided]
    trials += [recorded] if shares(recorded) != shares(decided) else []
    fits = [(*run(trial, start=end.vector), trial) for trial in trials]
    if not fits:
        return None
    total = functools.reduce(lambda first, fit: _with_effort(fit[0], first), fits, result)
    best = min(fits, key=lambda fit: fit[0].cost)
    if kept and best[0].cost > RIPPLE_COST * result.cost:
        return None
    efforts = ("starts", "starts_at_best", "steps", "simulations", "wall_time", "compile_time", "history", "start_gap")
    best_result = dataclasses.replace(best[0], **{name: getattr(total, name) for name in efforts})
    return best_result, best[1], best[2]


def _with_effort(result: FitResult, first: FitResult) -> FitResult:
    """The result of a search that began at the end of another, with the starts and the effort of both."""
    history = [(first.simulations + n, first.wall_time + wall, cost) for n, wall, cost in result.history]
    return dataclasses.replace(
        result,
        starts=first.starts,
        starts_at_best=first.starts_at_best,
        steps=first.steps + result.steps,
        simulations=first.simulations + result.simulations,
        wall_time=first.wall_time + result.wall_time,
        compile_time=first.compile_time + result.compile_time,
        history=(*first.history, *history),
        start_gap=first.start_gap,
    )


def _fit_with_noise(
    plant: Plant,
    recordings: Sequence[Recording],
    settings: Settings,
    holdout: Sequence[Recording],
    options: tuple[str, float | None, int, Solver | None, Callable[[int, float], object]],
    noises: Sequence[InputNoise],
    start: np.ndarray | None = None,
) -> tuple[FitResult, FitEnd]:
    """Fit once with the inputs that a wire most likely gets: the result, and the end of its search.

    ``options`` are interpolation, step, steps of the search, solver and progress of ``fit``; the only start is
    ``start`` if it is given.
    """
    began = time.perf_counter()
    interpolation, step, max_steps, solver, progress = options
    inputs = corrected_recordings(recordings, noises, training=True)
    more = corrected_recordings(holdout, noises, training=False)
    simulation = {"holdout": more, "interpolation": interpolation, "step": step}
    parts = search_in_parts(fit_memory(plant, inputs, settings, **simulation), recordings[0].name)
    problem = build_problem(plant, inputs, settings, interpolation=interpolation, step=step)
    checked = needs_transformation((*settings.free, *settings.per_recording))
    gap = transformation_gap([problem.plant] * len(inputs), inputs, **simulation) if checked else None
    search = search_from_starts(problem, settings, len(inputs), max_steps, solver, progress, began, gap, parts, start)
    check_starts(search, problem, plant)
    if not np.any(np.isfinite(search.result.costs)):
        raise Cancelled("the fit was cancelled before its first step had ended: there is no estimate")
    best, end = _best_end(problem, plant, inputs, settings, more, interpolation, step, search.result)
    end_gap = transformation_gap(end.plants, inputs, **simulation) if checked else None
    recorded = zip(end.responses, [*recordings, *holdout], strict=True)
    end = end._replace(responses=[dataclasses.replace(response, recording=r) for response, r in recorded])
    result = _fit_result(problem, search, best, end, len(inputs), settings.seed, interpolation, step)
    result = dataclasses.replace(result, start_gap=gap, end_gap=end_gap)
    residuals = search.result.residuals[best]
    free = np.flatnonzero(~parameters_at_bounds(end.vector, *problem.bounds, residuals, end.jacobian))
    return result, FitEnd(problem, end.vector, residuals, end.jacobian, free, interpolation == "hold", parts[1])


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
    result: MultiStartResult,
) -> tuple[int, _End]:
    """The index of the best search whose plant can simulate the training recordings on its own steps, and its end.

    Near a thermal runaway the best end may be valid on the problem's steps but not on those of the fitted plant: then
    the next best end is taken. Where no end is valid on its own steps, the best one is returned.
    """
    order = [int(i) for i in np.argsort(result.costs) if np.isfinite(result.costs[i])]
    ends: dict[int, _End] = {}
    for index in order:
        vector, jacobian = problem.order_transformation_ends(result.points[index], result.jacobians[index])
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


def _fit_result(
    problem: Problem,
    search: Searches,
    best: int,
    end: _End,
    recordings: int,
    seed: int,
    interpolation: str,
    step: float | None,
) -> FitResult:
    """The result of a fit whose best search ended at ``end``."""
    result = search.result
    estimates, covariance, groups = estimates_with_intervals(problem, end.vector, result.residuals[best], end.jacobian)
    training = end.responses[:recordings]
    floor = {c: max(noise_floor(r, c) for r in training) for c in problem.channels}
    inside = [i for i, estimate in enumerate(estimates) if not estimate.at_bound]
    return FitResult(
        problem=problem,
        plant=end.plant,
        plants=end.plants,
        estimates=tuple(estimates),
        covariance=covariance,
        collinear_groups=tuple(groups),
        responses=tuple(end.responses),
        noise_floor=floor,
        cost=float(result.costs[best]),
        starts_at_best=int(np.sum(result.costs <= result.costs[best] * _SAME_COST)),
        starts=len(search.starts),
        status=result.statuses[best],
        steps=result.steps,
        simulations=recordings * result.simulations + search.screening_simulations,
        wall_time=result.wall_time,
        compile_time=search.screening_time + first_step_excess(result),
        history=tuple(result.history),
        seed=seed,
        vector=end.vector,
        interpolation=interpolation,
        step=step,
        discretisation_errors=end.discretisation_errors,
        offsets=residual_offsets(problem, result.residuals[best], end.jacobian[:, inside], floor),
    )


def _fitted_plants(
    problem: Problem, plant: Plant, vector: np.ndarray, recordings: int
) -> tuple[tuple[Plant, ...], Plant]:
    """The plant of each recording, and the one for a new recording.

    The plant for a new recording has the mean of the parameters of the single recordings, and the start values of the
    rig's ``plant``.
    """
    shared, own = problem.values(jnp.asarray(vector))
    fitted = parameters.replace(problem.plant, shared, ordered=False)
    plants = tuple(
        parameters.replace(fitted, {n: v[k] for n, v in own.items()}, ordered=False) for k in range(recordings)
    )
    general = parameters.replace(
        fitted, {n: jnp.mean(v) for n, v in own.items() if not n.startswith("initial.")}, ordered=False
    )
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
