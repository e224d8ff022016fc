"""What a sweep sweeps: a rig under an input, or a machine that gives its own figures; what each can vary, and what can be asked of it."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import numpy as np
from pydantic import BaseModel, Field

from smajax import machines, parameters
from smajax.errors import InputError
from smajax.machines import AbstractMachine
from smajax.parameters import Declaration
from smajax.plant.rotary import LightRotary
from smajax.recording import Recording
from smajax.rig import Rig, parse_rig
from smajax.rig_schema import one_of
from smajax.sweep.metrics import METRICS
from smajax.sweep.space import Axis
from smajax.sweep.study import INPUT, AbstractStudy, MachineStudy, RigStudy
from smajax.sweep.wave import SHAPES, Wave
from smajax.toml_file import STRICT, quantity_at, read_text, show, validate
from smajax.units import CHANNELS, numbered

NAMES = (*METRICS, "bandwidth")
_USUAL = ("stroke", "force", "peak_temperature", "energy_per_cycle", "efficiency")
_ABSOLUTE_ZERO = -273.15
_NEEDS_WAVE = ("time_to_cool", "bandwidth")


class _Input(BaseModel):
    model_config = STRICT
    wave: Annotated[str, one_of(SHAPES)] | None = Field(None, examples=['"square"'])
    amplitude: Any = Field(None, examples=['"0.4 A"'])
    frequency: Any = Field(None, examples=['"0.1 Hz"'])
    highest: Any = Field(default=None, examples=['"10 Hz"'])
    duty: Any = Field(None, examples=["0.5"])
    cycles: int | None = Field(None, ge=1, le=10_000, examples=["4"])
    recording: str | None = Field(None, examples=['"input.csv"'])


@dataclass(frozen=True, eq=False)
class RigSubject:
    """A rig under a wave or a recording of ``cycles`` cycles; bandwidths are looked for up to ``highest`` Hz (0: not at all)."""

    rig: Rig
    source: Wave | Recording
    cycles: int
    highest: float

    @property
    def name(self) -> str:
        """The rig file's name."""
        return self.rig.name

    @property
    def usual(self) -> tuple[str, ...]:
        """The metrics that are told unless others are asked for."""
        return _USUAL

    @property
    def table(self) -> dict[str, Declaration]:
        """What can vary, by name."""
        table = dict(parameters.declared(self.rig.plant))
        if isinstance(self.source, Wave):
            control = self.rig.plant.drive.control
            top = CHANNELS[control].plausible[1]
            table[f"{INPUT}amplitude"] = Declaration(CHANNELS[control].unit, f"amplitude of the {control}", 0.0, top, None)
            table[f"{INPUT}frequency"] = Declaration("Hz", "frequency of the wave", 1e-6, 1e4, None)
        return table

    @property
    def units(self) -> dict[str, str]:
        """The metrics that can be asked for, with their units."""
        return RigStudy((), self.rig.plant, NAMES, self.source, self.cycles, self.rig.interpolation, 0.0).units

    def coldest(self, metric: str, axes: Sequence[Axis]) -> float:
        """What a metric never falls below, whatever the design: a peak temperature that at the start, others minus infinity."""
        if metric != "peak_temperature":
            return -math.inf
        lower = {axis.name: axis.lower for axis in axes}
        starts = [lower.get(name, self.value(name)) for name in ("environment.ambient", "initial.temperature")]
        return float(np.nanmin(starts))

    @property
    def always(self) -> tuple[str, ...]:
        """The metrics that are told whatever is asked for."""
        return ("settling",)

    def check(self, axes: Sequence[Axis], metrics: Sequence[str]) -> None:
        """InputError if an axis would do nothing, or a metric cannot be told under this input."""
        for name in (axis.name for axis in axes):
            if name in ("pulley.inertia", "pulley.damping") and isinstance(self.rig.plant.mechanism, LightRotary):
                raise InputError(f"parameters.{name} does nothing while the rig has neither inertia nor damping: give it one in the rig")
        if any(axis.name == f"{INPUT}amplitude" and not axis.upper > 0.0 for axis in axes):
            raise InputError(f"parameters.{INPUT}amplitude is 0 throughout, and nothing else heats a wire: give values above 0")
        if not isinstance(self.source, Wave) and (only := [n for n in _NEEDS_WAVE if n in metrics]):
            raise InputError(f"{only[0]} needs a wave, and [input] has a recording: take the metric out, or give a wave")
        if "bandwidth" in metrics and not self.highest:
            raise InputError('input.highest is missing: a bandwidth is looked for up to a frequency, as in highest = "10 Hz" under [input]')
        top = max((axis.upper for axis in axes if axis.name == f"{INPUT}frequency"), default=0.0)
        if "bandwidth" in metrics and top >= self.highest:
            ends = f"input.highest = {self.highest:g} Hz is not above the range of {INPUT}frequency, which ends at {top:g} Hz"
            raise InputError(f"{ends}: raise it, or narrow the range")

    def study(self, axes: tuple[str, ...], metrics: tuple[str, ...]) -> AbstractStudy:
        """What is asked of each design."""
        return RigStudy(axes, self.rig.plant, metrics, self.source, self.cycles, self.rig.interpolation, self.highest)

    def value(self, name: str) -> float:
        """The value of a parameter in the rig file, in its internal unit."""
        return float(parameters.get(self.rig.plant, name))

    def to_toml(self, values: Mapping[str, float] | None = None) -> str:
        """The rig as a file, with other values."""
        return self.rig.to_toml(values)

    def recorded(self) -> dict[str, Any] | None:
        """The recording as a JSON document, for ``again``."""
        if isinstance(self.source, Wave):
            return None
        channels = {n: self.source.channels[n].tolist() for n in self.rig.plant.signals}
        units = {n: unit for n, unit in self.source.units.items() if n in channels or n == "time"}
        return {"name": self.source.name, "time": self.source.time.tolist(), "channels": channels, "units": units}


@dataclass(frozen=True, eq=False)
class MachineSubject:
    """A machine with declared parameters that gives its own figures."""

    name: str
    machine: AbstractMachine

    @property
    def usual(self) -> tuple[str, ...]:
        """See ``RigSubject``: all of them."""
        return tuple(self.machine.units)

    @property
    def table(self) -> dict[str, Declaration]:
        """See ``RigSubject``."""
        return dict(parameters.declared(self.machine))

    @property
    def units(self) -> dict[str, str]:
        """See ``RigSubject``."""
        return dict(self.machine.units)

    def coldest(self, metric: str, axes: Sequence[Axis]) -> float:
        """See ``RigSubject``: a machine may be driven from any temperature, but none is below the absolute zero."""
        return _ABSOLUTE_ZERO if self.units[metric] == "degC" else -math.inf

    @property
    def always(self) -> tuple[str, ...]:
        """See ``RigSubject``: none."""
        return ()

    def check(self, axes: Sequence[Axis], metrics: Sequence[str]) -> None:
        """See ``RigSubject``: all goes."""

    def study(self, axes: tuple[str, ...], metrics: tuple[str, ...]) -> AbstractStudy:
        """See ``RigSubject``."""
        return MachineStudy(axes, self.machine, metrics)

    def value(self, name: str) -> float:
        """See ``RigSubject``."""
        return float(parameters.get(self.machine, name))

    def to_toml(self, values: Mapping[str, float] | None = None) -> str:
        """See ``RigSubject``."""
        return machines.to_toml(self.machine, values)

    def recorded(self) -> None:
        """See ``RigSubject``: there is none."""
        return None


Subject = RigSubject | MachineSubject


def read_subject(path: Path, data: Mapping[str, Any], folder: Path) -> Subject:
    """The subject in a rig's or machine's file, under the ``[input]`` of the sweep's ``data``, whose paths start at ``folder``."""
    text = read_text(path, "rig")
    if machines.is_machine(text):
        return _machine(text, str(path), path.name, data)
    rig = parse_rig(text, str(path), path.parent)
    given = _input(data)
    recording = rig.read(folder / given.recording, observed=False) if given.recording is not None else None
    return _rig(rig, given, recording)


def again(text: str, data: Mapping[str, Any], name: str, held: Mapping[str, Any] | None) -> Subject:
    """The subject of an earlier sweep, from what ``to_toml`` and ``recorded`` gave."""
    if machines.is_machine(text):
        return _machine(text, name, name, data)
    recording = None
    if held is not None:
        channels = {n: np.array(v) for n, v in held["channels"].items()}
        recording = Recording.from_arrays(held["name"], np.array(held["time"]), channels, held["units"])
    return _rig(parse_rig(text, name), _input(data), recording)


def _machine(text: str, place: str, name: str, data: Mapping[str, Any]) -> MachineSubject:
    machine = machines.parse_machine(text, place)
    if "input" in data:
        raise InputError("[input] has no place with a machine, which gives its figures without one: take it out")
    return MachineSubject(name, machine)


def _input(data: Mapping[str, Any]) -> _Input:
    if "input" not in data:
        lines = 'wave = "square", amplitude = "0.4 A" and frequency = "0.1 Hz"'
        raise InputError(f"the section [input] is missing: add [input] with lines like {lines}, or with a recording")
    return validate(_Input, data["input"], "input")


def _rig(rig: Rig, given: _Input, recording: Recording | None) -> RigSubject:
    if rig.kind == "path":
        raise InputError("sweep.rig is a path, which has no clock: sweep a rig that runs in time")
    if recording is not None:
        extra = [key for key in ("wave", "amplitude", "frequency", "duty", "highest") if getattr(given, key) is not None]
        if extra:
            raise InputError(f"input.{extra[0]} has no place beside input.recording: take one of the two out")
        control = rig.plant.drive.control
        heating = numbered(control, rig.plant.mechanism.wires) if control else ()
        if heating and not any(np.any(recording.channels[n]) for n in heating):
            raise InputError(f"input.recording: {' and '.join(heating)} is 0 throughout, so that no wire is heated: name another one")
        return RigSubject(rig, recording, given.cycles or 1, 0.0)
    if rig.plant.mechanism.prescribed:
        raise InputError(f"[input] needs a recording, since this rig follows its {rig.plant.mechanism.prescribed[0]}: add recording = ...")
    wave = _wave(rig, given)
    highest = 0.0
    if given.highest is not None:
        highest = quantity_at(given.highest, "Hz", "input.highest")
        if not highest > wave.frequency:
            ends = f"input.highest = {show(given.highest)} is not above input.frequency = {show(given.frequency)}"
            raise InputError(f"{ends}: correct one of the two")
    return RigSubject(rig, wave, wave.cycles, highest)


def _wave(rig: Rig, given: _Input) -> Wave:
    for key in ("wave", "amplitude", "frequency"):
        if getattr(given, key) is None:
            example = _Input.model_fields[key].examples
            raise InputError(f"input.{key} is missing: add a line like {key} = {example[0] if example else ''} to [input], or a recording")
    control = CHANNELS[rig.plant.drive.control]
    amplitude = quantity_at(given.amplitude, control.unit, "input.amplitude")
    frequency = quantity_at(given.frequency, "Hz", "input.frequency")
    duty = 0.5 if given.duty is None else quantity_at(given.duty, "1", "input.duty")
    if not 0.0 < amplitude <= control.plausible[1]:
        top = f"above 0, up to {control.plausible[1]:g} {control.unit}".removesuffix(" 1")
        raise InputError(f"input.amplitude = {show(given.amplitude)} is not possible: give one {top}, since nothing else heats a wire")
    if not 0.0 < frequency <= 1e4:
        raise InputError(f"input.frequency = {show(given.frequency)} is not possible: give one above 0, up to 10 kHz")
    if not 0.0 < duty < 1.0:
        raise InputError(f"input.duty = {show(given.duty)} is not possible: give the share of a cycle that is on, between 0 and 1")
    return Wave(str(given.wave), amplitude, frequency, duty, given.cycles or 4)
