"""Sections [reference] and [[change]] of a controller file: the reference, and parameters that change during a rollout.

[reference]
kind = "step"                     # step, staircase, sine, recorded
high = "5 mm"
duration = "20 s"
[[change]]                        # a parameter of the rig that jumps; as many sections as needed
parameter = "load.mass"
at = "10 s"
value = "0.3 kg"
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import jax.numpy as jnp
import numpy as np

from smajax import parameters
from smajax.control.controller_file.recording_notes import recording_notes
from smajax.control.controller_file.schema import ChangeSection, ReferenceSection
from smajax.control.controller_file.sections import reference_section
from smajax.control.loop import references
from smajax.control.loop.rollout import Scenario
from smajax.errors import InputError
from smajax.files.renamed_keys import current_name
from smajax.files.rig_file import Rig
from smajax.files.toml import quantity_at, show, validate
from smajax.files.validators import quantity
from smajax.recordings.read import read_recording

# Rounding error of sample times, s.
_ROUNDING = 1e-9
# Cycles of a sine in a period have to be fewer than this: the sampling theorem requires more than two samples a cycle.
_MAX_CYCLES_PER_PERIOD = 0.5
# Lowest frequency of a sine in Hz, to detect wrong units.
_MIN_FREQUENCY = 1e-6


def read_scenario(
    data: Mapping[str, Any],
    folder: Path,
    rig: Rig,
    sampled_channel: tuple[str, str, float],
    rest_value: float,
    seed: int,
) -> tuple[Scenario, tuple[str, ...]]:
    """Return the scenario of a controller file, and notes on a recorded reference.

    Args:
        data: Sections of the file by name.
        folder: Folder to which paths in the file are relative.
        rig: The rig.
        sampled_channel: Name of the channel, its internal unit, and the period in s.
        rest_value: Value of the channel at rest, internal unit; the default of ``reference.low``.
        seed: Seed of the sensor noise.

    Raises:
        InputError: for a wrong, missing or unsuitable key or value, or a recording that cannot be read.
    """
    section = reference_section(data["reference"])
    reader = _ReferenceReader(section, sampled_channel, show(data["controller"]["period"]), rest_value)
    time, values, initial = reader.recorded(folder, rig) if section.kind == "recorded" else reader.generated()
    draws = jnp.asarray(np.random.default_rng(seed).standard_normal(len(time)))
    changes = _changes(data.get("change", []), rig, time)
    return Scenario(jnp.asarray(values), jnp.asarray(initial), draws, changes), tuple(reader.notes)


class _ReferenceReader:
    """Reader of a reference; its public methods return times in s, values, and the initial value."""

    def __init__(
        self, section: ReferenceSection, sampled_channel: tuple[str, str, float], period_text: str, rest_value: float
    ):
        self.section, self.period_text, self.rest_value = section, period_text, rest_value
        self.channel, self.unit, self.period = sampled_channel
        self.notes: list[str] = []

    def recorded(self, folder: Path, rig: Rig) -> tuple[np.ndarray, np.ndarray, float]:
        """Return a recorded reference, interpolated at the samples.

        Args:
            folder: Folder to which the path of the recording is relative.
            rig: The rig, for the names of columns.

        Raises:
            InputError: if the file is missing, cannot be read or has no such channel.
        """
        if self.section.file is None:
            raise InputError('reference.file is missing: name the recording, as in file = "reference.csv"')
        recording = read_recording(
            folder / self.section.file,
            required=(self.channel,),
            mapping=rig.channels.columns,
            ignore=rig.channels.ignore,
            options=rig.recording,
        )
        self.notes += recording_notes(recording, [self.channel], f"the reference is the {self.channel}")
        duration = float(recording.time[-1] - recording.time[0]) + self.period
        time = _sample_times(duration, self.period, "file")
        values = references.recorded(time, recording.time, recording.channels[self.channel])
        return time, values, float(values[0])

    def generated(self) -> tuple[np.ndarray, np.ndarray, float]:
        """Return a step, a staircase or a sine.

        Raises:
            InputError: for a wrong, missing or unsuitable key or value.
        """
        section = self.section
        low = self.rest_value if section.low is None else quantity_at(section.low, self.unit, "reference.low")
        duration = self._duration(section.duration, "duration", 2)
        time = _sample_times(duration, self.period, "duration")
        if section.kind == "step":
            return time, self._step(time, low), low
        if section.kind == "staircase":
            return time, self._staircase(time), self.rest_value
        return time, self._sine(time, low), low

    def _step(self, time: np.ndarray, low: float) -> np.ndarray:
        at = 0.0 if self.section.at is None else quantity_at(self.section.at, "s", "reference.at", least=0.0)
        if at > time[-1]:
            raise InputError(
                f"reference.at = {show(self.section.at)} is not within reference.duration: give an earlier one"
            )
        self._note_late(at, "at")
        return references.step(time, low, self._quantity(self.section.high, "high", self.unit), at)

    def _staircase(self, time: np.ndarray) -> np.ndarray:
        if not self.section.levels:
            raise InputError(
                'reference.levels is missing: a staircase needs a line like levels = ["2 mm", "6 mm", "4 mm"]'
            )
        levels = [quantity_at(level, self.unit, "reference.levels") for level in self.section.levels]
        hold = self._duration(self.section.hold, "hold", 1)
        if (len(levels) - 1) * hold > time[-1]:
            raise InputError(
                f"reference.levels: {len(levels)} levels of {show(self.section.hold)} do not fit into "
                f"{show(self.section.duration)}: make reference.duration longer"
            )
        self._note_late(hold, "hold")
        return references.staircase(time, levels, hold)

    def _note_late(self, seconds: float, key: str) -> None:
        """Note that a jump comes later than the file says, since the reference changes at samples only."""
        if abs(seconds - round(seconds / self.period) * self.period) > _ROUNDING:
            self.notes.append(
                f"reference.{key} = {show(getattr(self.section, key))} is no multiple of controller.period = "
                f"{self.period_text}, so that jumps come at the next sample"
            )

    def _sine(self, time: np.ndarray, low: float) -> np.ndarray:
        frequency = self._quantity(self.section.frequency, "frequency", "Hz", least=_MIN_FREQUENCY)
        if frequency * self.period >= _MAX_CYCLES_PER_PERIOD:
            raise InputError(
                f"reference.frequency = {show(self.section.frequency)} is not below half a cycle in "
                "controller.period: lower it"
            )
        return references.sine(time, low, self._quantity(self.section.high, "high", self.unit), frequency)

    def _quantity(self, value: Any, key: str, unit: str, **ends: float) -> float:
        """A quantity that this kind of reference needs."""
        if value is None:
            example = (ReferenceSection.model_fields[key].examples or [""])[0]
            raise InputError(f"reference.{key} is missing: a {self.section.kind} needs a line like {key} = {example}")
        return quantity_at(value, unit, f"reference.{key}", **ends)

    def _duration(self, value: Any, key: str, periods: int) -> float:
        """A duration in s of at least so many periods of the controller."""
        seconds = self._quantity(value, key, "s")
        if not seconds >= periods * self.period:
            least = f"{f'{periods} times ' if periods > 1 else ''}controller.period = {self.period_text}"
            raise InputError(
                f"reference.{key} = {show(value)} is shorter than {least}: make it longer, or the period shorter"
            )
        return seconds


def _sample_times(duration: float, period: float, key: str) -> np.ndarray:
    try:
        return references.sample_times(duration, period)
    except InputError as error:
        raise InputError(f"reference.{key}: {error}") from None


def _changes(data: Any, rig: Rig, time: np.ndarray) -> dict[str, Any]:
    """The parameters that change, each with its value at every sample; changes apply in the order of their times."""
    changes = []
    for entry in data if isinstance(data, list) else [data]:
        section = validate(ChangeSection, entry, "change")
        name = current_name(section.parameter)
        if name.startswith("initial."):
            raise InputError(
                f"change.parameter: {name} is an initial value, which cannot change later: set it in the rig"
            )
        try:
            declared = parameters.declaration(rig.plant, name)
        except InputError as error:
            raise InputError(f"change.parameter: {error}") from None
        try:
            value = quantity(section.value, declared)
        except InputError as error:
            raise InputError(f"change.value of {name}: {error}") from None
        at = quantity_at(section.at, "s", f"change.at of {name}", least=0.0)
        if at > time[-1]:
            raise InputError(
                f"change.at of {name} = {show(section.at)} is after the reference's end: give an earlier one"
            )
        changes.append((at, name, value))
    series: dict[str, np.ndarray] = {}
    for at, name, value in sorted(changes, key=lambda change: change[0]):
        values = series.setdefault(name, np.full(len(time), float(parameters.get(rig.plant, name))))
        values[time >= at - _ROUNDING] = value
    return {name: jnp.asarray(values) for name, values in series.items()}
