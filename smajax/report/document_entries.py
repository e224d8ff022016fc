"""Entries that several result documents share."""

from typing import Any

from smajax.channels import channel_unit
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
