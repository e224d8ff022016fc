"""Document tune.json: gains, metrics, margins and checks before and after the tuning, and problems."""

import math
from collections.abc import Mapping
from typing import Any

from smajax import __version__
from smajax.channels import CHANNELS
from smajax.control.analysis.closed_loop_checks import (
    GainEvaluation,
    fails_to_track,
    idle_error,
    metric_of_limit,
    violated_limits,
)
from smajax.control.analysis.instability import Instability
from smajax.control.controller_file.read import ControllerFile
from smajax.control.loop.gains import gain, gains, unit_of
from smajax.control.tuning.feedforward_identification import IdentifiedFeedforward
from smajax.control.tuning.tuning_study import ControllerTuning, UnreachableReference
from smajax.files.documents import finite_or_none
from smajax.report import prediction
from smajax.report.documents.tune import TuneDocument
from smajax.report.tune_entries import check_entry, jump_entries
from smajax.report.tuning import margin_words, stabilising_advice
from smajax.report.tuning_metrics import format_metric

# Instabilities in words, by code.
_INSTABILITIES = {
    "not_finite": "the rollout has values that are not finite",
    "diverging": "the loop diverges from its reference",
    "changing_command": "the command keeps changing by {share:.0f} % of its range from sample to sample",
    "oscillating": "the loop keeps oscillating about its reference by {share:.0f} % of the reference's span",
}
# Failures of draws in words, by the key of their number in the document.
_DRAW_FAILURES = {
    "unstable": "are unstable",
    "unstable_linearised": "are unstable, linearised along their rollouts",
    "beyond_a_limit": "are beyond a limit",
}


def tune_document(study: ControllerTuning) -> dict[str, Any]:
    """Return the entries of tune.json except the reasons for missing exports and the summary.

    Args:
        study: Result of the tuning.
    """
    settings, start, tuned = study.settings, study.start, study.tuned
    table = _gain_table(settings, start, tuned)
    checks = {stage: check.document for stage, check in study.checks.items()}
    violated = violated_limits(settings.limits, tuned.metrics)
    failures = _failing_draws(checks)
    document = {
        "schema": TuneDocument.SCHEMA,
        "rig": study.rig.name,
        "controller": settings.name,
        "channel": settings.loop.channel,
        "unit": CHANNELS[settings.loop.channel].unit,
        "command_unit": CHANNELS[settings.system.plant.drive.control].unit,
        "feasible": not (violated or tuned.unstable or tuned.margins.unstable or failures or _fails_cases(study)),
        "problems": _problems(study, checks),
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
        "jumps": jump_entries(study),
        "stable": {"start": not start.unstable, "tuned": not tuned.unstable},
        "robust": checks,
        "start_kept": bool(checks) and all(entry["start"] == entry["tuned"] for entry in table.values()),
        "objective": {"settle": settings.settle, "weights": dict(settings.weights)},
        "rollouts": study.rollouts,
        "seed": study.seed,
        "smajax": __version__,
    }
    if study.other_weights:
        document["objective"]["asked"] = dict(study.file_weights)
    if start.low_margins is not None and tuned.low_margins is not None:
        document["low_margins"] = {
            when: {n: finite_or_none(v) for n, v in margins._asdict().items()}
            for when, margins in (("start", start.low_margins), ("tuned", tuned.low_margins))
        }
    return document | _optional_entries(study)


def _fails_cases(study: ControllerTuning) -> bool:
    """Whether the tuned gains fail in any case of the check."""
    return bool(study.case_checks) and bool(study.case_checks["tuned"].failing)


def _optional_entries(study: ControllerTuning) -> dict[str, Any]:
    """Return entries that only some controllers have: feedforward, pulses, instruments of the filter."""
    entries: dict[str, Any] = {}
    if study.settings.notes:
        entries["recording_notes"] = list(study.settings.notes)
    settings, loop = study.settings, study.tuned.loop
    if study.identified is not None:
        entries["feedforward"] = _feedforward_entry(settings, study.identified)
    if settings.system.carrier is not None:
        rmse = finite_or_none(study.rmse_of_mean)
        entries["pulses"] = {"carrier": settings.system.carrier, "rmse_of_mean": rmse}
    if study.case_checks:
        entries["case_check"] = check_entry(study)
    if loop.use_estimate and loop.instruments is not None:
        entries["believes"] = sorted(loop.instruments.sensors)
    return entries


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


def _problems(study: ControllerTuning, checks: Mapping[str, Any]) -> list[str]:
    """Return the reasons why the result or the start is not usable."""
    settings, start, tuned = study.settings, study.start, study.tuned
    problems = ["the tuning was interrupted, and these are the best gains so far"] if study.interrupted else []
    problems += [f"the start gains are unstable: {_instability_words(start.unstable)}"] if start.unstable else []
    if not start.unstable and start.margins.unstable:
        margins = margin_words(start.margins.gain, start.margins.phase)
        problems.append(f"the start gains are unstable, linearised along their rollout, with {margins}")
    problems += [_unreachable_words(settings, study.unreachable)] if study.unreachable is not None else []
    problems += _missed_limits(study)
    if tuned.unstable:
        problems.append(f"the best gains are unstable: {_instability_words(tuned.unstable)}")
    elif tuned.margins.unstable:
        margins = margin_words(tuned.margins.gain, tuned.margins.phase)
        advice = stabilising_advice(settings.settle)
        problems.append(f"the best gains are unstable, linearised along their rollout, with {margins}: {advice}")
    if fails_to_track(settings, tuned, study.reachable):
        errors = [tuned.metrics["rmse"], idle_error(settings)]
        shown = [format_metric(error, "rmse", settings.loop.channel) for error in errors]
        problems.append(
            f"the best gains do not follow the reference: their error is {shown[0]}, that of an idle rig {shown[1]}; "
            "try more starts, other start gains or wider limits"
        )
    if failures := _failing_draws(checks):
        words = " and ".join(f"{count} {_DRAW_FAILURES[k]}" for k, count in failures.items())
        problems.append(
            f"of {checks['tuned']['draws']} draws {words} with the best gains: reduce the variation, "
            "or raise robust.draws"
        )
    return problems


def _missed_limits(study: ControllerTuning) -> list[str]:
    """Clauses on limits that the tuned gains violate in the rollout of the file or in a case, and on unstable cases."""
    settings, tuned, check = study.settings, study.tuned, study.case_checks.get("tuned")
    violated = violated_limits(settings.limits, tuned.metrics)
    if check is None:
        return [_limit_words(settings, name, tuned.metrics) for name in violated]
    words, count = [], len(check.cases)
    for name in [n for n in settings.limits if n in violated or n in check.beyond]:
        if name not in check.beyond:
            words.append(_limit_words(settings, name, tuned.metrics))
            continue
        metric = metric_of_limit(name)
        worst = check.worst(metric)
        value = format_metric(worst.value, metric, settings.loop.channel)
        at_worst = f"{value} at worst" if math.isfinite(worst.value) else "no finite value at worst"
        limit = format_metric(settings.limits[name], metric, settings.loop.channel)
        words.append(
            f"the limit on {name} is not met: it is {limit}, and the best gains exceed it in "
            f"{len(check.beyond[name])} of {count} cases, with {at_worst} ({check.cases[worst.case].name})"
        )
    if check.unstable and not tuned.unstable:
        names = ", ".join(check.cases[k].name for k in check.unstable)
        words.append(f"the best gains are unstable in {len(check.unstable)} of {count} cases: {names}")
    return words


def _instability_words(instability: Instability) -> str:
    """Return a clause on why a rollout counts as unstable."""
    return _INSTABILITIES[instability.code].format(share=100 * instability.share)


def _limit_words(settings: ControllerFile, name: str, metrics: Mapping[str, float]) -> str:
    """Return a sentence on a limit that the tuned gains violate."""
    key = name if name in metrics else f"peak_{name}"
    value, limit = (format_metric(v, key, settings.loop.channel) for v in (metrics[key], settings.limits[name]))
    metric = value if math.isfinite(metrics[key]) else "no finite value"
    return f"the limit on {name} is not met: it is {limit}, and the best gains give {metric}"


def _failing_draws(checks: Mapping[str, Any]) -> dict[str, int]:
    """Return the numbers of draws that fail with the tuned gains, by failure, without zeros."""
    return {k: checks["tuned"][k] for k in _DRAW_FAILURES if checks and checks["tuned"][k]}


def _unreachable_words(settings: ControllerFile, unreachable: UnreachableReference) -> str:
    """Return a sentence on a reference that the rig cannot follow."""
    channel, reachable = settings.loop.channel, unreachable.reachable
    values = (unreachable.lower, unreachable.upper, reachable.lower, reachable.upper)
    ends = [format_metric(v, channel, channel) for v in values]
    course = f"is {ends[0]}" if ends[0] == ends[1] else f"goes from {ends[0]} to {ends[1]}"
    words = f"the reference {course}, and with its largest command the rig reaches {ends[2]} to {ends[3]}"
    words += " within the limits" if unreachable.limited else ""
    if unreachable.stress_at_rest is not None:
        stresses = (unreachable.stress_at_rest, settings.limits["stress"])
        ends = [format_metric(v, "peak_stress", channel) for v in stresses]
        words += f": the stress at rest is already {ends[0]}, and its limit is {ends[1]}"
    return words + ("; tuned for the reference clipped to that range" if unreachable.clipped else "")


def _feedforward_entry(settings: ControllerFile, identified: IdentifiedFeedforward) -> dict[str, Any]:
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
