"""Evidence: channels that were recorded and are not observed, which a diagnosis explains beside those that are.

Each is taken up to a gain and an offset of its sensor, which are free: a channel that nobody meant to fit need not be calibrated, and its
shape says where a residual lives all the same.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np

from smajax.plant.plant import Plant
from smajax.plant.sensor import Sensor
from smajax.recording import Recording


def evidence(plant: Plant, observed: Sequence[str], recordings: Sequence[Recording]) -> tuple[str, ...]:
    """The channels that the plant predicts and every recording has, a value at every row and not always the same one."""
    known = [c for c in plant.observable if c not in plant.signals and c not in observed]
    return tuple(c for c in known if all(_tells(r.channels.get(c)) for r in recordings))


def _tells(values: np.ndarray | None) -> bool:
    return values is not None and bool(np.all(np.isfinite(values)) and np.ptp(values) > 0.0)


def with_evidence(plant: Plant, settings: Any, channels: Sequence[str]) -> tuple[Plant, Any]:
    """The plant with sensors of these channels, and fit settings in which they are observed, each with its gain and offset free."""
    ones = Sensor.identity(tuple(channels))
    sensor = Sensor(plant.sensor.gain | ones.gain, plant.sensor.offset | ones.offset)
    free = [f"sensor.{key}" for key in ones.declarations()]
    extended = dataclasses.replace(settings, observe=(*settings.observe, *channels), free=(*settings.free, *free))
    return dataclasses.replace(plant, sensor=sensor), extended
