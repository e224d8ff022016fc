"""Auxiliary channels: recorded channels that are not observed, which a diagnosis fits in addition to the observed ones.

Each is fitted with a free gain and offset of its sensor: such a channel need not be calibrated, and its shape still
shows which stage a residual comes from. In documents these channels are called evidence.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax.fitting.noise import difference_noise
from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.recordings.recording import Recording

# Share of a recording's rows at the lowest or highest value above which a channel counts as saturated. Chosen by trial;
# tests/unit/diagnosis holds it.
_SATURATED_SHARE = 0.02
# Distance between neighbouring levels, in standard deviations of the noise, above which rounding hides saturation:
# finer levels are mixed by the noise. Chosen by trial.
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
        The channels, and for each recorded channel that cannot be used the reason.
    """
    recorded = {c for r in recordings for c in r.channels}
    predicted = [c for c in plant.observable if c in recorded and c not in plant.signals and c not in observed]
    unusable = {c: reason for c in predicted if (reason := _unusable_reason(c, recordings))}
    return tuple(c for c in predicted if c not in unusable), unusable


def with_auxiliary_channels(plant: Plant, settings: Any, channels: Sequence[str]) -> tuple[Plant, Any]:
    """Add sensors of auxiliary channels to a plant, and observe them with free gain and offset.

    Args:
        plant: The plant.
        settings: Fit settings.
        channels: The auxiliary channels.

    Returns:
        The plant and the settings with the channels.
    """
    identity = Sensor.identity(tuple(channels))
    sensor = Sensor(plant.sensor.gain | identity.gain, plant.sensor.offset | identity.offset)
    free = [f"sensor.{key}" for key in identity.declarations()]
    extended = dataclasses.replace(settings, observe=(*settings.observe, *channels), free=(*settings.free, *free))
    return dataclasses.replace(plant, sensor=sensor), extended


def without_channels(settings: Any, channels: Sequence[str]) -> Any:
    """Return settings in which channels are not observed and the parameters of their sensors are not free.

    Args:
        settings: Fit settings.
        channels: The channels.
    """
    own = {f"sensor.{key}" for key in Sensor.identity(tuple(channels)).declarations()}
    observe = tuple(c for c in settings.observe if c not in channels)
    return dataclasses.replace(settings, observe=observe, free=tuple(n for n in settings.free if n not in own))


def saturation_reason(channel: str, recordings: Sequence[Recording]) -> str:
    """Return where a channel is saturated: at its lowest or highest value for more than 2 % of the rows.

    A recording whose rounding is coarser than the noise is left out, because rounding hides saturation.

    Args:
        channel: The channel.
        recordings: Recordings that have it.

    Returns:
        The reason, for a message; empty if the channel is not saturated.
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
    """Why a channel cannot be used; empty if it can."""
    for recording in recordings:
        values = recording.channels.get(channel)
        if values is None:
            return f"{recording.name} does not have it"
        if not np.all(np.isfinite(values)):
            return f"{recording.name} has rows without it"
        if np.ptp(values) == 0.0:
            return f"{recording.name}: it never changes"
    return saturation_reason(channel, recordings)
