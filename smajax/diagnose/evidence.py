"""Evidence: channels that were recorded and are not observed, which a diagnosis explains beside those that are.

Each is taken up to a gain and an offset of its sensor, which are free: a channel that nobody meant to fit need not be calibrated, and its
shape says where a residual lives all the same.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax.fit.problem import difference_noise
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.recording import Recording

_CLIPPED = 0.02


def evidence(plant: Plant, observed: Sequence[str], recordings: Sequence[Recording]) -> tuple[tuple[str, ...], dict[str, str]]:
    """The channels that the plant predicts and every recording has, with a value at every row; and why others of them are left out."""
    recorded = {c for r in recordings for c in r.channels}
    known = [c for c in plant.observable if c in recorded and c not in plant.signals and c not in observed]
    left = {c: why for c in known if (why := _objection(c, recordings))}
    return tuple(c for c in known if c not in left), left


def with_evidence(plant: Plant, settings: Any, channels: Sequence[str]) -> tuple[Plant, Any]:
    """The plant with sensors of these channels, and fit settings in which they are observed, each with its gain and offset free."""
    ones = Sensor.identity(tuple(channels))
    sensor = Sensor(plant.sensor.gain | ones.gain, plant.sensor.offset | ones.offset)
    free = [f"sensor.{key}" for key in ones.declarations()]
    extended = dataclasses.replace(settings, observe=(*settings.observe, *channels), free=(*settings.free, *free))
    return dataclasses.replace(plant, sensor=sensor), extended


def without(settings: Any, channels: Sequence[str]) -> Any:
    """Fit settings in which these channels are not observed; what is free of their sensors is so no longer."""
    own = {f"sensor.{key}" for key in Sensor.identity(tuple(channels)).declarations()}
    kept = tuple(c for c in settings.observe if c not in channels)
    return dataclasses.replace(settings, observe=kept, free=tuple(n for n in settings.free if n not in own))


def clipped(channel: str, recordings: Sequence[Recording]) -> str:
    """Where a channel stands at one of its ends as noise would never let it; empty if nowhere. Rounding coarser than the noise hides it."""
    for recording in recordings:
        values = recording.channels[channel]
        levels = np.unique(values)
        if len(levels) < 3 or float(np.min(np.diff(levels))) > 0.5 * difference_noise(values):
            continue
        for end, word in ((levels[0], "lowest"), (levels[-1], "highest")):
            share = float(np.mean(values == end))
            if share > _CLIPPED:
                return f"{recording.name}: {channel} stands at its {word} value for {100 * share:.0f} % of the rows"
    return ""


def _objection(channel: str, recordings: Sequence[Recording]) -> str:
    for recording in recordings:
        values = recording.channels.get(channel)
        if values is None:
            return f"{recording.name} does not have it"
        if not np.all(np.isfinite(values)):
            return f"{recording.name} has rows without it"
        if np.ptp(values) == 0.0:
            return f"{recording.name}: it never changes"
    return clipped(channel, recordings)
