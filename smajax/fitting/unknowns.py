"""The unknowns of a fit: which parameters are free, their start values, bounds and scales."""

import dataclasses
import math
from collections.abc import Collection, Sequence
from typing import Any, Protocol, runtime_checkable

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.parameters.definitions import ORDERED_PAIRS
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import recorded_surroundings

# Least width of a transformation, relative to the value of its first end: enough to simulate a material law through it.
# Chosen by trial; tests/unit/fitting/test_fit.py holds it on ends that cross.
MIN_RELATIVE_BAND = 1e-3
# Scales by unit where a start value of zero gives none: typical sizes in the parameter sets, so that steps are of order
# one.
_TYPICAL_SCALES = {"K": 10.0, "W/m^2/K": 100.0, "W/m^2/K^2": 0.5, "W/m^2/K^3": 0.005, "1/K": 1e-5, "ohm": 0.1}


@runtime_checkable
class Settings(Protocol):
    """Settings of a fit; ``smajax.files.rig_file.FitSettings`` has these attributes.

    A further attribute ``input_noise`` (float or ``None``) is used if there is one: the standard deviation of the noise
    of the electrical inputs' meter, SI; 0 where they are exact, and ``None``, the default, if it is estimated.

    Attributes:
        free: Names of the free parameters.
        per_recording: Names of the parameters of which each recording has its own value.
        initial: Start values that are free, such as ``temperature``.
        bounds: Bounds by name, where they differ from the declared ones.
        observe: Channels that are fitted.
        noise: Standard deviation by channel, SI; estimated where absent.
        starts: Number of starts.
        seed: Seed of the random starts.
    """

    free: Sequence[str]
    per_recording: Sequence[str]
    initial: Sequence[str]
    bounds: Any
    observe: Sequence[str]
    noise: Any
    starts: int
    seed: int


@dataclasses.dataclass(frozen=True)
class Unknown:
    """One entry of the vector: a parameter of one recording, or (``recording`` is ``None``) of all.

    Unknowns are equal if their names and units are, so that other values need no new compiled program.

    Attributes:
        name: ``section.key``.
        recording: Name of its recording.
        nominal: Start value, internal unit.
        lower: Lower bound.
        upper: Upper bound.
        scale: Scale, internal unit; the vector's entry is the value over this scale.
        unit: Internal unit.
    """

    name: str
    recording: str | None = dataclasses.field(compare=False)
    nominal: float = dataclasses.field(compare=False)
    lower: float = dataclasses.field(compare=False)
    upper: float = dataclasses.field(compare=False)
    scale: float = dataclasses.field(compare=False)
    unit: str

    @property
    def label(self) -> str:
        """``section.key``, followed by ``@recording`` where each recording has its own."""
        return self.name if self.recording is None else f"{self.name}@{self.recording}"


def make_unknown(
    plant: Plant, name: str, recording: str | None, bounds: tuple[float, float], sample: Recording
) -> Unknown:
    """Make an unknown, with a scale that gives steps of order one.

    Args:
        plant: Plant with the start value; where that is NaN, it is the plant's state at the first row of ``sample``.
        name: Name of the parameter.
        recording: Name of the recording whose parameter it is; ``None`` for a shared one.
        bounds: Lower and upper bound, internal unit.
        sample: Recording whose channel gives the scale of a sensor's offset.

    Returns:
        The unknown, in internal units.

    Raises:
        InputError: The plant has no parameter of this name.
    """
    declared = parameters.declaration(plant, name)
    nominal = float(parameters.get(plant, name))
    if math.isnan(nominal):
        nominal = _state_value(plant, name, sample)
    lower, upper = bounds
    if name.startswith("sensor.") and name.endswith("_offset"):
        channel = sample.channels.get(name.removeprefix("sensor.").removesuffix("_offset"))
        scale = float(np.nanmax(channel) - np.nanmin(channel)) if channel is not None else 1.0
    else:
        scale = abs(nominal) or _TYPICAL_SCALES.get(declared.unit) or min(abs(upper), abs(lower), 1.0) or 1.0
        if declared.unit in ("degC", "K"):
            scale = _TYPICAL_SCALES["K"]
    return Unknown(name, recording, nominal, lower, upper, scale, declared.unit)


def bounds_of(plant: Plant, name: str, settings: Settings, free: Collection[str]) -> tuple[float, float]:
    """Return the bounds of a parameter.

    A free end of a transformation stays on its side of the other end where that is not in ``free``.

    Args:
        plant: Plant with the declared bounds and the values of the parameters that are not free.
        name: Name of the parameter.
        settings: Settings with the bounds that differ from the declared ones.
        free: Names of all free parameters.

    Returns:
        Lower and upper bound, internal unit.

    Raises:
        InputError: The plant has no parameter of this name.
    """
    declared = parameters.declaration(plant, name)
    lower, upper = settings.bounds.get(name, (declared.lower, declared.upper))
    for low, high in ORDERED_PAIRS:
        other = high if name == low else low
        if name not in (low, high) or other in free or other not in parameters.all_declarations(plant):
            continue
        other_value = float(parameters.get(plant, other))
        band = MIN_RELATIVE_BAND * abs(other_value)
        lower, upper = (
            (lower, min(upper, other_value - band)) if name == low else (max(lower, other_value + band), upper)
        )
    return lower, upper


def _state_value(plant: Plant, name: str, sample: Recording) -> float:
    """Start value of a state that the plant derives from the first row of its inputs: the mean of cells and grains."""
    names = (*plant.signals, *recorded_surroundings(plant, [sample]))
    first = jnp.asarray([sample.channels[c][0] if c in sample.channels else math.nan for c in names])
    state = plant.init(first)
    values = {
        "temperature": state.temperature,
        "detwinned": state.fractions.detwinned,
        "twinned": state.fractions.twinned,
    }
    value = values[name.removeprefix("initial.")].reshape(-1, plant.mechanism.wires)
    return float(jnp.mean(value[:, 0]))
