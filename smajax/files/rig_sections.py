"""The sections of a rig file as far as they need no plant: kinds, keys and values by their declarations.

These checks come first in reading a rig (``rig_file``). A command makes them before JAX is loaded, too, with the tables
of the shipped classes in place of the classes (``rig_classes.without_classes``), in the same sentences.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.channel_settings import ChannelSettings, channel_settings
from smajax.files.fit_settings import (
    FittedPlant,
    channels_of_sensors,
    check_observed,
    fit_settings,
    observed_channels,
)
from smajax.files.recording_settings import recording_options
from smajax.files.renamed_keys import current_line_numbers, with_current_rig_keys
from smajax.files.rig_checks import check_belongs, check_order, check_sections, require_values
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import DEFAULTS, Stages, choose_stages
from smajax.files.rig_schema import FitSection, RigSection
from smajax.files.rig_structure import take_structure
from smajax.files.rig_values import (
    ParameterSet,
    effect_values,
    entries_for,
    entry_values,
    file_values,
    has_exponent,
    read_parameter_set,
    section_values,
    value_sources,
)
from smajax.files.toml import check_schema, parse_toml, validate
from smajax.parameters.definitions import TIES, Declaration, by_leaf, declarations, sensor_declarations
from smajax.recordings.read import read_recordings
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recording import Recording

# Sections in the order of the fields of a plant, in which messages name parameters; those of its mechanism follow.
_PLANT_SECTIONS = ("cells", "grains", "wire", "environment", "initial", "drive", "heat", "material")


@dataclass(frozen=True)
class RigSections:
    """The sections of a rig file that determine its plant.

    Attributes:
        data: All sections, under their current names.
        head: The section ``[rig]``.
        fit: The section ``[fit]``.
        observe: Channels that are fitted.
        stages: Classes of the stages.
        parameter_set: The parameter set that the rig names.
        table: Declarations of the parameters of the stages by name.
        values: Values in the rig file by name.
        entries: Entries of the parameter set that the rig uses.
        leaf_values: Values by leaf, those of the parameter set and of the kind included.
        sources: Origin of each value by leaf.
        place: Place of each key of the file, for messages.
    """

    data: dict[str, Any]
    head: RigSection
    fit: FitSection
    observe: tuple[str, ...]
    stages: Stages
    parameter_set: ParameterSet
    table: Mapping[str, Declaration]
    values: Mapping[str, float]
    entries: dict[str, Any]
    leaf_values: Mapping[str, float]
    sources: dict[str, str]
    place: Mapping[str, str]


@dataclass(frozen=True)
class CheckedRig:
    """What a rig file says of its recordings and parameters.

    Attributes:
        channels: The section ``[channels]``.
        options: The section ``[recording]``.
        required: Channels that a recording must have.
        observed: Channels that are fitted.
        clock: Whether it must have a time.
        control: Electrical input; empty if there is none.
        prescribed: Recorded channels that the mechanism follows.
        parameters: Declarations of the parameters of the plant by name.
    """

    channels: ChannelSettings
    options: ReadOptions
    required: tuple[str, ...]
    observed: tuple[str, ...]
    clock: bool
    control: str
    prescribed: tuple[str, ...]
    parameters: Mapping[str, Declaration]

    def read(self, path: Path, *, observed: bool, changes: Mapping[str, Any]) -> list[Recording]:
        """Read the recordings of a file, with the checks of ``smajax.files.rig_file.Rig.read_all``.

        Args:
            path: The file.
            observed: Whether it must also have the channels that are fitted.
            changes: Options of ``ReadOptions`` by name, in place of those of the rig.

        Raises:
            InputError: If it cannot be used; the message names file, row and column.
        """
        return read_recordings(
            path,
            mapping=self.channels.columns,
            ignore=self.channels.ignore,
            required=self.required,
            observed=self.observed if observed else (),
            clock=self.clock,
            options=self.options.replace(**changes),
        )


def read_sections(data: Mapping[str, Any], name: str, rows: Mapping[str, int], folder: Path) -> RigSections:
    """Read the sections that determine the plant.

    Args:
        data: Sections of the file, under their current names.
        name: Name of the file.
        rows: Row of each key.
        folder: Folder to which the path of a parameter set is relative.

    Raises:
        InputError: If they are invalid; the message names section and key.
    """
    data, structure = take_structure(data)
    head, fit = _read_head_and_fit(data)
    observe = observed_channels(fit, head.kind)
    parameter_set = read_parameter_set(data, folder)
    exponent = has_exponent(data, parameter_set)
    stages = choose_stages(head.kind, head.control, fit.model, observe, exponent, structure)
    check_belongs(data, stages, head.control)
    place = {n: f"{name} line {rows[n]}" if n in rows else name for n in _names_in(data)}

    # Values from the rig file, else the parameter set, else the kind and the declarations.
    table = stages.table()
    leaves = [n for n in table if n not in TIES]
    values = file_values(data, stages)
    entries = entries_for(parameter_set, table, by_leaf(values))
    leaf_values = {**DEFAULTS.get(head.kind, {}), **by_leaf(entry_values(entries)), **by_leaf(values)}
    require_values([n for n in leaves if table[n].default is None], leaf_values, stages)
    sources = value_sources(leaves, entries, values, parameter_set.name, place)
    # Stages check the order as well, without the place of a value.
    check_order(leaf_values.get, lambda n: table[n].unit, sources)
    return RigSections(
        data, head, fit, observe, stages, parameter_set, table, values, entries, leaf_values, sources, place
    )


def check_rig_sections(text: str, name: str, folder: Path) -> CheckedRig:
    """Check the text of a rig file as far as it needs no plant.

    Args:
        text: The text.
        name: Name of the file in messages.
        folder: Folder to which paths of parameter sets are relative.

    Returns:
        What it says of its recordings and parameters.

    Raises:
        InputError: As ``smajax.files.rig_file.parse_rig``.
    """
    data = parse_toml(text, name)
    try:
        sections = read_sections(with_current_rig_keys(data), Path(name).name, current_line_numbers(text), folder)
        return _check_other_sections(sections)
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def read_sensor_values(sections: RigSections) -> dict[str, float]:
    """Return the gains and offsets of sensors in the rig file, by parameter name in internal units.

    Args:
        sections: The sections of the file.

    Raises:
        InputError: If a key or a value is not valid.
    """
    table = {f"sensor.{key}": d for key, d in sensor_declarations(sections.stages.observable).items()}
    return section_values("sensor", sections.data.get("sensor", {}), table)


def _check_other_sections(sections: RigSections) -> CheckedRig:
    """Check the sections that do not determine the stages, but for what depends on the values of the plant."""
    data, stages, fit = sections.data, sections.stages, sections.fit
    check_observed(sections.observe, stages, sections.head.kind)
    sensor_values = read_sensor_values(sections)
    effects = effect_values(data.get("effects", {}))
    plant = _fitted_plant(sections, sensor_values, effects)
    fit_settings(fit, sections.observe, plant, {})
    channels = channel_settings(data.get("channels", {}))
    surroundings = [name for key in effects for name in getattr(rig_classes().effects[key], "surroundings", ())]
    required = tuple(dict.fromkeys((*stages.signals, *surroundings)))
    return CheckedRig(
        channels=channels,
        options=recording_options(data),
        required=required,
        observed=sections.observe,
        clock=sections.head.kind != "path",
        control=plant.control,
        prescribed=tuple(stages.mechanism.prescribed),
        parameters=plant.table,
    )


def _fitted_plant(
    sections: RigSections, sensor_values: Mapping[str, float], effects: Mapping[str, Mapping[str, float]]
) -> FittedPlant:
    """Return what the settings of the fit need of the plant, from declarations and values."""
    stages, fit = sections.stages, sections.fit
    order = [*_PLANT_SECTIONS, *stages.parts]
    leaves = sorted((n for n in sections.table if n not in TIES), key=lambda n: order.index(n.partition(".")[0]))
    table = {name: sections.table[name] for name in leaves}
    ties = {name: declaration for name, declaration in sections.table.items() if name in TIES}
    values = dict(sections.leaf_values)
    for key, numbers in effects.items():
        table |= {f"effects.{key}.{n}": d for n, d in declarations(rig_classes().effects[key]).items()}
        values |= {f"effects.{key}.{n}": value for n, value in numbers.items()}
    names = [*sensor_values, *sections.parameter_set.entries, *fit.free, *fit.per_recording]
    channels = dict.fromkeys([*sections.observe, *channels_of_sensors(names)])
    sensors = sensor_declarations(channel for channel in channels if channel in stages.observable)
    table |= {f"sensor.{key}": d for key, d in sensors.items()} | ties
    values |= {n: entry.value for n, entry in sections.parameter_set.entries.items() if n.startswith("sensor.")}
    values |= sensor_values

    def nominal(name: str) -> float:
        value = values.get(name, table[name].default)
        return math.nan if value is None else value

    return FittedPlant(table, stages.observable, stages.drive.control, nominal)


def _read_head_and_fit(data: Mapping[str, Any]) -> tuple[RigSection, FitSection]:
    """Check the names of all sections, and return ``[rig]`` and ``[fit]``."""
    _refuse_actuator(data.get("rig"))
    check_sections(data)
    check_schema(data)
    if "rig" not in data:
        cure = 'add [rig] with lines like kind = "dead-weight" and control = "current"'
        raise InputError(f"the section [rig] is missing: {cure}")
    head = validate(RigSection, data["rig"], "rig")
    fit = validate(FitSection, data.get("fit", {}), "fit")
    if head.control is None and head.kind != "path":
        cure = 'add the electrical input that is recorded, as in control = "current", or control = "temperature"'
        raise InputError(f"rig.control is missing: {cure}")
    return head, fit


def _refuse_actuator(head: Any) -> None:
    """Refuse an actuator file, which is not a rig file."""
    kind = head.get("kind") if isinstance(head, dict) else None
    classes = rig_classes()
    if not isinstance(kind, str) or kind in classes.mechanisms:
        return
    if kind in classes.actuators:
        problem = f'rig.kind = "{kind}" is an actuator, whose metrics need no recording'
        raise InputError(f"{problem}: 'smajax sweep' computes them, 'smajax check' shows its file")


def _names_in(data: Mapping[str, Any]) -> list[str]:
    return [f"{section}.{key}" for section, content in data.items() if isinstance(content, dict) for key in content]
