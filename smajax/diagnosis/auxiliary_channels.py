"""Auxiliary channels: recorded and not observed, which a diagnosis explains in addition to the observed ones.

Each is fitted up to a gain and an offset of its sensor: a channel that nobody meant to fit need not be calibrated, and
its shape shows all the same where a residual lives. In documents these channels are called evidence.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax.fitting.noise import difference_noise
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.recordings.recording import Recording

# Share of a recording's rows at the lowest or highest value from which a channel counts as saturated. Chosen by trial;
# tests/unit/diagnosis holds it.
_SATURATED_SHARE = 0.02
# Distance of neighbouring levels, in standard deviations of the noise, above which rounding hides saturation.
_MAX_ROUNDING = 0.5


def auxiliary_channels(
    plant: Plant, observed: Sequence[str], recordings: Sequence[Recording]
) -> tuple[tuple[str, ...], dict[str, str]]:
    """Find the channels that the plant predicts and every recording has at every row.

    Args:
        plant: The plant.
        observed: Channels that are observed already.
        recordings: All recordings of the diagnosis.

    Returns:
        The channels, and of those that are recorded and cannot be used, why.
    """
    recorded = {c for r in recordings for c in r.channels}
    predicted = [c for c in plant.observable if c in recorded and c not in plant.signals and c not in observed]
    unusable = {c: reason for c in predicted if (reason := _unusable_reason(c, recordings))}
    return tuple(c for c in predicted if c not in unusable), unusable


def with_auxiliary_channels(plant: Plant, settings: Any, channels: Sequence[str]) -> tuple[Plant, Any]:
    """Return the plant with sensors of these channels, and settings that observe them with gain and offset free.

    Args:
        plant: The plant.
        settings: Fit settings.
        channels: The auxiliary channels.
    """
    identity = Sensor.identity(tuple(channels))
    sensor = Sensor(plant.sensor.gain | identity.gain, plant.sensor.offset | identity.offset)
    free = [f"sensor.{key}" for key in identity.declarations()]
    extended = dataclasses.replace(settings, observe=(*settings.observe, *channels), free=(*settings.free, *free))
    return dataclasses.replace(plant, sensor=sensor), extended


def without_channels(settings: Any, channels: Sequence[str]) -> Any:
    """Return settings in which these channels are not observed and their sensors' parameters are not free."""
    own = {f"sensor.{key}" for key in Sensor.identity(tuple(channels)).declarations()}
    observe = tuple(c for c in settings.observe if c not in channels)
    return dataclasses.replace(settings, observe=observe, free=tuple(n for n in settings.free if n not in own))


def saturation_reason(channel: str, recordings: Sequence[Recording]) -> str:
    """Say where a channel stays at its lowest or highest value more often than noise would let it; empty if nowhere.

    Rounding that is coarser than the noise hides saturation.

    Args:
        channel: The channel.
        recordings: Recordings that have it.
    """
    for recording in recordings:
        values = recording.channels[channel]
        levels = np.unique(values)
        if len(levels) < 3 or float(np.min(np.diff(levels))) > _MAX_ROUNDING * difference_noise(values):
            continue
        for end, word in ((levels[0], "lowest"), (levels[-1], "highest")):
            share = float(np.mean(values == end))
            if share > _SATURATED_SHARE:
                return f"{recording.name}: {channel} stays at its {word} value for {100 * share:.0f} % of the rows"
    return ""


def _unusable_reason(channel: str, recordings: Sequence[Recording]) -> str:
    for recording in recordings:
        values = recording.channels.get(channel)
        if values is None:
            return f"{recording.name} does not have it"
        if not np.all(np.isfinite(values)):
            return f"{recording.name} has rows without it"
        if np.ptp(values) == 0.0:
            return f"{recording.name}: it never changes"
    return saturation_reason(channel, recordings)
