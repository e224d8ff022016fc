"""Document tune.json: gains, metrics, margins and checks before and after the tuning, and problems."""

import math
from collections.abc import Mapping
from typing import Any, NamedTuple

import numpy as np

from smajax import __version__
from smajax.channels import CHANNELS
from smajax.control.analysis.closed_loop_checks import (
    GainEvaluation,
    fails_to_track,
    idle_error,
    value_at_rest,
    violated_limits,
)
from smajax.control.analysis.reachable_range import ReachableRange, clip_reference
from smajax.control.controller_file.read import ControllerFile
from smajax.control.loop.gains import gain, gains, unit_of
from smajax.control.tuning.feedforward_identification import IdentifiedFeedforward
from smajax.files.documents import finite_or_none
from smajax.report import prediction
from smajax.report.documents.tune import TuneDocument
from smajax.report.tuning import format_metric, margin_words, stabilising_advice

# Fraction of the span of the reference by which it may exceed the reachable range, which is simulated with sampled
# commands. Chosen by trial.
_REACH_TOLERANCE = 0.02
# Smallest span for this tolerance, so that it is positive for a constant reference.
_MIN_SPAN = 1e-12
# Failures of draws in words, by the key of their number in the document.
_DRAW_FAILURES = {
    "unstable": "are unstable",
    "unstable_linearised": "are unstable, linearised along their rollouts",
    "beyond_a_limit": "are beyond a limit",
}


class TunedLoop(NamedTuple):
    """Result of a tuning.

    Attributes:
        start: Evaluation of the start gains on the plant of the rig.
        tuned: Evaluation of the tuned gains on it.
        rollouts: Number of rollouts.
        checks: Documents of the checks on draws, for the ``start`` and the ``tuned`` gains; empty without draws.
        unreachable: Reason why the rig cannot follow the reference; empty if it can.
        reachable: Range of the channel that the rig reaches.
        other_weights: Whether the weights of the tuned gains differ from those in the file.
    """

    start: GainEvaluation
    tuned: GainEvaluation
    rollouts: int
    checks: Mapping[str, Any]
    unreachable: str
    reachable: ReachableRange
    other_weights: bool = False


def tune_document(settings: ControllerFile, rig_name: str, tuned_loop: TunedLoop, seed: int) -> dict[str, Any]:
    """Return the entries of tune.json that all controllers have.

    Args:
        settings: The controller file.
        rig_name: Name of the rig file.
        tuned_loop: Result of the tuning.
        seed: Seed of all random numbers.
    """
    start, tuned = tuned_loop.start, tuned_loop.tuned
    table = _gain_table(settings, start, tuned)
    violated = violated_limits(settings.limits, tuned.metrics)
    failures = _failing_draws(tuned_loop.checks)
    return {
        "schema": TuneDocument.SCHEMA,
        "rig": rig_name,
        "controller": settings.name,
        "channel": settings.loop.channel,
        "unit": CHANNELS[settings.loop.channel].unit,
        "feasible": not (violated or tuned.unstable or tuned.margins.unstable or failures),
        "problems": _problems(settings, tuned_loop),
        "gains": table,
        "metrics": {
            "start": {n: finite_or_none(v) for n, v in start.metrics.items()},
            "tuned": {n: finite_or_none(v) for n, v in tuned.metrics.items()},
        },
        "limits": {n: finite_or_none(v) for n, v in settings.limits.items()},
        "margins": {
            "start": {n: finite_or_none(v) for n, v in start.margins._asdict().items()},
            "tuned": {n: finite_or_none(v) for n, v in tuned.margins._asdict().items()},
        },
        "stable": {"start": not start.unstable, "tuned": not tuned.unstable},
        "robust": dict(tuned_loop.checks),
        "start_kept": bool(tuned_loop.checks) and all(entry["start"] == entry["tuned"] for entry in table.values()),
        "objective": {"settle": settings.settle, "weights": dict(settings.weights)},
        "rollouts": tuned_loop.rollouts,
        "seed": seed,
        "smajax": __version__,
    }


def _gain_table(settings: ControllerFile, start: GainEvaluation, tuned: GainEvaluation) -> dict[str, Any]:
    channel = settings.loop.channel
    command = CHANNELS[settings.system.plant.drive.control].unit
    usual = "K" if CHANNELS[channel].unit == "degC" else prediction.usual_unit(channel)
    return {
        name: {
            "start": finite_or_none(float(gain(start.loop, name))),
            "tuned": finite_or_none(float(gain(tuned.loop, name))),
            "unit": settings.units[name],
            "usual_unit": unit_of(name, tuned.loop, command, usual),
            "free": name in settings.bounds,
            "bounds": [finite_or_none(end) for end in settings.bounds.get(name, (None, None))],
        }
        for name in gains(settings.loop)
    }


def _problems(settings: ControllerFile, tuned_loop: TunedLoop) -> list[str]:
    """Return the reasons why the result or the start is not usable."""
    start, tuned = tuned_loop.start, tuned_loop.tuned
    problems = [f"the start gains are unstable: {start.unstable}"] if start.unstable else []
    if not start.unstable and start.margins.unstable:
        margins = margin_words(start.margins.gain, start.margins.phase)
        problems.append(f"the start gains are unstable, linearised along their rollout, with {margins}")
    problems += [tuned_loop.unreachable] if tuned_loop.unreachable else []
    problems += [
        _limit_words(settings, name, tuned.metrics) for name in violated_limits(settings.limits, tuned.metrics)
    ]
    if tuned.unstable:
        problems.append(f"the best gains are unstable: {tuned.unstable}")
    elif tuned.margins.unstable:
        margins = margin_words(tuned.margins.gain, tuned.margins.phase)
        advice = stabilising_advice(settings.settle)
        problems.append(f"the best gains are unstable, linearised along their rollout, with {margins}: {advice}")
    if fails_to_track(settings, tuned, tuned_loop.reachable):
        errors = [tuned.metrics["rmse"], idle_error(settings)]
        shown = [format_metric(error, "rmse", settings.loop.channel) for error in errors]
        problems.append(
            f"the best gains do not follow the reference: their error is {shown[0]}, that of an idle rig {shown[1]}; "
            "try more starts, other start gains or wider limits"
        )
    if failures := _failing_draws(tuned_loop.checks):
        words = " and ".join(f"{count} {_DRAW_FAILURES[k]}" for k, count in failures.items())
        problems.append(
            f"of {tuned_loop.checks['tuned']['draws']} draws {words} with the best gains: reduce the variation, "
            "or raise robust.draws"
        )
    return problems


def _limit_words(settings: ControllerFile, name: str, metrics: Mapping[str, float]) -> str:
    """Return a sentence on a limit that the tuned gains violate."""
    key = name if name in metrics else f"peak_{name}"
    value, limit = (format_metric(v, key, settings.loop.channel) for v in (metrics[key], settings.limits[name]))
    metric = value if math.isfinite(metrics[key]) else "no finite value"
    return f"the limit on {name} is not met: it is {limit}, and the best gains give {metric}"


def _failing_draws(checks: Mapping[str, Any]) -> dict[str, int]:
    """Return the numbers of draws that fail with the tuned gains, by failure, without zeros."""
    return {k: checks["tuned"][k] for k in _DRAW_FAILURES if checks and checks["tuned"][k]}


def unreachable_reference(settings: ControllerFile, reachable: ReachableRange) -> str:
    """Return a sentence on a reference that the rig cannot follow; an empty text if it can.

    Args:
        settings: The controller file.
        reachable: Range of the channel that the rig reaches.
    """
    reference, channel = np.asarray(settings.scenario.reference), settings.loop.channel
    initial = float(settings.scenario.initial_reference)
    tolerance = _REACH_TOLERANCE * max(float(np.ptp(np.append(reference, initial))), _MIN_SPAN)
    if reachable.lower - tolerance <= reference.min() and reference.max() <= reachable.upper + tolerance:
        return ""
    values = (reference.min(), reference.max(), reachable.lower, reachable.upper)
    ends = [format_metric(float(v), channel, channel) for v in values]
    course = f"is {ends[0]}" if ends[0] == ends[1] else f"goes from {ends[0]} to {ends[1]}"
    words = f"the reference {course}, and with its largest command the rig reaches {ends[2]} to {ends[3]}"
    limited = any(k in settings.limits for k in ("temperature", "stress", "current"))
    words += " within the limits" if limited or settings.loop.temperature_limiter is not None else ""
    stress, limit = value_at_rest(settings, "stress"), settings.limits.get("stress", math.inf)
    if stress > limit:
        ends = [format_metric(v, "peak_stress", channel) for v in (stress, limit)]
        words += f": the stress at rest is already {ends[0]}, and its limit is {ends[1]}"
    clipped = clip_reference(settings.scenario, reachable) is not settings.scenario
    return words + ("; tuned for the reference clipped to that range" if clipped else "")


def feedforward_entry(settings: ControllerFile, identified: IdentifiedFeedforward) -> dict[str, Any]:
    """Return the entry on the fit of the feedforward operator, before its inversion.

    Args:
        settings: The controller file.
        identified: The fitted feedforward.
    """
    feedforward = settings.feedforward
    assert feedforward is not None
    return {
        "operators": feedforward.operators,
        "loop": "simulated" if feedforward.measured is None else feedforward.measured.name,
        "command": [finite_or_none(end) for end in identified.command_range],
        "command_unit": CHANNELS[settings.system.plant.drive.control].unit,
        "seconds": finite_or_none(identified.seconds),
        "misfit": finite_or_none(identified.misfit),
        "stroke": finite_or_none(identified.stroke),
    }
