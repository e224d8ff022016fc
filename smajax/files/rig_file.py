"""Rig files: ``rig.toml`` describes a test rig; it is read, checked, and built into a plant.

Each section of the file is checked against a model built from the declarations of the stages. The value of a parameter
comes from the rig file, else from the parameter set that it names, else from the default of its declaration;
``Rig.sources`` says which.
"""

from collections.abc import Collection, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, cast

from smajax import parameters
from smajax.arguments import as_path
from smajax.errors import InputError
from smajax.files.channel_settings import ChannelSettings, channel_settings
from smajax.files.fit_settings import FitSettings, FittedPlant, channels_of_sensors, check_observed, fit_settings
from smajax.files.mappings import plain_tables
from smajax.files.parameter_sets import find_set
from smajax.files.recording_notes import with_notes
from smajax.files.recording_settings import recording_options
from smajax.files.renamed_keys import current_line_numbers, with_current_rig_keys
from smajax.files.rig_checks import check_coil, check_whole
from smajax.files.rig_plant import build_effects, build_plant, build_sensor, value_of
from smajax.files.rig_schema import FitSection
from smajax.files.rig_sections import read_sections, read_sensor_values
from smajax.files.rig_text import rig_toml
from smajax.files.rig_values import ParameterSet, effect_values, entry_values, set_bounds, value_sources
from smajax.files.toml import flatten_keys, parse_toml, read_text, write_text
from smajax.parameters.definitions import TIES, Declaration, by_leaf, sensor_declarations
from smajax.plant.plant import Plant
from smajax.plant.stages import SURROUNDINGS
from smajax.recordings.read import only_recording, read_recordings
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recording import Recording
from smajax.recordings.sources import RecordingSource


@dataclass(frozen=True, eq=False, repr=False)
class Rig:
    """A rig: plant, settings of the fit, and columns of its recordings.

    Attributes:
        name: Name of the file.
        path: Path of the file; ``None`` for a rig made from text.
        kind: Kind of the rig, a key of ``MECHANISMS``.
        plant: The plant with the nominal values and the interpolation of the rig.
        interpolation: Interpolation of the inputs between samples.
        fit: The section ``[fit]``.
        channels: The section ``[channels]``.
        recording: The section ``[recording]``.
        sources: Origin of each value by parameter name: a line of the rig file, a parameter set, or "default".
        notes: Sentences on entries that were read and are not used.
        misplaced: Effects that do not apply to this rig and were omitted, with the reason.
        text: Text that the rig was read from; ``None`` for a rig that was built.
        parameter_set: Name and path of the parameter set that the rig names; ``None`` if it names none.
    """

    name: str
    path: Path | None
    kind: str
    plant: Plant
    interpolation: Literal["hold", "linear"]
    fit: FitSettings
    channels: ChannelSettings
    sources: Mapping[str, str]
    notes: tuple[str, ...] = ()
    misplaced: Mapping[str, str] = field(default_factory=dict)
    text: str | None = None
    recording: ReadOptions = field(default_factory=ReadOptions)
    parameter_set: tuple[str, Path] | None = None

    def __post_init__(self) -> None:
        # The plant has the interpolation, too, so that it simulates alone as the rig does; that of the rig counts where
        # either was replaced.
        if self.plant.interpolation != self.interpolation:
            object.__setattr__(self, "plant", replace(self.plant, interpolation=self.interpolation))

    def __repr__(self) -> str:
        return f"<Rig {self.name}: {self.kind}, {self.fit.model}>"

    def read(self, source: RecordingSource, **arguments: Any) -> Recording:
        """Read a recording of this rig.

        Args:
            source: A path, a DataFrame, a dictionary of columns, an array with ``headers``, or a ``Recording``, as in
                ``read_recordings``; it must have the inputs of the plant.
            **arguments: Arguments of ``read_all``.

        Raises:
            InputError: If it cannot be used, or has several recordings; the message names file or object, row and
                column.
        """
        return only_recording(self.read_all(source, **arguments), "Rig.read_all")

    def read_all(
        self,
        source: RecordingSource,
        *,
        name: str | None = None,
        headers: Sequence[str] | None = None,
        drop_bad_rows: bool = False,
        observed: bool = True,
        **changes: Any,
    ) -> list[Recording]:
        """Read the recordings of a file of this rig: one, or several sheets, or the parts between bad rows.

        Their notes name what is recorded and not used, and inputs that never change.

        Args:
            source: As in ``read``.
            name: Name of the recording; by default that of the file, or "recording".
            headers: Headers of an array, or of a text file without a header row.
            drop_bad_rows: Whether to omit rows that cannot be used.
            observed: Whether it must also have the channels that are fitted.
            **changes: Options of ``ReadOptions`` in place of those of the rig, such as ``skip_rows=3``.

        Raises:
            InputError: If it cannot be used; the message names file or object, row and column.
        """
        recordings = read_recordings(
            source,
            name=name,
            headers=headers,
            mapping=self.channels.columns,
            ignore=self.channels.ignore,
            required=(*self.plant.signals, *self.plant.required_surroundings),
            observed=self.fit.observe if observed else (),
            clock=self.kind != "path",
            drop_bad_rows=drop_bad_rows,
            options=self.recording,
            **changes,
        )
        return [with_notes(self.plant, self.fit, self.kind, recording) for recording in recordings]

    def with_read_options(self, **changes: Any) -> "Rig":
        """Return the rig with other options of ``[recording]``.

        Args:
            **changes: New values of options of ``ReadOptions`` by name, such as ``skip_rows=3``.

        Raises:
            InputError: If a name or a value is not valid.
        """
        return replace(self, recording=self.recording.replace(**changes))

    def to_toml(self, values: Mapping[str, Any] | None = None) -> str:
        """Return the text of a rig file with the value of every parameter; reading it gives the same plant.

        Args:
            values: Values by parameter name in internal units, which replace the nominal ones.

        Raises:
            InputError: If a name is unknown, or the values fail the checks of ``parse_rig``, such as an austenite
                finish below its start.
        """
        for name in values or {}:
            parameters.declaration(self.plant, name)
        plant = parameters.replace(self.plant, values or {})
        text = rig_toml(self.kind, self.interpolation, plant, self.channels, self.fit, self.recording)
        parse_rig(text, f"{self.name} with new values")
        return text

    def write(self, path: str | Path, values: Mapping[str, Any] | None = None) -> None:
        """Write the text of ``to_toml`` to a file, completely or not at all.

        Args:
            path: The file.
            values: Values by parameter name in internal units, which replace the nominal ones.

        Raises:
            InputError: If the values fail the checks of ``parse_rig``, or the file cannot be written.
        """
        write_text(as_path("write", "path", path, "the path of a rig file"), self.to_toml(values))


def read_rig(source: str | Path | Mapping[str, Any], *, drop_misplaced: bool = False) -> Rig:
    """Read and check a rig file, or a dictionary with the sections of one.

    Args:
        source: The file; or a dictionary such as ``{"schema": 1, "rig": {"kind": ...}, "wire": {...}}``, in which paths
            are relative to the current folder.
        drop_misplaced: Whether effects that do not apply to this rig are omitted (``Rig.misplaced`` has the reasons)
            instead of refused.

    Raises:
        InputError: If the file is missing or invalid; the message names file, section and key.
    """
    if isinstance(source, Mapping):
        return _parse_data(plain_tables(source, "rig"), "rig", {}, Path(), drop_misplaced)
    path = as_path("read_rig", "rig", source, "the path of a rig file, a dictionary with its sections, or a Rig")
    rig = parse_rig(read_text(path, "rig"), str(path), path.parent, drop_misplaced=drop_misplaced)
    return replace(rig, name=path.name, path=path)


def parse_rig(text: str, name: str = "rig.toml", folder: Path | None = None, *, drop_misplaced: bool = False) -> Rig:
    """Parse and check the text of a rig file.

    Args:
        text: The text.
        name: Name of the file in messages.
        folder: Folder to which paths of parameter sets are relative; the current folder by default.
        drop_misplaced: Whether effects that do not apply to this rig are omitted instead of refused.

    Raises:
        InputError: If the text is invalid; the message names file, section and key.
    """
    rig = _parse_data(parse_toml(text, name), name, current_line_numbers(text), folder or Path(), drop_misplaced)
    return replace(rig, text=text)


def _parse_data(data: dict[str, Any], name: str, rows: Mapping[str, int], folder: Path, drop_misplaced: bool) -> Rig:
    """Check the tables of a rig file, whose keys stand in the given rows, and build the rig."""
    try:
        rig = _build_rig(with_current_rig_keys(data), Path(name).name, rows, folder)
        if rig.misplaced and not drop_misplaced:
            key, reason = next(iter(rig.misplaced.items()))
            raise InputError(f"effects.{key} does not apply to this rig: {reason}")
        return rig
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def _build_rig(data: dict[str, Any], name: str, rows: Mapping[str, int], folder: Path) -> Rig:
    sections = read_sections(data, name, rows, folder)
    data, head, fit, observe, stages = sections.data, sections.head, sections.fit, sections.observe, sections.stages
    parameter_set, table, sources = sections.parameter_set, sections.table, dict(sections.sources)
    free = [*fit.free, *fit.per_recording]
    plant = build_plant(stages, sections.leaf_values, free)
    _check_counts(plant, table, free, sources)

    # Effects and sensors depend on the stages.
    check_observed(observe, plant, head.kind)
    sensor_table = {f"sensor.{key}" for key in sensor_declarations(plant.observable)}
    sensor_values = read_sensor_values(sections)
    sensor_entries = {n: e for n, e in parameter_set.entries.items() if n in sensor_table and n not in sensor_values}
    values = effect_values(data.get("effects", {}))
    effects, misplaced = build_effects(values, plant.capabilities((*observe, *SURROUNDINGS)))
    plant, fit = replace(plant, effects=effects), _without_effects(fit, misplaced)
    calibration = entry_values(sensor_entries) | sensor_values
    sensor = build_sensor([*observe, *channels_of_sensors([*calibration, *free])], plant, calibration)
    plant = replace(plant, sensor=sensor)
    sensor_leaves = [f"sensor.{key}" for key in plant.sensor.declarations()]
    sources |= value_sources(sensor_leaves, sensor_entries, sensor_values, parameter_set.name, sections.place)
    sources |= {n: "rig file" for n in parameters.all_declarations(plant) if n.startswith("effects.")}

    bounds = set_bounds(sections.entries | sensor_entries, by_leaf(sections.values))
    settings = fit_settings(fit, observe, _fitted_plant(plant, stages.inert), bounds)
    return Rig(
        name=name,
        path=None,
        kind=head.kind,
        plant=plant,
        interpolation=cast(Literal["hold", "linear"], head.interpolation),
        fit=settings,
        channels=channel_settings(data.get("channels", {})),
        recording=recording_options(data),
        sources=sources | {tie: sources[members[0]] for tie, members in TIES.items() if tie in table},
        notes=tuple(_notes(parameter_set, {*table, *sensor_table}, settings)),
        misplaced=misplaced,
        parameter_set=(parameter_set.name, find_set(parameter_set.name, folder)) if parameter_set.name else None,
    )


def _fitted_plant(plant: Plant, inert: Collection[str]) -> FittedPlant:
    """Return what the settings of a fit need of a plant."""
    table = {name: d for name, d in parameters.all_declarations(plant).items() if name not in inert}
    return FittedPlant(table, plant.observable, plant.drive.control, lambda n: float(parameters.get(plant, n)))


def _check_counts(
    plant: Plant, table: Mapping[str, Declaration], free: Iterable[str], sources: Mapping[str, str]
) -> None:
    """Check counts, and the geometry of a coil; a count that is fitted may be any number."""
    counts = {n: d for n, d in table.items() if n not in TIES and n not in set(free)}
    check_whole(counts, lambda n: value_of(plant, n), sources)
    check_coil(plant.wire)


def _without_effects(fit: FitSection, effects: Iterable[str]) -> FitSection:
    """Return the section without the parameters of these effects."""
    prefixes = tuple(f"effects.{key}." for key in effects)
    lists = {name: [n for n in getattr(fit, name) if not n.startswith(prefixes)] for name in ("free", "per_recording")}
    bounds = {name: ends for name, ends in flatten_keys(fit.bounds).items() if not name.startswith(prefixes)}
    return fit.model_copy(update=lists | {"bounds": bounds}) if prefixes else fit


def _notes(parameter_set: ParameterSet, usable: set[str], settings: FitSettings) -> list[str]:
    """Return sentences on entries of the parameter set and bounds that are not used."""
    unused = [*(n for n in parameter_set.entries if n not in usable), *parameter_set.per_recording]
    notes = [f"parameter set {parameter_set.name}: unused entries: {', '.join(unused)}"] if unused else []
    idle = [n for n in settings.bounds if n not in settings.names]
    return notes + (
        [f"fit.bounds without effect, since the parameters are not free: {', '.join(idle)}"] if idle else []
    )
