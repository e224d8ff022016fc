"""What the recordings of a study show about their bench, and offsets that are fitted for it."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax import parameters
from smajax.files.rig_file import Rig
from smajax.fitting.bench_checks import BenchFinding, bench_findings
from smajax.progress import Reporter
from smajax.recordings.recording import Recording

# Spread of the offsets of several recordings, in standard deviations of their noise, from which each has its own.
# Chosen by trial; tests/unit/fitting/test_bench_checks.py has an example of each.
_OWN_OFFSETS = 10.0


def rig_findings(rig: Rig, recordings: Sequence[Recording]) -> list[BenchFinding]:
    """Return what recordings show about the bench of a rig.

    Args:
        rig: The rig.
        recordings: The recordings.
    """
    settings: Any = rig.fit  # frozen, and the protocol of the fit has plain attributes
    return bench_findings(rig.plant, recordings, settings)


def report_findings(rig: Rig, recordings: Sequence[Recording], reporter: Reporter) -> list[dict[str, Any]]:
    """Report what recordings show about the bench of a rig, and return it as entries of a document.

    Args:
        rig: The rig.
        recordings: The recordings.
        reporter: Where each finding is reported, before long work begins.
    """
    entries = bench_entries(rig_findings(rig, recordings))
    for entry in entries:
        reporter.phase(entry["text"])
    return entries


def with_free_offsets(rig: Rig, findings: Sequence[BenchFinding]) -> Rig:
    """Return the rig with the offsets that its recordings show as free parameters, which start there.

    Args:
        rig: The rig.
        findings: What the recordings show.
    """
    for finding in findings:
        if finding.code != "offset":
            continue
        name = f"sensor.{finding.channel}_offset"
        differ = np.ptp(finding.values) > _OWN_OFFSETS * finding.noise
        kind = "per_recording" if differ else "free"
        fit = dataclasses.replace(rig.fit, **{kind: (*getattr(rig.fit, kind), name)})
        plant = parameters.replace(rig.plant, {name: float(np.median(finding.values))})
        rig = dataclasses.replace(rig, plant=plant, fit=fit)
    return rig


def bench_entries(findings: Sequence[BenchFinding], auto: bool = False) -> list[dict[str, Any]]:
    """Return the entries of a document.

    Args:
        findings: What the recordings show.
        auto: Whether the offsets among them are fitted.
    """
    return [
        {
            "code": finding.code,
            "channel": finding.channel,
            "recordings": list(finding.recordings),
            "text": finding.fitted_sentence if auto and finding.code == "offset" else finding.sentence,
        }
        for finding in findings
    ]
