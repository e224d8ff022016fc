"""Checks of one set of gains: metrics of its rollout, margins and stability, also on samples of parameters."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np
from jaxtyping import Float

from smajax.channels import numbered
from smajax.control.analysis.instability import Instability, instability_reason
from smajax.control.analysis.margins import Margins, margin_spread, margins_of_draws, worst_margins
from smajax.control.analysis.members import simulate_members
from smajax.control.analysis.reachable_range import ReachableRange
from smajax.control.analysis.step_response import (
    SETTLING_BAND,
    StepResponse,
    find_jumps,
    step_responses,
    tracking_errors,
)
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import with_gains
from smajax.control.loop.rollout import Rollout, Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sampling_period import check_same_period
from smajax.files.documents import finite_or_none

# Draws in one call of the compiled program; chosen by trial for speed.
_BATCH = 64
# Share of the error of an idle rig: gains that leave more than this (above the smallest possible error) do not track.
# Chosen by trial; tests/unit/control/test_tuning.py holds it.
_IDLE_SHARE = 0.9
# An idle error below this share of the reference's span is too small to judge tracking; chosen by trial.
_MIN_IDLE_ERROR = 0.1
# Tolerance of a limit, relative to its scale: that of the searches (search.VIOLATION_TOLERANCE, 1e-3), and the same
# again for the difference between the noise of a search and that of the file.
_LIMIT_TOLERANCE = 2e-3
# Excess over a limit that counts as a violation of order one: in K for a temperature, as a share of the limit for a
# stress or a current. They put the limits on the scale of the objective's terms, which are near 1.
TEMPERATURE_SCALE = 10.0
RELATIVE_SCALE = 0.1


@dataclass(frozen=True, eq=False)
class ControlTask:
    """Control task: a closed loop around a sampled plant, its scenario and its limits.

    Attributes:
        system: The sampled plant.
        loop: The closed loop, with the start gains.
        scenario: Reference, sensor noise and parameter changes.
        limits: Limits by name (``objective.LIMITS``), internal units.
        band: Settling band as a share of a jump.
    """

    system: SampledPlant
    loop: ClosedLoop
    scenario: Scenario
    limits: Mapping[str, float]
    band: float

    def __post_init__(self) -> None:
        check_same_period("plant", self.system.period, "controller", self.loop.period)
        object.__setattr__(self, "loop", self.loop.for_wires(self.system.wires))


@dataclass(frozen=True, eq=False)
class GainEvaluation:
    """Behaviour of the plant of the rig file under one set of gains.

    Attributes:
        loop: The loop with these gains.
        channels: Channels of its rollout by name, internal units, shape ``(n,)`` each.
        command: Commands, shape ``(n, wires)``.
        metrics: Metrics of the rollout in SI units and degC, by their names in tune.json.
        margins: Stability margins along the rollout without noise.
        unstable: Why the gains count as unstable by their rollout without noise; ``None`` if they do not.
        low_margins: The 5 % quantile of the margins over the operating points; ``None`` if it was not computed.
    """

    loop: ClosedLoop
    channels: Mapping[str, np.ndarray]
    command: np.ndarray
    metrics: dict[str, float]
    margins: Margins
    unstable: Instability | None
    low_margins: Margins | None = None


class DrawChecks(NamedTuple):
    """Checks of one set of gains on samples of parameters (draws).

    Attributes:
        document: JSON document with counts of failing draws, metrics and margins.
        failing: Numbers of the draws that are unstable or beyond a limit.
    """

    document: dict[str, Any]
    failing: tuple[int, ...]


def evaluate_gains(task: ControlTask, gains: Mapping[str, float]) -> GainEvaluation:
    """Evaluate gains on the rig's own plant, with the scenario's noise and without noise.

    Args:
        task: The control task.
        gains: Gains in internal units; others keep their start values.

    Returns:
        Rollout, metrics, margins and stability with these gains.
    """
    quiet = task.scenario.without_noise()
    result, quiet_result = (
        simulate_members(task.system, task.loop, scenario, gains) for scenario in (task.scenario, quiet)
    )
    channels = {name: np.asarray(values)[0] for name, values in result.channels.items()}
    command, loop = np.asarray(result.command)[0], with_gains(task.loop, gains)
    reason = _instability_of(task, quiet_result, 0)
    median, low = margin_spread(task.system, loop, quiet)
    return GainEvaluation(loop, channels, command, rollout_metrics(task, channels, command), median, reason, low)


def _instability_of(task: ControlTask, quiet: Rollout, member: int) -> Instability | None:
    """Why a member of a rollout without noise counts as unstable; ``None`` if it does not."""
    value = np.asarray(quiet.channels[task.loop.channel][member])
    return rollout_instability(task, np.asarray(quiet.command[member]), value)


def rollout_instability(
    task: ControlTask, command: Float[np.ndarray, "samples wires"], value: Float[np.ndarray, " samples"]
) -> Instability | None:
    """Return why a rollout without noise counts as unstable; ``None`` if it does not.

    Args:
        task: The control task.
        command: Commands, shape ``(n, wires)``.
        value: Controlled channel, shape ``(n,)``, internal unit.
    """
    lower, upper = task.loop.controller.limits
    return instability_reason(command, np.asarray(task.scenario.reference), value, float(upper) - float(lower))


def jump_responses(task: ControlTask, value: Float[np.ndarray, " samples"]) -> list[StepResponse]:
    """Return the response to each jump of the reference.

    Args:
        task: The control task.
        value: Controlled channel, shape ``(n,)``, internal unit.
    """
    period, reference = task.system.period, np.asarray(task.scenario.reference)
    jumps = find_jumps(reference, float(task.scenario.initial_reference), period)
    return step_responses(value, reference, jumps, period, task.band)


def rollout_metrics(task: ControlTask, channels: Mapping[str, np.ndarray], command: np.ndarray) -> dict[str, float]:
    """Return the metrics of a rollout in SI units and degC, by the names that tune.json has.

    Args:
        task: The control task.
        channels: Channels by name, internal units, shape ``(n,)`` each.
        command: Commands, shape ``(n, wires)``.
    """
    period, value = task.system.period, channels[task.loop.channel]
    metrics = tracking_errors(value, np.asarray(task.scenario.reference), period)
    if responses := jump_responses(task, value):
        metrics |= {name: max(getattr(r, name) for r in responses) for name in ("rise", "settling", "overshoot")}
    metrics["energy"] = float(np.sum([np.sum(channels[n]) for n in wire_channels(task, "power")]) * period)
    metrics["mean_command"] = float(np.mean(np.sum(command, axis=1)))
    for name in ("temperature", "stress", "current"):
        metrics[f"peak_{name}"] = float(np.max([np.max(channels[n]) for n in wire_channels(task, name)]))
    return metrics


def wire_channels(task: ControlTask, name: str) -> tuple[str, ...]:
    """Return the names of a channel of all wires: its name, or its name with the number of each wire.

    Args:
        task: The control task.
        name: Name of the channel without the number of a wire.
    """
    return numbered(name, task.system.wires)


def value_at_rest(task: ControlTask, name: str) -> float:
    """Return the value of a channel at rest without any command, internal unit; the larger one of two wires.

    Args:
        task: The control task.
        name: Name of the channel, with or without the number of a wire.
    """
    channels = task.system.observe(task.system.start(), jnp.zeros(task.system.wires))
    return max(float(channels[n]) for n in ((name,) if name in channels else wire_channels(task, name)))


def check_draws(task: ControlTask, gains: Mapping[str, float], draws: Mapping[str, np.ndarray]) -> DrawChecks:
    """Check gains on samples of parameters.

    Stability is checked first by the rollout without noise and then, as for the rig's own plant, by the margins.

    Args:
        task: The control task.
        gains: Gains in internal units.
        draws: Parameters by name, internal units, shape ``(count,)`` each.

    Returns:
        The failing draws, and a document with their numbers (``unstable``, ``unstable_linearised``,
        ``beyond_a_limit``), quantiles (5, 50, 95 %) and largest values of the metrics, and the worst margins.
    """
    count = len(next(iter(draws.values())))
    size = min(_BATCH, count)
    quiet = task.scenario.without_noise()
    margins = margins_of_draws(task.system, with_gains(task.loop, gains), quiet, draws)
    metrics: list[dict[str, float]] = []
    unstable, unstable_linearised, beyond_a_limit, failing = 0, 0, 0, []
    for first in range(0, count, size):
        # The last batch is padded with the last draw, so that one compiled program serves all batches.
        rows = np.minimum(np.arange(first, first + size), count - 1)
        batch = {n: v[rows] for n, v in draws.items()}
        result, quiet_result = (
            simulate_members(task.system, task.loop, scenario, gains, batch) for scenario in (task.scenario, quiet)
        )
        channels = {n: np.asarray(v) for n, v in result.channels.items()}
        for k in range(min(size, count - first)):
            draw_channels = {n: v[k] for n, v in channels.items()}
            metrics.append(rollout_metrics(task, draw_channels, np.asarray(result.command[k])))
            is_unstable = bool(_instability_of(task, quiet_result, k))
            is_beyond = bool(violated_limits(task.limits, metrics[-1]))
            is_linear_unstable = not is_unstable and margins[first + k].unstable
            unstable, beyond_a_limit = unstable + is_unstable, beyond_a_limit + is_beyond
            unstable_linearised += is_linear_unstable
            failing += [first + k] * (is_unstable or is_beyond or is_linear_unstable)
    document = {
        "draws": count,
        "unstable": unstable,
        "unstable_linearised": unstable_linearised,
        "beyond_a_limit": beyond_a_limit,
    }
    worst = {n: finite_or_none(v) for n, v in worst_margins(margins)._asdict().items()}
    return DrawChecks(document | _spread(metrics) | {"worst_margins": worst}, tuple(failing))


def _spread(metrics: list[dict[str, float]]) -> dict[str, Any]:
    """Quantiles and largest value of each metric."""
    table = {n: np.array([draw_metrics[n] for draw_metrics in metrics]) for n in metrics[0]}
    return {
        "spread": {n: [finite_or_none(float(q)) for q in _quantiles(v)] for n, v in table.items()},
        "worst": {n: finite_or_none(float(np.max(v))) for n, v in table.items()},
    }


def _quantiles(values: np.ndarray) -> np.ndarray:
    """The 5, 50 and 95 % quantiles without NaNs; infinite values, such as a settling time, are included."""
    numbers = np.sort(values[~np.isnan(values)])
    return np.quantile(numbers, [0.05, 0.5, 0.95], method="inverted_cdf") if len(numbers) else np.full(3, np.nan)


def metric_of_limit(name: str) -> str:
    """Return the name of the metric that a limit bounds: ``overshoot``, ``settling``, ``peak_temperature``, ..."""
    return name if name in ("overshoot", "settling") else f"peak_{name}"


def violated_limits(limits: Mapping[str, float], metrics: Mapping[str, float]) -> list[str]:
    """Return the names of the limits that a rollout's metrics violate; NaN violates a limit.

    Args:
        limits: Limits by name, internal units.
        metrics: Metrics of the rollout in the same units: ``overshoot``, ``settling``, ``peak_temperature``, ...
            Limits without a metric are not checked.
    """
    violated = []
    for name, limit in limits.items():
        metric = metric_of_limit(name)
        scales = {"temperature": TEMPERATURE_SCALE, "overshoot": SETTLING_BAND, "settling": max(limit, 1e-9)}
        tolerance = _LIMIT_TOLERANCE * scales.get(name, RELATIVE_SCALE * abs(limit))
        if metric in metrics and not metrics[metric] <= limit + tolerance:
            violated.append(name)
    return violated


def fails_to_track(task: ControlTask, evaluation: GainEvaluation, reachable: ReachableRange) -> bool:
    """Return whether the tracking error is hardly smaller than that of an idle rig, although the rig can follow.

    Args:
        task: The control task.
        evaluation: The gains on the rig's own plant.
        reachable: Range of the channel that the rig reaches.
    """
    idle, smallest = idle_error(task), _smallest_error(task, reachable)
    return idle > 0.0 and evaluation.metrics["rmse"] > smallest + _IDLE_SHARE * (idle - smallest)


def idle_error(task: ControlTask) -> float:
    """Return the RMS tracking error of a rig that stays at rest; 0 if the reference is always near the rest value."""
    rest = value_at_rest(task, task.loop.channel)
    reference = np.append(np.asarray(task.scenario.reference), rest)
    error = float(np.sqrt(np.mean((reference - rest) ** 2)))
    return error if error > _MIN_IDLE_ERROR * float(np.ptp(reference)) else 0.0


def _smallest_error(task: ControlTask, reachable: ReachableRange) -> float:
    """The tracking error (RMS) if the channel always equals the reference clipped to the reachable range."""
    reference = np.asarray(task.scenario.reference)
    clipped = np.clip(reference, reachable.lower, reachable.upper)
    return float(np.sqrt(np.mean((reference - clipped) ** 2)))
