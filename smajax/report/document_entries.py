"""Entries that several result documents share."""

from typing import Any

from smajax.channels import channel_unit
from smajax.files.documents import finite_or_none
from smajax.files.plausible_ranges import ImplausibleValue
from smajax.recordings.recording import Recording
from smajax.units import conversion


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """Return the entry of a recording in a result document.

    Args:
        recording: The recording.
        role: Its role, such as ``train`` or ``holdout``.
    """
    return {
        "name": recording.name,
        "sha256": recording.sha256,
        "rows": len(recording),
        "role": role,
        "notes": list(recording.notes),
    }


def implausible_entry(value: ImplausibleValue) -> dict[str, Any]:
    """Return the entry of an estimate outside of what an alloy can have."""
    return {
        "code": "implausible",
        "name": value.name,
        "value": finite_or_none(value.value),
        "unit": value.unit,
        "plausible": [value.plausible.lower, value.plausible.upper],
        "source": value.plausible.source,
        "text": value.sentence,
    }


def difference_unit(recording: Recording, channel: str) -> tuple[str, float]:
    """Return the unit of differences of a channel (that of its column, K for temperatures), and the factor from SI.

    Args:
        recording: The recording.
        channel: One of its channels.
    """
    canonical = channel_unit(channel)
    if canonical == "degC":
        return "K", 1.0
    unit = recording.units[channel]
    return unit, float(1 / conversion(unit, canonical)[0])
