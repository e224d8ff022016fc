"""Auxiliary channels: recorded channels that are not observed, which a diagnosis fits in addition to the observed ones.

Each is fitted with a free gain and offset of its sensor: such a channel need not be calibrated, and its shape still
shows which stage a residual comes from. In documents these channels are called evidence.
"""

import dataclasses
import enum
from collections.abc import Sequence
from typing import Any, NamedTuple

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


class ChannelCode(enum.StrEnum):
    """Why a diagnosis cannot use a channel."""

    missing = "missing"
    incomplete = "incomplete"
    constant = "constant"
    saturated_low = "saturated-low"
    saturated_high = "saturated-high"


class ChannelFault(NamedTuple):
    """A channel that a diagnosis cannot use.

    Attributes:
        code: The reason.
        recording: Name of the recording that shows it.
        channel: The channel.
        share: Share of the rows at the lowest or highest value of a saturated channel; else 0.
    """

    code: ChannelCode
    recording: str
    channel: str
    share: float = 0.0

    @property
    def text(self) -> str:
        """The reason in words, for messages and reports."""
        if self.code in (ChannelCode.saturated_low, ChannelCode.saturated_high):
            end = "lowest" if self.code is ChannelCode.saturated_low else "highest"
            return f"{self.recording}: {self.channel} stays at its {end} value for {100 * self.share:.0f} % of the rows"
        words = {
            ChannelCode.missing: " does not have it",
            ChannelCode.incomplete: " has rows without it",
            ChannelCode.constant: ": it never changes",
        }
        return f"{self.recording}{words[self.code]}"


def auxiliary_channels(
    plant: Plant, observed: Sequence[str], recordings: Sequence[Recording]
) -> tuple[tuple[str, ...], dict[str, ChannelFault]]:
    """Find the channels that the plant predicts and every recording has at every row.

    Args:
        plant: The plant.
        observed: Channels that are observed already.
        recordings: All recordings of the diagnosis.

    Returns:
        The channels, and by recorded channel that cannot be used the reason.
    """
    recorded = {c for r in recordings for c in r.channels}
    predicted = [c for c in plant.observable if c in recorded and c not in plant.signals and c not in observed]
    unusable = {c: fault for c in predicted if (fault := _fault(c, recordings))}
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


def saturation(channel: str, recordings: Sequence[Recording]) -> ChannelFault | None:
    """Return where a channel is saturated: at its lowest or highest value for more than 2 % of the rows.

    A recording whose rounding is coarser than the noise is left out, because rounding hides saturation.

    Args:
        channel: The channel.
        recordings: Recordings that have it.

    Returns:
        The reason; ``None`` if the channel is not saturated.
    """
    for recording in recordings:
        values = recording.channels[channel]
        levels = np.unique(values)
        if len(levels) < 3 or float(np.min(np.diff(levels))) > _MAX_ROUNDING * difference_noise(values):
            continue
        for end, code in ((levels[0], ChannelCode.saturated_low), (levels[-1], ChannelCode.saturated_high)):
            share = float(np.mean(values == end))
            if share > _SATURATED_SHARE:
                return ChannelFault(code, recording.name, channel, share)
    return None


def _fault(channel: str, recordings: Sequence[Recording]) -> ChannelFault | None:
    """Why a channel cannot be used; ``None`` if it can."""
    for recording in recordings:
        values = recording.channels.get(channel)
        if values is None:
            return ChannelFault(ChannelCode.missing, recording.name, channel)
        if not np.all(np.isfinite(values)):
            return ChannelFault(ChannelCode.incomplete, recording.name, channel)
        if np.ptp(values) == 0.0:
            return ChannelFault(ChannelCode.constant, recording.name, channel)
    return saturation(channel, recordings)
