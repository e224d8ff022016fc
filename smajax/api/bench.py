"""What the recordings of a study show about their bench, and offsets that are fitted for it."""

import dataclasses
from collections.abc import Collection, Sequence
from typing import Any

import numpy as np

from smajax import parameters
from smajax.files.rig_file import Rig
from smajax.fitting.bench_checks import OWN_OFFSETS, BenchFinding, bench_findings
from smajax.progress import Reporter
from smajax.recordings.recording import Recording


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


def with_free_offsets(rig: Rig, findings: Sequence[BenchFinding], recordings: Collection[str]) -> Rig:
    """Return the rig with the offsets that its recordings show as free parameters, which start there.

    Args:
        rig: The rig.
        findings: What the recordings show.
        recordings: Names of the recordings that are fitted; the offsets of others are left out.
    """
    offsets: dict[str, list[tuple[float, float]]] = {}
    for finding in findings:
        if finding.code == "offset":
            pairs = zip(finding.recordings, finding.values, strict=True)
            fitted = [(value, finding.noise) for name, value in pairs if name in recordings]
            offsets.setdefault(finding.channel, []).extend(fitted)
    for channel, fitted in offsets.items():
        if not fitted:
            continue
        values, noises = zip(*fitted, strict=True)
        name, differ = f"sensor.{channel}_offset", np.ptp(values) > OWN_OFFSETS * max(noises)
        kind = "per_recording" if differ else "free"
        fit = dataclasses.replace(rig.fit, **{kind: (*getattr(rig.fit, kind), name)})
        plant = parameters.replace(rig.plant, {name: float(np.median(values))})
        rig = dataclasses.replace(rig, plant=plant, fit=fit)
    return rig


def bench_entries(findings: Sequence[BenchFinding], fitted: Collection[str] | None = None) -> list[dict[str, Any]]:
    """Return the entries of a document.

    Args:
        findings: What the recordings show.
        fitted: Names of the recordings whose offsets are fitted; ``None`` where no offset is.
    """
    return [
        {
            "code": finding.code,
            "channel": finding.channel,
            "recordings": list(finding.recordings),
            "text": finding.sentence if fitted is None else _auto_sentence(finding, fitted),
        }
        for finding in findings
    ]


def _auto_sentence(finding: BenchFinding, fitted: Collection[str]) -> str:
    if finding.code != "offset":
        return finding.sentence
    return finding.fitted_sentence if set(fitted) & {*finding.recordings} else finding.unfitted_sentence
