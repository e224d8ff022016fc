"""Entries that several result documents share."""

from typing import Any

from smajax.channels import channel_unit
from smajax.recordings.recording import Recording
from smajax.units import conversion


def recording_entry(recording: Recording, role: str) -> dict[str, Any]:
    """Return what a result document says of a recording that was used in this role."""
    return {
        "name": recording.name,
        "sha256": recording.sha256,
        "rows": len(recording),
        "role": role,
        "notes": list(recording.notes),
    }


def difference_unit(recording: Recording, channel: str) -> tuple[str, float]:
    """Return the unit of differences of a channel, as in its column (K for temperatures), and the factor from SI."""
    canonical = channel_unit(channel)
    if canonical == "degC":
        return "K", 1.0
    unit = recording.units[channel]
    return unit, float(1 / conversion(unit, canonical)[0])
