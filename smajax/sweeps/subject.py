"""Subject of a sweep: a rig under an input, or an actuator that computes its own metrics."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from smajax import parameters
from smajax.actuators.base import AbstractActuator
from smajax.channels import CHANNELS
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.files.rig_file import Rig, parse_rig
from smajax.files.toml import quantity_at, read_text, show
from smajax.parameters.definitions import Declaration
from smajax.plant.mechanisms.rotary import MasslessRotary
from smajax.recordings.recording import Recording
from smajax.sweeps.actuator_problem import ActuatorSweepProblem
from smajax.sweeps.excitation import Excitation
from smajax.sweeps.input_section import check_duties, check_input_recording, read_excitation
from smajax.sweeps.margins import Margins
from smajax.sweeps.metrics import METRICS
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.rig_problem import RigSweepProblem
from smajax.sweeps.schema import INPUT, InputSection, input_declarations, read_input
from smajax.sweeps.space import Axis

# Names of the metrics of a rig.
METRIC_NAMES = (*METRICS, "bandwidth")
_DEFAULT_METRICS = ("stroke", "force", "peak_temperature", "energy_per_cycle", "efficiency")
# Metrics that need a periodic input.
_NEEDS_WAVE = ("time_to_cool", "bandwidth")
_ABSOLUTE_ZERO = -273.15


@dataclass(frozen=True, eq=False)
class RigSubject:
    """Rig under a periodic input or a recording.

    Attributes:
        rig: The rig.
        source: The periodic input or the recording.
        cycles: Number of cycles of the input.
        max_frequency: Frequency in Hz up to which a bandwidth is searched for; 0 if the file gives none.
    """

    rig: Rig
    source: Excitation | Recording
    cycles: int
    max_frequency: float

    @property
    def name(self) -> str:
        """Name of the rig file."""
        return self.rig.name

    @property
    def default_metrics(self) -> tuple[str, ...]:
        """Metrics of a sweep whose file names none."""
        return _DEFAULT_METRICS

    @property
    def required_metrics(self) -> tuple[str, ...]:
        """Metrics of every sweep: what a wire bears must be seen, asked for or not."""
        return ("peak_stress", "settling")

    @property
    def declarations(self) -> dict[str, Declaration]:
        """Parameters that can vary, by name."""
        table = dict(parameters.all_declarations(self.rig.plant))
        if isinstance(self.source, Excitation):
            table |= input_declarations(self.rig.plant.drive.control, "square" in self.source.all_shapes)
        return table

    @property
    def units(self) -> dict[str, str]:
        """Internal units of all metrics that can be computed."""
        return self._problem((), METRIC_NAMES, 0.0).units

    def lower_bound(self, metric: str, axes: Sequence[Axis]) -> float:
        """Return a lower bound of a metric over all designs.

        A peak temperature, degC, is bounded by the lowest temperature at the start; other metrics have no bound.

        Args:
            metric: Name of the metric.
            axes: Axes of the space.

        Returns:
            The bound in the metric's internal unit; minus infinity if there is none.
        """
        if metric != "peak_temperature":
            return -math.inf
        lower = {axis.name: axis.lower for axis in axes}
        starts = [lower.get(name, self.value(name)) for name in ("environment.ambient", "initial.temperature")]
        return float(np.nanmin(starts))

    def check(self, axes: Sequence[Axis], metrics: Sequence[str]) -> None:
        """Check axes and metrics.

        Args:
            axes: Axes of the space.
            metrics: Names of the metrics to evaluate.

        Raises:
            InputError: If an axis has no effect, or a metric cannot be computed under this input.
        """
        for name in (axis.name for axis in axes):
            if name in ("pulley.inertia", "pulley.damping") and isinstance(self.rig.plant.mechanism, MasslessRotary):
                raise InputError(
                    f"parameters.{name} has no effect while the rig has neither inertia nor damping: "
                    "give it one in the rig"
                )
        if any(axis.name == f"{INPUT}amplitude" and not axis.upper > 0.0 for axis in axes):
            raise InputError(
                f"parameters.{INPUT}amplitude is 0 throughout, and nothing else heats a wire: give values above 0"
            )
        varied = {axis.name for axis in axes}
        if f"{INPUT}wave" in varied and "time_to_cool" in metrics:
            raise InputError(
                f"time_to_cool begins at the end of the heating, which differs with {INPUT}wave: take one of them out"
            )
        self._check_largest_input(axes)
        if not isinstance(self.source, Excitation) and (only := [n for n in _NEEDS_WAVE if n in metrics]):
            raise InputError(
                f"{only[0]} needs a wave, and [input] has a recording: take the metric out, or give a wave"
            )
        if "bandwidth" in metrics and not self.max_frequency:
            raise InputError(
                "input.highest is missing: a bandwidth is searched for up to a frequency, as in "
                'highest = "10 Hz" under [input]'
            )
        top = max((axis.upper for axis in axes if axis.name == f"{INPUT}frequency"), default=0.0)
        if "bandwidth" in metrics and top >= self.max_frequency:
            raise InputError(
                f"input.highest = {self.max_frequency:g} Hz is not above the range of {INPUT}frequency, which ends at "
                f"{top:g} Hz: raise it, or narrow the range"
            )

    def _check_largest_input(self, axes: Sequence[Axis]) -> None:
        """Raises InputError if offset and amplitude together exceed what an input can be."""
        if not isinstance(self.source, Excitation):
            return
        control = CHANNELS[self.rig.plant.drive.control]
        upper = {axis.name: axis.upper for axis in axes}
        top = upper.get(f"{INPUT}offset", self.source.offset) + upper.get(f"{INPUT}amplitude", self.source.amplitude)
        if f"{INPUT}offset" in upper and top > control.plausible_range[1]:
            raise InputError(
                f"parameters.{INPUT}offset and the amplitude that is added to it reach {top:g} {control.unit}, above "
                f"{control.plausible_range[1]:g}: narrow one of the ranges".replace(" 1,", ",")
            )

    def problem(
        self, axes: tuple[str, ...], metrics: tuple[str, ...], margins: Margins | None = None
    ) -> AbstractSweepProblem:
        """Return the map from a design to its metrics.

        Args:
            axes: Names of the axes, in the order of a design's values.
            metrics: Names of the metrics to evaluate.
            margins: Margins of constraints; ``None`` for none.
        """
        return self._problem(axes, metrics, self.max_frequency, margins)

    def _problem(
        self, axes: tuple[str, ...], metrics: tuple[str, ...], max_frequency: float, margins: Margins | None = None
    ) -> RigSweepProblem:
        rig = self.rig
        return RigSweepProblem(
            axes, rig.plant, metrics, self.source, self.cycles, rig.interpolation, max_frequency, margins
        )

    def with_axes(self, axes: Sequence[Axis]) -> "RigSubject":
        """Return the subject whose input has the duties and shapes of the axes.

        Args:
            axes: Axes of the space.

        Raises:
            InputError: If a range of the duty contains the phase of another edge of the input.
        """
        source = self.source
        if not isinstance(source, Excitation):
            return self
        by_name = {axis.name: axis for axis in axes}
        if shapes := by_name.get(f"{INPUT}wave"):
            source = replace(source, shapes=shapes.labels)
        if duty := by_name.get(f"{INPUT}duty"):
            check_duties(duty, source, self.rig.plant.mechanism.wires)
            source = replace(source, duties=(duty.lower, duty.upper))
        return replace(self, source=source)

    def value(self, name: str) -> float:
        """Return the value of a parameter in the rig file, in its internal unit."""
        return float(parameters.get(self.rig.plant, name))

    def to_toml(self, values: Mapping[str, float] | None = None) -> str:
        """Return the text of the rig's file, with other ``values`` of some parameters, in internal units."""
        return self.rig.to_toml(values)

    def recording_document(self) -> dict[str, Any] | None:
        """Return the recording as a JSON document, for ``rebuild_subject``; ``None`` under a periodic input."""
        if isinstance(self.source, Excitation):
            return None
        names = self.rig.plant.driving_channels(self.source.channels)
        channels = {n: self.source.channels[n].tolist() for n in names}
        units = {n: unit for n, unit in self.source.units.items() if n in channels or n == "time"}
        return {"name": self.source.name, "time": self.source.time.tolist(), "channels": channels, "units": units}


@dataclass(frozen=True, eq=False)
class ActuatorSubject:
    """Actuator with declared parameters that computes its own metrics.

    Attributes:
        name: Name of its file.
        actuator: The actuator.
    """

    name: str
    actuator: AbstractActuator

    @property
    def default_metrics(self) -> tuple[str, ...]:
        """Metrics of a sweep whose file names none: all."""
        return tuple(self.actuator.units)

    @property
    def required_metrics(self) -> tuple[str, ...]:
        """Metrics of every sweep: none."""
        return ()

    @property
    def declarations(self) -> dict[str, Declaration]:
        """Parameters that can vary, by name."""
        return dict(parameters.all_declarations(self.actuator))

    @property
    def units(self) -> dict[str, str]:
        """Internal units of all metrics."""
        return dict(self.actuator.units)

    def lower_bound(self, metric: str, axes: Sequence[Axis]) -> float:
        """Return absolute zero for a temperature in degC, and minus infinity for other metrics."""
        return _ABSOLUTE_ZERO if self.units[metric] == "degC" else -math.inf

    def check(self, axes: Sequence[Axis], metrics: Sequence[str]) -> None:
        """Accept all axes and metrics."""

    def with_axes(self, axes: Sequence[Axis]) -> "ActuatorSubject":
        """Return the actuator, which has no input."""
        return self

    def problem(
        self, axes: tuple[str, ...], metrics: tuple[str, ...], margins: Margins | None = None
    ) -> AbstractSweepProblem:
        """Return the map from a design to its metrics; arguments as for ``RigSubject.problem``."""
        return ActuatorSweepProblem(axes, self.actuator, metrics)

    def value(self, name: str) -> float:
        """Return the value of a parameter in the actuator's file, in its internal unit."""
        return float(parameters.get(self.actuator, name))

    def to_toml(self, values: Mapping[str, float] | None = None) -> str:
        """Return the text of the actuator's file, with other ``values`` of some parameters, in internal units."""
        return actuator_file.to_toml(self.actuator, values)

    def recording_document(self) -> None:
        """Return ``None``: an actuator has no recording."""
        return None


Subject = RigSubject | ActuatorSubject


def read_subject(path: Path, data: Mapping[str, Any], folder: Path) -> Subject:
    """Read the rig or actuator of a sweep, with its input.

    Args:
        path: File of a rig or an actuator.
        data: Data of the sweep file; its section ``[input]`` belongs to a rig.
        folder: Folder from which relative paths in ``data`` start.

    Raises:
        InputError: If a file or the input is not valid.
    """
    text = read_text(path, "rig")
    if actuator_file.is_actuator(text):
        return _actuator_subject(text, str(path), path.name, data)
    rig = parse_rig(text, str(path), path.parent)
    settings = read_input(data)
    recording = rig.read(folder / settings.recording, observed=False) if settings.recording is not None else None
    return _rig_subject(rig, settings, recording)


def rebuild_subject(
    text: str, data: Mapping[str, Any], name: str, recording_document: Mapping[str, Any] | None
) -> Subject:
    """Return the subject of an earlier sweep.

    Args:
        text: What ``to_toml`` returned.
        data: Data of the sweep file.
        name: Name of the file of the rig or actuator.
        recording_document: What ``recording_document`` returned.

    Raises:
        InputError: If the rig, actuator or input is not valid in this version.
    """
    if actuator_file.is_actuator(text):
        return _actuator_subject(text, name, name, data)
    recording = None
    if recording_document is not None:
        document = recording_document
        channels = {n: np.array(v) for n, v in document["channels"].items()}
        recording = Recording.from_arrays(document["name"], np.array(document["time"]), channels, document["units"])
    return _rig_subject(parse_rig(text, name), read_input(data), recording)


def _actuator_subject(text: str, place: str, name: str, data: Mapping[str, Any]) -> ActuatorSubject:
    actuator = actuator_file.parse_actuator(text, place)
    if "input" in data:
        raise InputError("[input] has no place with an actuator, which computes its metrics without one: take it out")
    return ActuatorSubject(name, actuator)


def _rig_subject(rig: Rig, settings: InputSection, recording: Recording | None) -> RigSubject:
    if rig.kind == "path":
        raise InputError("sweep.rig is a stress path, which has no time: sweep a rig that runs in time")
    if recording is not None:
        check_input_recording(rig, settings, recording)
        return RigSubject(rig, recording, settings.cycles or 1, 0.0)
    control = rig.plant.drive.control
    if followed := [name for name in rig.plant.signals if not control or name in rig.plant.mechanism.prescribed]:
        raise InputError(f"[input] needs a recording, since this rig follows its {followed[0]}: add recording = ...")
    excitation = read_excitation(rig, settings)
    max_frequency = 0.0
    if settings.highest is not None:
        max_frequency = quantity_at(settings.highest, "Hz", "input.highest")
        if not max_frequency > excitation.frequency:
            ends = f"input.highest = {show(settings.highest)} is not above input.frequency = {show(settings.frequency)}"
            raise InputError(f"{ends}: correct one of the two")
    return RigSubject(rig, excitation, excitation.cycles, max_frequency)
