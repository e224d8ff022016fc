"""Channels that the fit of an imported recording follows, and the parameters that they can determine."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from smajax.channels import channel_of, numbered
from smajax.errors import InputError
from smajax.files.rig_draft.kind import RigKind, varies
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.plant.mechanisms.registry import MECHANISMS
from smajax.recordings.recording import Recording

# Channels of a mechanism, of which the first recorded one is fitted; all follow from one another.
_MOTIONS = ("displacement", "strain", "force", "stress")
# Channels whose zero is arbitrary, so that its offset is free.
_WITHOUT_ZERO = ("displacement", "strain", "angle")
# Range of the temperature in K up to which a path is a loop at one temperature, of which the stress is fitted: it is
# less than the width of any transformation.
_ISOTHERMAL = 10.0
# Relative range of the stress from which on a slope over the stress can be determined; below it is the noise of a
# controlled load.
_STRESS_RANGE = 0.2
_SLOPE = "material.clausius_clapeyron_austenite"
SUPPLY = "drive.supply"
_CAPACITY = "heat.capacity"


@dataclass(frozen=True)
class Observation:
    """What is fitted to recordings.

    Attributes:
        channels: Channels that are fitted.
        free: Parameters that are free.
        initial: Initial states that are free.
    """

    channels: tuple[str, ...]
    free: tuple[str, ...]
    initial: tuple[str, ...]


def choose_observation(
    kind: RigKind, recordings: Sequence[Recording], template_free: Sequence[str], given: Mapping[str, str]
) -> Observation:
    """Return what is fitted.

    Args:
        kind: Kind of the rig.
        recordings: The recordings.
        template_free: Parameters that are free in the template of the kind.
        given: Values of parameters that the user gave, by name.

    Raises:
        InputError: If no channel can be fitted.
    """
    motion = _motion(kind, recordings)
    heated = kind.kind != "path" and kind.control != PRESCRIBED_TEMPERATURE
    names = numbered("temperature", MECHANISMS[kind.kind].wires)
    temperatures = tuple(name for name in names if heated and varies(recordings, name))
    channels = (*motion, *temperatures)
    if not channels:
        resistance = numbered("resistance", MECHANISMS[kind.kind].wires)
        channels = tuple(name for name in resistance if varies(recordings, name))
    if not channels:
        has = ", ".join(recordings[0].channels)
        raise InputError(
            f"no output of a {kind.kind} rig changes in the recording, which has {has}: choose another rig"
        )
    free = [name for name in template_free if heated or not name.startswith("heat.")]
    free = free if motion else [name for name in free if name.startswith("heat.")] or free
    if kind.control == "duty" and SUPPLY not in given:
        free = [SUPPLY, *(name for name in free if name != _CAPACITY)]
    if kind.kind == "path" and not _stress_changes(recordings):
        free = [name for name in free if name != _SLOPE]
    free = [name for name in free if name not in given]
    free += [f"sensor.{name}_offset" for name in motion if name in _WITHOUT_ZERO and _has_offset(recordings, name)]
    return Observation(channels, tuple(free), ("temperature",) if temperatures else ())


def _motion(kind: RigKind, recordings: Sequence[Recording]) -> tuple[str, ...]:
    """Return the channel of the mechanism that is fitted; none where no one is recorded or changes."""
    mechanism = MECHANISMS[kind.kind]
    if kind.kind == "path":
        temperature = np.concatenate([r.channels.get("temperature", np.zeros(1)) for r in recordings])
        return ("stress",) if np.ptp(temperature) < _ISOTHERMAL else ("strain",)
    candidates: Sequence[str] = (mechanism.coordinate, *_MOTIONS)
    if kind.kind == "testing-machine":
        candidates = ("stress", "force")  # a force needs the diameter
    if "weight" in kind.kind:
        candidates = [name for name in candidates if name not in ("force", "stress")]  # those of a weight stay
    prescribed = set(mechanism.prescribed)
    return next(((name,) for name in candidates if name not in prescribed and varies(recordings, name)), ())


def _stress_changes(recordings: Sequence[Recording]) -> bool:
    stress = np.concatenate([r.channels.get("stress", np.zeros(1)) for r in recordings])
    return bool(np.ptp(stress) > _STRESS_RANGE * np.max(np.abs(stress)))


def _has_offset(recordings: Sequence[Recording], channel: str) -> bool:
    """Return whether a channel begins off zero; a strain, whose zero is that of its sensor, always has an offset."""
    return channel_of(channel) == "strain" or any(r.channels[channel][0] != 0 for r in recordings)
