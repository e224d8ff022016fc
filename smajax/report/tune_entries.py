"""Entries of tune.json on the check on cases and on the jumps of the reference."""

from typing import Any

import numpy as np

from smajax.control.analysis.case_check import CaseCheck
from smajax.control.analysis.closed_loop_checks import jump_responses
from smajax.control.analysis.step_response import StepResponse, find_jumps
from smajax.control.tuning.tuning_study import ControllerTuning
from smajax.files.documents import finite_or_none


def check_entry(study: ControllerTuning) -> dict[str, Any]:
    """Return the entry on the check on cases.

    Args:
        study: Result of the tuning, with a check.
    """
    start, tuned = study.case_checks["start"], study.case_checks["tuned"]
    return {
        "cases": len(tuned.cases),
        "groups": tuned.groups,
        "failing": len(tuned.failing),
        "unstable": len(tuned.unstable),
        "beyond": {name: len(rows) for name, rows in tuned.beyond.items()},
        "worst": _worst(tuned),
        "start": _worst(start),
        "retunings": study.retunings,
    }


def _worst(check: CaseCheck) -> dict[str, Any]:
    """Largest value of each metric, and its case."""
    entries = {}
    for name in check.metrics[0]:
        worst = check.worst(name)
        entries[name] = {"value": finite_or_none(worst.value), "case": check.cases[worst.case].name}
    return entries


def jump_entries(study: ControllerTuning) -> list[dict[str, Any]]:
    """Return an entry for each jump of the reference.

    Args:
        study: Result of the tuning.
    """
    settings, channel = study.settings, study.settings.loop.channel
    reference, period = np.asarray(settings.scenario.reference), settings.system.period
    jumps = find_jumps(reference, float(settings.scenario.initial_reference), period)
    start, tuned = (jump_responses(settings, e.channels[channel]) for e in (study.start, study.tuned))
    check = study.case_checks.get("tuned")
    entries = []
    for k, (first, end) in enumerate(jumps.segments()):
        after = float(reference[end - 1])
        entry = {
            "number": k + 1,
            "time": period * first,
            "before": after - float(jumps.jump_size[first]),
            "after": after,
            "start": _response(start[k]),
            "tuned": _response(tuned[k]),
        }
        if check is not None:
            worst = StepResponse(*(check.worst_response(k, name).value for name in StepResponse._fields))
            entry["worst"] = _response(worst)
        entries.append(entry)
    return entries


def _response(response: StepResponse) -> dict[str, Any]:
    return {name: finite_or_none(value) for name, value in response._asdict().items()}
