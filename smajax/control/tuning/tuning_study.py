"""Tuning of a controller for a rig from start to end: feedforward, search, and checks."""

import math
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from types import MappingProxyType
from typing import NamedTuple

import equinox as eqx
import numpy as np

from smajax.control.analysis.case_check import CaseCheck, check_cases
from smajax.control.analysis.cases import Case, make_cases
from smajax.control.analysis.closed_loop_checks import (
    DrawChecks,
    GainEvaluation,
    check_draws,
    evaluate_gains,
    value_at_rest,
)
from smajax.control.analysis.margins import Margins
from smajax.control.analysis.reachable_range import ReachableRange, clip_reference, falls_when_heated, reachable_range
from smajax.control.controller_file.read import ControllerFile
from smajax.control.loop.gains import gain, gains
from smajax.control.tuning.case_retuning import JudgedGains, judge_gains
from smajax.control.tuning.controller_problem import draw_parameters, tuning_problem, with_fit_of_rig
from smajax.control.tuning.feedforward_identification import IdentifiedFeedforward, identify_feedforward, with_inverse
from smajax.control.tuning.margin_backoff import reduce_loop_gain
from smajax.control.tuning.problem import TuningProblem, has_noise
from smajax.control.tuning.retuning import search_gains
from smajax.control.tuning.tune import TuningResult
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.progress import PhasesAndSteps, Reporter

# Fraction of the span of the reference by which it may exceed the reachable range, which is simulated with sampled
# commands. Chosen by trial.
_REACH_TOLERANCE = 0.02
# Smallest span for this tolerance, so that it is positive for a constant reference.
_MIN_SPAN = 1e-12


@dataclass(frozen=True)
class UnreachableReference:
    """A reference that the rig cannot follow, in internal units.

    Attributes:
        lower: Smallest value of the reference.
        upper: Largest value of the reference.
        reachable: Range of the channel that the rig reaches.
        limited: Whether limits or a temperature limiter restrict that range.
        stress_at_rest: Stress at rest, Pa, if it is above its limit already.
        clipped: Whether the gains are tuned for the reference clipped to the range.
    """

    lower: float
    upper: float
    reachable: ReachableRange
    limited: bool
    stress_at_rest: float | None
    clipped: bool


@dataclass(frozen=True, eq=False)
class ControllerTuning:
    """Result of the tuning of a controller for a rig.

    Attributes:
        rig: The rig.
        settings: The content of the controller file, with the feedforward that was identified, and with the reference
            and the weights with which the gains were found.
        file_weights: Weights of the objective in the file.
        seed: Seed of all random numbers.
        start: Evaluation of the start gains on the plant of the rig.
        tuned: Evaluation of the tuned gains on it.
        rollouts: Number of rollouts.
        checks: Checks on draws, for the ``start`` and the ``tuned`` gains; empty without draws.
        reachable: Range of the channel that the rig reaches.
        unreachable: The reference if the rig cannot follow it; ``None`` if it can.
        other_weights: Whether the weights of the tuned gains differ from those in the file.
        identified: The fitted feedforward; ``None`` without one.
        rmse_of_mean: RMS error with the tuned gains under the mean of the pulses, internal unit; ``None`` without a
            carrier.
        timings: Wall time of each part, s.
        interrupted: Whether the tuning was stopped; the gains are then the best ones so far.
        case_checks: Checks on cases that no search has used, for the ``start`` and the ``tuned`` gains; empty where the
            gains are judged by the rollout of the file only.
        retunings: Number of searches for cases that failed.
    """

    rig: Rig
    settings: ControllerFile
    file_weights: Mapping[str, float]
    seed: int
    start: GainEvaluation
    tuned: GainEvaluation
    rollouts: int
    checks: Mapping[str, DrawChecks]
    reachable: ReachableRange
    unreachable: UnreachableReference | None
    other_weights: bool
    identified: IdentifiedFeedforward | None = None
    rmse_of_mean: float | None = None
    timings: Mapping[str, float] = field(default_factory=dict)
    interrupted: bool = False
    case_checks: Mapping[str, CaseCheck] = field(default_factory=dict)
    retunings: int = 0

    @property
    def gains(self) -> dict[str, float]:
        """All gains after the tuning by name, internal units."""
        return {name: float(gain(self.tuned.loop, name)) for name in gains(self.tuned.loop)}

    @property
    def margins(self) -> Margins:
        """Stability margins with the tuned gains."""
        return self.tuned.margins


class _Timer:
    """Wall time of each part of the tuning, and the display of its phases."""

    def __init__(self, progress: PhasesAndSteps):
        self.progress, self.timings = progress, {}

    @contextmanager
    def part(self, name: str, phase: str = "", *, can_stop: bool = False) -> Iterator[None]:
        """Show a phase, and add the wall time of the context to a part."""
        if phase:
            self.progress.phase(phase, can_stop=can_stop)
        begin = time.perf_counter()
        try:
            yield
        finally:
            self.timings[name] = self.timings.get(name, 0.0) + time.perf_counter() - begin


def tune_controller(
    rig: Rig, settings: ControllerFile, *, seed: int | None = None, progress: PhasesAndSteps | None = None
) -> ControllerTuning:
    """Tune the gains of a controller for a rig, and check them.

    A feedforward is identified first. A reference that the rig cannot follow is clipped to what it reaches. The gains
    are searched again with more starts or more weight of the effort, if they are not good enough.
    They are judged on cases that no search has used, and tuned again for those that fail.

    Args:
        rig: The rig.
        settings: The content of a controller file for this rig.
        seed: Seed of all random numbers; by default that of the file.
        progress: Receives the phases and steps; nothing is shown by default. A ``KeyboardInterrupt`` of it while the
            gains are searched ends the tuning with the best gains so far.

    Returns:
        The gains with their metrics, margins and checks, and those of the start.

    Raises:
        InputError: if the fit of [robust] cannot be read, the channel falls with the command, the feedforward cannot be
            identified, or there is no objective.
        NumericsError: if no gains have a finite cost.
    """
    progress, seed = progress or Reporter(), settings.seed if seed is None else seed
    settings = with_fit_of_rig(rig, settings)
    timer, draws = _Timer(progress), draw_parameters(rig, settings, seed)
    settings, identified = _with_feedforward(settings, timer)
    file_weights = settings.weights
    with timer.part("start", "evaluating the start gains"):
        _check_channel(rig, settings)
        settings, reachable, unreachable = _within_reach(settings)
        start = evaluate_gains(settings, _start_gains(settings))
    with timer.part("tune", "tuning", can_stop=True):
        problem = tuning_problem(settings, draws, seed)
        result, tuned, weights = search_gains(settings, problem, reachable, seed, progress)
        settings = replace(settings, weights=weights)
        if settings.prefers_margins:
            result, tuned = reduce_loop_gain(settings, problem, result, tuned)
    chosen = _check_gains(rig, settings, problem, _Chosen(result, tuned, {}, False), draws, seed, timer)
    return ControllerTuning(
        rig=rig,
        settings=settings,
        file_weights=file_weights,
        seed=seed,
        start=start,
        tuned=chosen.evaluation,
        rollouts=chosen.result.rollouts,
        checks=chosen.checks,
        reachable=reachable,
        unreachable=unreachable,
        other_weights=weights is not file_weights and not chosen.is_start,
        identified=identified,
        rmse_of_mean=_rmse_of_mean(settings, chosen.evaluation),
        timings=timer.timings,
        interrupted=chosen.result.interrupted,
        case_checks=chosen.case_checks,
        retunings=chosen.retunings,
    )


class _Chosen(NamedTuple):
    """Gains of a search with their evaluation and checks, as in ``ControllerTuning``."""

    result: TuningResult
    evaluation: GainEvaluation
    checks: dict[str, DrawChecks]
    is_start: bool
    case_checks: Mapping[str, CaseCheck] = MappingProxyType({})
    retunings: int = 0


def _check_gains(
    rig: Rig,
    settings: ControllerFile,
    problem: TuningProblem,
    chosen: _Chosen,
    draws: Mapping[str, np.ndarray],
    seed: int,
    timer: _Timer,
) -> _Chosen:
    """Check gains on draws of parameters and on cases, and tune them again for the cases that fail."""
    progress, result = timer.progress, chosen.result
    progress.finish("checking")
    with timer.part("check"):
        checks = _checks(settings, result, draws)
    # Gains that were tuned for some draws may be worse on the others.
    is_start = bool(checks) and len(checks["start"].failing) < len(checks["tuned"].failing)
    if is_start:
        result = result._replace(point=problem.start, gains=_start_gains(settings))
        checks |= {"tuned": checks["start"]}
        chosen = chosen._replace(result=result, evaluation=evaluate_gains(settings, result.gains))
    chosen = chosen._replace(checks=checks, is_start=is_start)
    if result.interrupted or not (draws or settings.check > 1):
        return chosen
    progress.finish("checking on cases that no search has used")
    with timer.part("judge"):
        judged = judge_gains(settings, problem, result, lambda k: _cases(rig, settings, seed, k), progress)
        case_checks = _case_checks(settings, judged) if settings.check > 1 else {}
        chosen = chosen._replace(result=judged.result, case_checks=case_checks, retunings=judged.rounds)
        if judged.result.gains != result.gains:
            checks = _checks(settings, judged.result, draws)
            tuned = evaluate_gains(settings, judged.result.gains)
            chosen = chosen._replace(evaluation=tuned, checks=checks, is_start=False)
    return chosen


def _case_checks(settings: ControllerFile, judged: JudgedGains) -> dict[str, CaseCheck]:
    """The checks of the start gains and of the tuned ones on the same cases."""
    return {"start": check_cases(settings, _start_gains(settings), judged.check.cases), "tuned": judged.check}


def _cases(rig: Rig, settings: ControllerFile, seed: int, repeat: int) -> list[Case]:
    """The cases of a check, with other random numbers for each ``repeat``; those of draws only for a ``check`` of 1."""
    draws = draw_parameters(rig, settings, seed, repeat)
    cases = make_cases(settings, draws, has_noise(settings.loop), seed, repeat, settings.check)
    return cases if settings.check > 1 else [case for case in cases if case.group == "drawn"]


def _within_reach(settings: ControllerFile) -> tuple[ControllerFile, ReachableRange, UnreachableReference | None]:
    """The settings with a reference that the rig can follow, its range, and the reference of the file if it cannot."""
    reachable = reachable_range(settings.system, settings.loop, settings.scenario, settings.limits)
    clipped = clip_reference(settings.scenario, reachable)
    unreachable = _unreachable_reference(settings, reachable, clipped is not settings.scenario)
    return settings if unreachable is None else replace(settings, scenario=clipped), reachable, unreachable


def _unreachable_reference(
    settings: ControllerFile, reachable: ReachableRange, is_clipped: bool
) -> UnreachableReference | None:
    """The reference if the rig cannot follow it; ``None`` if it can. ``is_clipped``: whether it can be clipped."""
    reference = np.asarray(settings.scenario.reference)
    initial = float(settings.scenario.initial_reference)
    tolerance = _REACH_TOLERANCE * max(float(np.ptp(np.append(reference, initial))), _MIN_SPAN)
    if reachable.lower - tolerance <= reference.min() and reference.max() <= reachable.upper + tolerance:
        return None
    stress = value_at_rest(settings, "stress")
    return UnreachableReference(
        lower=float(reference.min()),
        upper=float(reference.max()),
        reachable=reachable,
        limited=any(k in settings.limits for k in ("temperature", "stress", "current"))
        or settings.loop.temperature_limiter is not None,
        stress_at_rest=stress if stress > settings.limits.get("stress", math.inf) else None,
        clipped=is_clipped,
    )


def _with_feedforward(settings: ControllerFile, timer: _Timer) -> tuple[ControllerFile, IdentifiedFeedforward | None]:
    """The settings with the controller's feedforward, and its fit."""
    if settings.feedforward is None:
        return settings, None
    with timer.part("feedforward", "fitting the feedforward to a slow loop"):
        max_temperature = settings.limits.get("temperature", math.inf)
        identified = identify_feedforward(settings.system, settings.loop, settings.feedforward, max_temperature)
        controller = with_inverse(settings.loop.controller, identified.inverse)
        loop = eqx.tree_at(lambda closed_loop: closed_loop.controller, settings.loop, controller)
    return replace(settings, loop=loop), identified


def _check_channel(rig: Rig, settings: ControllerFile) -> None:
    """Refuse a channel that decreases while the wire is heated."""
    channel, coordinate = settings.loop.channel, rig.plant.mechanism.coordinate
    if channel != coordinate and falls_when_heated(settings.system, settings.loop):
        raise InputError(
            f"{settings.place}: controller.channel: {channel} falls while the wire is heated, and no gain is negative: "
            f"control {coordinate}"
        )


def _start_gains(settings: ControllerFile) -> dict[str, float]:
    """The free gains of the file."""
    return {name: float(gain(settings.loop, name)) for name in settings.bounds}


def _checks(settings: ControllerFile, result: TuningResult, draws: Mapping[str, np.ndarray]) -> dict[str, DrawChecks]:
    """The checks of the start gains and of the tuned ones on draws; empty without draws."""
    gain_sets = {"start": _start_gains(settings), "tuned": result.gains} if draws else {}
    return {stage: check_draws(settings, values, draws) for stage, values in gain_sets.items()}


def _rmse_of_mean(settings: ControllerFile, tuned: GainEvaluation) -> float | None:
    """RMS error with the tuned gains under the mean of the pulses; ``None`` without a carrier."""
    if settings.system.carrier is None:
        return None
    values = {name: float(gain(tuned.loop, name)) for name in settings.bounds}
    return evaluate_gains(replace(settings, system=settings.system.without_carrier()), values).metrics["rmse"]
