"""Reader of controller.toml: the controller and its channel, the reference, the sensors, and the tuning.

    [controller]
    kind = "pid"                      # pid, bpid, ppid, adaptive-pid, or the name of a registered one
    period = "20 ms"
    output = ["0 A", "0.5 A"]         # limits of the command
    [gains]                           # where the search starts
    kp = "30 A/m"
    [feedforward]                     # optional: the inverse of an operator that is fitted to a slow loop
    operators = 10
    [reference]
    kind = "staircase"                # step, staircase, sine, recorded
    ...
    [tune]
    objective = "tracking"            # tracking, itae, settling, or weights of several
    [limits]
    temperature = "110 degC"
    [temperature_limiter]             # optional: keeps the wire below a temperature, whatever the command
    limit = "115 degC"
    kp = "0.05 A/K"
    [estimator]                       # optional: temperature from the wire's power; or kind = "extended"
    gain = "0.2 1/s"                  # and corrected by a thermocouple
    [instruments]                     # optional: the sensors of temperature limiter and estimator
    temperature = { noise = "0.5 K", lag = "1 s" }

Quantities have units; those of the gains follow from the drive and the channel. The message for a mistake is one
sentence that names file and key.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any, NamedTuple

import jax.numpy as jnp
import numpy as np

from smajax.channels import CHANNELS, numbered
from smajax.control.analysis.case_numbers import NOISE_CASES
from smajax.control.analysis.step_response import find_jumps
from smajax.control.controller_file.scenario import read_scenario
from smajax.control.controller_file.schema import OPTIONS, ControllerSection, TuneSection, controller_section
from smajax.control.controller_file.search_sections import (
    Robust,
    read_bounds,
    read_check,
    read_feedforward,
    read_limits,
    read_objective,
    read_robust,
)
from smajax.control.controller_file.sections import current_sections
from smajax.control.controller_file.sensors import read_sensors
from smajax.control.controllers.base import AbstractController
from smajax.control.controllers.registry import controller_class, file_kinds
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gains, unit_of, with_gains
from smajax.control.loop.rollout import Scenario
from smajax.control.sampled_plant import SampledPlant
from smajax.control.tuning.feedforward_identification import Feedforward
from smajax.control.tuning.task import TuningTask
from smajax.errors import InputError
from smajax.files.rig_file import Rig
from smajax.files.toml import advice, parse_toml, quantity_at, read_text, show, validate
from smajax.files.validators import quantity

# Shortest period in s, lowest frequency of a carrier in Hz, and narrowest settling band: they detect wrong units.
_MIN_PERIOD = 1e-6
_MIN_CARRIER = 1e-3
_MIN_BAND = 1e-4


@dataclass(frozen=True, eq=False)
class ControllerFile(TuningTask):
    """Content of a controller file in internal units.

    Attributes:
        name: Name of the file.
        units: Unit of each gain by name.
        feedforward: Section [feedforward]; ``None`` if there is none.
        seed: Seed of all random numbers.
        robust: Section [robust]; ``None`` if there is none.
        case_fit: Folder of the fit that the rig belongs to, from whose intervals cases are drawn without [robust];
            ``None`` if there is none.
        check: Number of draws of the noise on which the gains are judged; 1 for the rollout of the file only.
        prefers_margins: Whether gains with usual margins are preferred: with an objective that is a word other than
            settling.
        place: What messages call it, such as its path.
        notes: Sentences on recordings that the file names, such as their channels that are not used.
    """

    name: str
    units: Mapping[str, str]
    feedforward: Feedforward | None = None
    seed: int = 0
    robust: Robust | None = None
    case_fit: Path | None = None
    check: int = NOISE_CASES
    prefers_margins: bool = False
    place: str = "controller"
    notes: tuple[str, ...] = ()


class _Units(NamedTuple):
    """Name of the controlled channel, and units of the command, of the channel, and of differences of the channel."""

    channel: str
    command: str
    value: str
    difference: str


def read_controller(path: Path, rig: Rig) -> ControllerFile:
    """Read and check a controller file for a rig.

    Args:
        path: The file; paths in it are relative to its folder.
        rig: The rig.

    Returns:
        The content of the file, with default values, in internal units.

    Raises:
        InputError: if the file cannot be read, or for any mistake in it, with section, key and cure.
    """
    data = parse_toml(read_text(path, "controller"), str(path))
    try:
        return _read(current_sections(data), path, rig)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None


def _read(data: Mapping[str, Any], path: Path, rig: Rig) -> ControllerFile:
    head = controller_section(data["controller"])
    tune = validate(TuneSection, data.get("tune", {}), "tune")
    period = quantity_at(head.period, "s", "controller.period", least=_MIN_PERIOD)
    units = _units(head, rig)
    system = _sampled_plant(head, rig, period)
    output = _output(head, units.command, system)
    loop, gain_units = _loop(data, rig, head, units, (period, system.wires, output))
    rest = system.observe(system.start(), jnp.zeros(system.wires))
    rest_value = float(rest[units.channel])
    channel = (units.channel, units.value, period)
    scenario, notes = read_scenario(data, path.parent, rig, channel, rest_value, tune.seed)
    reference = np.asarray(scenario.reference)
    if not scenario.changes and not np.ptp(np.append(reference, rest_value)) > 0.0:
        raise InputError(
            "reference: it stays at the channel's value at rest, so there is nothing to follow: give it another level"
        )
    limits = read_limits(data.get("limits", {}), max(float(rest[n]) for n in numbered("temperature", system.wires)))
    weights, settle = read_objective(tune.objective, "overshoot" in limits)
    _check_jumps(scenario, period, settle, limits)
    feedforward = None
    if "feedforward" in data:
        feedforward = read_feedforward(data["feedforward"], path, rig, head, (units.command, units.channel))
        notes += feedforward.notes
    return ControllerFile(
        name=path.name,
        notes=notes,
        system=system,
        loop=loop,
        scenario=scenario,
        units=gain_units,
        bounds=read_bounds(tune, loop, gain_units),
        weights=weights,
        settle=settle,
        limits=limits,
        feedforward=feedforward,
        band=quantity_at(tune.band, "1", "tune.band", least=_MIN_BAND),
        starts=tune.starts,
        prefers_margins=isinstance(tune.objective, str) and not settle,
        check=read_check(tune),
        seed=tune.seed,
        robust=read_robust(data["robust"], path, rig) if "robust" in data else None,
        place=str(path),
    )


def _units(head: ControllerSection, rig: Rig) -> _Units:
    """Channel and units of a controller."""
    plant = rig.plant
    channel = head.channel or plant.mechanism.coordinate
    if channel not in plant.observable or channel not in CHANNELS:
        channels = [c for c in plant.observable if c in CHANNELS]
        raise InputError(
            f"controller.channel: '{channel}' cannot be controlled here{advice(channel, channels, 'the channels are')}"
        )
    value = CHANNELS[channel].unit
    # A rig without a drive has no unit of the command; ``_sampled_plant`` raises the error.
    command = CHANNELS[plant.drive.control].unit if plant.drive.control else "1"
    return _Units(channel, command, value, "K" if value == "degC" else value)


def _sampled_plant(head: ControllerSection, rig: Rig, period: float) -> SampledPlant:
    carrier = None
    if head.carrier is not None:
        carrier = quantity_at(head.carrier, "Hz", "controller.carrier", least=_MIN_CARRIER)
    try:
        return SampledPlant.of(rig.plant, period, carrier=carrier)
    except InputError as error:
        raise InputError(f"controller{'.carrier' if carrier else ''}: {error}") from None


def _output(head: ControllerSection, unit: str, system: SampledPlant) -> tuple[float, float]:
    """Smallest and largest command."""
    lower, upper = (quantity_at(end, unit, "controller.output") for end in head.output)
    if system.plant.drive.control == "duty" and max(-lower, upper) > 1.0:
        raise InputError(
            f"controller.output: a duty is a share of the supply, and {show(head.output[1])} is beyond 1: "
            "give limits between 0 and 1, or between '0 %' and '100 %'"
        )
    if not lower < upper:
        raise InputError("controller.output: the first limit has to be below the second")
    if system.wires == 1 and lower < 0.0:
        raise InputError(
            f"controller.output: a wire cannot be cooled by its drive: make the lower limit {show('0 ' + unit)} or more"
        )
    return lower, upper


def _loop(
    data: Mapping[str, Any],
    rig: Rig,
    head: ControllerSection,
    units: _Units,
    sampling: tuple[float, int, tuple[float, float]],
) -> tuple[ClosedLoop, dict[str, str]]:
    """The closed loop with its start gains, and the unit of each; ``sampling`` is period, wires and output limits."""
    period, wires, (lower, upper) = sampling
    sensors = read_sensors(data, rig, units.channel, (units.command, units.difference), period, max(upper, -lower))
    controller = _controller(data["controller"], head, period, (lower, upper))
    loop = ClosedLoop(controller, **sensors._asdict(), channel=units.channel)
    try:
        loop = loop.for_wires(wires)
    except InputError as error:
        raise InputError(f"controller.output: {error}") from None
    return _with_gains(loop, head.kind, data["gains"], (units.command, units.difference))


def _controller(
    section: Mapping[str, Any], head: ControllerSection, period: float, output: tuple[float, float]
) -> AbstractController:
    """The controller with its default gains, and with the options that the section gives."""
    cls = controller_class(head.kind)
    for name in OPTIONS:
        if name in section and name not in cls.options():
            owners = " or ".join(f'"{kind}"' for kind, other in file_kinds().items() if name in other.options())
            raise InputError(f"controller.{name} belongs to kind = {owners}: take it out, or change the kind")
    fields = {f.name: f for f in dataclasses.fields(cls)}
    for name in cls.options():
        if name not in section and name in fields and _is_required(fields[name]):
            raise InputError(
                f"controller.{name} is missing: {head.kind} needs a line like {name} = ..., since it has no default"
            )
    options = {name: section[name] for name in cls.options() if name in section}
    for name, value in options.items():
        default = fields[name].default if name in fields else None
        if isinstance(default, float) and isinstance(value, int) and not isinstance(value, bool):
            options[name] = float(value)
        elif isinstance(default, bool | int | float | str) and type(value) is not type(default):
            raise InputError(f"controller.{name} = {show(value)} is not possible: give a value like {show(default)}")
    return cls.with_default_gains(output, period, **options)


def _is_required(field: dataclasses.Field) -> bool:
    return field.default is dataclasses.MISSING and field.default_factory is dataclasses.MISSING


def _with_gains(loop: ClosedLoop, kind: str, section: Any, units: tuple[str, str]) -> tuple[ClosedLoop, dict[str, str]]:
    """The loop with its start gains, and the unit of each gain."""
    declared = gains(loop)
    gain_units = {name: unit_of(name, loop, *units) for name in declared}
    if not isinstance(section, dict):
        raise InputError("[gains] is a section, not a value: write the gains below a line [gains]")
    values = {}
    for name, value in section.items():
        if name not in declared:
            raise InputError(f"gains.{name} is not known{advice(name, declared, f'those of {kind} are')}")
        try:
            values[name] = quantity(value, replace(declared[name], unit=gain_units[name]))
        except InputError as error:
            raise InputError(f"gains.{name}: {error}") from None
    if not any(values.get(name) for name in gains(loop.controller)):
        first = next(iter(gains(loop.controller)), None)
        if first is not None:
            name = "kp" if "kp" in gain_units else first
            raise InputError(f"[gains] holds no gain above 0: give at least {name}, in {gain_units[name]}")
    loop = with_gains(loop, values)
    try:
        loop.controller.check_gains()
    except InputError as error:
        raise InputError(f"gains: {error}") from None
    return loop, gain_units


def _check_jumps(scenario: Scenario, period: float, settle: bool, limits: Mapping[str, float]) -> None:
    """Raise an error for objectives and limits of a step response if the reference has no jump."""
    if find_jumps(np.asarray(scenario.reference), float(scenario.initial_reference), period).rows:
        return
    if settle:
        raise InputError(
            "tune.objective: the reference never jumps and holds, so there is no settling time to minimise: choose "
            "tracking instead"
        )
    if unused := [key for key in ("overshoot", "settling") if key in limits]:
        raise InputError(
            f"limits.{unused[0]}: the reference never jumps and holds, so there is nothing to limit: take it out"
        )
