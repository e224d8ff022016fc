"""The rig: what stood on the bench, read from ``rig.toml``, checked, and made into a plant.

The file's sections are checked one by one against models made from the stages' declarations (``rig_schema``). A value comes from the rig
file, else from the parameter set that it names, else from the declaration's default; ``Rig.sources`` says which.
"""

import math
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any, Literal, NamedTuple, cast

from smajax import parameters, recording
from smajax.channel_settings import ChannelSettings, channel_settings
from smajax.datasets import shipped
from smajax.diagnose.effects import catalogue
from smajax.errors import InputError, nearest
from smajax.fit_settings import FitSettings, check_observed, fit_settings, flat, observed_channels, sensed
from smajax.parameter_file import Entry, read_parameters
from smajax.parameters import TIES, Declaration, as_float, declarations
from smajax.plant.effect import AbstractEffect
from smajax.plant.plant import Plant
from smajax.plant.rotary import LightRotary, Rotary
from smajax.plant.sensor import Sensor
from smajax.recording import Recording
from smajax.rig_schema import (
    DEFAULTS,
    KINDS,
    FitSection,
    RigSection,
    Stages,
    as_text,
    channel_unit,
    check_belongs,
    check_coil,
    check_order,
    check_sections,
    check_whole,
    choose_stages,
    parts_of,
    require,
    section_model,
)
from smajax.toml_file import check_schema, lines, parse, read_text, render, show, validate, write_text


@dataclass(frozen=True, eq=False)
class Rig:
    """One rig file.

    ``plant`` has the nominal values. ``sources`` says of each parameter where its value came from: the rig file's line, a parameter set, or
    "default". ``notes`` list what was read and not used. ``misplaced`` says of effects that such a rig cannot have, and that were left
    out, why.
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

    def read(self, path: str | Path, *, drop_bad_rows: bool = False, observed: bool = True) -> Recording:
        """Read a recording of this rig: its inputs have to be there, and, if ``observed``, the channels that are fitted."""
        return recording.read(
            path,
            mapping=self.channels.columns,
            ignore=self.channels.ignore,
            required=self.plant.signals,
            observed=self.fit.observe if observed else (),
            clock=self.kind != "path",
            skip_rows=self.channels.skip_rows,
            delimiter=self.channels.delimiter,
            decimal=self.channels.decimal,
            sheet=self.channels.sheet,
            drop_bad_rows=drop_bad_rows,
        )

    def to_toml(self, values: Mapping[str, Any] | None = None) -> str:
        """The rig as a file that holds every parameter's value, those in ``values`` (internal units) in place of the nominal ones.

        Read back it gives the same plant. InputError if the values make no rig, such as an austenite finish below its start.
        """
        for name in values or {}:
            parameters.declaration(self.plant, name)
        plant = parameters.replace(self.plant, values or {})
        drive = {"control": plant.drive.control or None}
        data: dict[str, Any] = {"schema": 1, "rig": {"kind": self.kind, **drive, "interpolation": self.interpolation}}
        for section, part in parameters.sections(plant).items():
            home, _, key = section.partition(".")
            written = _written(plant, section, list(declarations(part)))
            data |= {home: data.get(home, {}) | {key: written}} if key else {section: written}
        data["sensor"] = _written(plant, "sensor", list(plant.sensor.declarations()))
        data["channels"] = self.channels.table()
        data["fit"] = _written_fit(self.fit, plant)
        text = render({key: value for key, value in data.items() if value != {}})
        parse_rig(text, f"{self.name} with new values")
        return text

    def write(self, path: str | Path, values: Mapping[str, Any] | None = None) -> None:
        """Write ``to_toml`` to a file, completely or not at all."""
        write_text(Path(path), self.to_toml(values))


def read_rig(path: str | Path, *, drop_misplaced: bool = False) -> Rig:
    """Read and check a rig file. InputError: one sentence with file, section and key, and the cure.

    With ``drop_misplaced``, effects that such a rig cannot have are left out instead, and ``Rig.misplaced`` says why.
    """
    path = Path(path)
    rig = parse_rig(read_text(path, "rig"), str(path), path.parent, drop_misplaced=drop_misplaced)
    return replace(rig, name=path.name, path=path)


def parse_rig(text: str, name: str = "rig.toml", folder: Path | None = None, *, drop_misplaced: bool = False) -> Rig:
    """The rig in a TOML text; ``name`` is the file's in sentences, ``folder`` where parameter sets given by a path are looked for."""
    data = parse(text, name)
    try:
        rig = _rig(data, Path(name).name, lines(text), folder or Path())
        if rig.misplaced and not drop_misplaced:
            key, why = next(iter(rig.misplaced.items()))
            raise InputError(f"effects.{key} has no place on this rig: {why}")
        return rig
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


class _Set(NamedTuple):
    """A parameter set: its name as the rig has it, and its entries, of which those for one recording only stand apart."""

    name: str
    entries: Mapping[str, Entry]
    apart: tuple[str, ...] = ()


def _rig(data: dict[str, Any], name: str, rows: Mapping[str, int], folder: Path) -> Rig:
    _refuse_machine(data.get("rig"))
    check_sections(data)
    check_schema(data)
    if "rig" not in data:
        raise InputError('the section [rig] is missing: add [rig] with lines like kind = "dead-weight" and control = "current"')
    head = validate(RigSection, data["rig"], "rig")
    fit = validate(FitSection, data.get("fit", {}), "fit")
    if head.control is None and head.kind != "path":
        raise InputError('rig.control is missing: add the electrical input that is recorded, as in control = "current"')
    observe = observed_channels(fit, head.kind)
    taken = _set(data, folder)
    stages = choose_stages(head.kind, head.control, fit.model, observe, _exponent(data, taken))
    check_belongs(data, stages, head.control)

    table = stages.table()
    leaves = [n for n in table if n not in TIES]
    given = _given(data, stages)
    own = _members(given)
    from_set = {n: entry for n, entry in taken.entries.items() if n in table and not own.keys() >= set(TIES.get(n, (n,)))}
    _check_units(from_set, table, taken.name)
    values = {**DEFAULTS.get(head.kind, {}), **_members(_numbers(from_set)), **own}
    require([n for n in leaves if table[n].default is None], values, stages)
    freed = [*fit.free, *fit.per_recording]
    plant = _plant(stages, values, freed)
    place = {n: f"{name} line {rows[n]}" if n in rows else name for n in _written_names(data)}
    sources = _sources(leaves, from_set, given, taken.name, place)
    check_order(lambda n: _value(plant, n), lambda n: table[n].unit, sources)
    check_whole({n: table[n] for n in leaves if n not in freed}, lambda n: _value(plant, n), sources)
    check_coil(plant.wire)

    check_observed(observe, plant, head.kind)
    sensors = {f"sensor.{key}": d for key, d in Sensor.identity(plant.observable).declarations().items()}
    read_here = _quantities("sensor", data.get("sensor", {}), sensors)
    read_from_set = {n: entry for n, entry in taken.entries.items() if n in sensors and n not in read_here}
    readings = _numbers(read_from_set) | read_here
    effects, misplaced = _effects(data.get("effects", {}), plant.traits(tuple(observe)))
    plant, fit = replace(plant, effects=effects), _without(fit, misplaced)
    added = {n: "rig file" for n in parameters.declared(plant) if n.startswith("effects.")}
    plant = replace(plant, sensor=_sensor([*observe, *sensed([*readings, *freed])], plant, readings))
    sources |= _sources([f"sensor.{key}" for key in plant.sensor.declarations()], read_from_set, read_here, taken.name, place)

    bounded = {n: entry for n, entry in (from_set | read_from_set).items() if entry.upper - entry.lower < math.inf}
    set_bounds = {n: (entry.lower, entry.upper) for n, entry in bounded.items() if not own.keys() & set(TIES.get(n, (n,)))}
    settings = fit_settings(fit, observe, plant, stages.inert, set_bounds)
    return Rig(
        name=name,
        path=None,
        kind=head.kind,
        plant=plant,
        interpolation=cast(Literal["hold", "linear"], head.interpolation),
        fit=settings,
        channels=channel_settings(data.get("channels", {})),
        sources=sources | added | {tie: sources[members[0]] for tie, members in TIES.items() if tie in table},
        notes=tuple(_notes(taken, {*table, *sensors}, settings)),
        misplaced=misplaced,
    )


def _refuse_machine(head: Any) -> None:
    """InputError for a machine's file, which is no rig's."""
    kind = head.get("kind") if isinstance(head, dict) else None
    if not isinstance(kind, str) or kind in KINDS:
        return
    from smajax.machines import MACHINES

    if kind in MACHINES:
        what = f'rig.kind = "{kind}" is a machine, which gives its figures without a recording'
        raise InputError(f"{what}: 'smajax sweep' asks it for them, 'smajax check' shows its file")


def _exponent(data: Mapping[str, Any], taken: _Set) -> bool:
    """Whether h(T) has an exponent: the rig's coefficients decide, else the set's."""
    heat = data.get("heat")
    own = heat if isinstance(heat, dict) else {}
    return "exponent" in own or ("heat.exponent" in taken.entries and not {"h1", "h2"} & own.keys())


def _set(data: Mapping[str, Any], folder: Path) -> _Set:
    material = data.get("material")
    wanted = material.get("set") if isinstance(material, dict) else None
    if wanted is None:
        return _Set("", {})
    known = sorted(path.stem for path in shipped("parameters").glob("*.toml"))
    if not isinstance(wanted, str) or not wanted:
        raise InputError(f'material.set = {show(wanted)} is not a name: write it like set = "{known[0] if known else "my-wire.toml"}"')
    if wanted in known:
        path = shipped("parameters", f"{wanted}.toml")
    elif wanted.endswith(".toml") or "/" in wanted:
        path = folder / wanted
    else:
        there = f"the shipped ones are {', '.join(known)}" if known else "none is shipped"
        raise InputError(f"material.set = '{wanted}' is not known{nearest(wanted, known)}: {there}, and a file of your own ends in .toml")
    try:
        entries = read_parameters(path)
    except InputError as error:
        raise InputError(f"material.set: {error}") from None
    apart = tuple(n for n in entries if "@" in n)
    return _Set(wanted, {n: entry for n, entry in entries.items() if n not in apart}, apart)


def _given(data: Mapping[str, Any], stages: Stages) -> dict[str, float]:
    """The parameters that the rig file itself sets, by name, ties among them."""
    found: dict[str, float] = {}
    for section in stages.parts:
        content = data.get(section, {})
        if section == "material" and isinstance(content, dict):
            content = {key: value for key, value in content.items() if key != "set"}
        found |= _quantities(section, content, {n: d for n, d in stages.table().items() if n.startswith(f"{section}.")})
    return found


def _quantities(section: str, content: Any, table: Mapping[str, Declaration]) -> dict[str, float]:
    """The parameters of one section, by name, as the rig file sets them."""
    keys = {name.rsplit(".", 1)[1]: declaration for name, declaration in table.items()}
    checked = validate(section_model(section, keys), content, section)
    return {f"{section}.{key}": value for key, value in checked.model_dump(exclude_unset=True).items()}


def _numbers(entries: Mapping[str, Entry]) -> dict[str, float]:
    return {n: entry.value for n, entry in entries.items()}


def _check_units(entries: Mapping[str, Entry], table: Mapping[str, Declaration], set_name: str) -> None:
    for n, entry in entries.items():
        if entry.unit != table[n].unit:
            units = f"{entry.unit}, and this rig's is in {table[n].unit}"
            raise InputError(f"parameter set {set_name}: {n} is in {units}: give it in the rig, in that unit")


def _written_names(data: Mapping[str, Any]) -> list[str]:
    return [f"{section}.{key}" for section, content in data.items() if isinstance(content, dict) for key in content]


def _sources(
    leaves: Sequence[str], from_set: Mapping[str, Any], given: Mapping[str, Any], set_name: str, place: Mapping[str, str]
) -> dict[str, str]:
    """Where the value of each parameter comes from."""
    taken = dict.fromkeys(_members(from_set), f"parameter set {set_name}")
    return dict.fromkeys(leaves, "default") | taken | _members({n: place[n] for n in given})


def _members(values: Mapping[str, Any]) -> dict[str, Any]:
    """Values by leaf: a tie's goes to its members, and a member's own wins."""
    tied = {member: value for name, value in values.items() for member in TIES.get(name, ())}
    return tied | {name: value for name, value in values.items() if name not in TIES}


def _plant(stages: Stages, values: Mapping[str, float], freed: list[str]) -> Plant:
    """The plant, its sensors still without channels.

    A pulley of two wires with neither inertia nor damping, and neither of them free, follows the forces at once; a sheath with neither
    friction nor conduction, and nothing of it free, is none.
    """

    def build(section: str, part: type) -> Any:
        return part(**{key: as_float(values[f"{section}.{key}"]) for key in declarations(part) if f"{section}.{key}" in values})

    inertial = ("pulley.inertia", "pulley.damping")
    mechanism = stages.mechanism
    if mechanism is Rotary and not any(values.get(n) or n in freed for n in inertial):
        mechanism = LightRotary
    stage_classes = {"drive": stages.drive, "heat": stages.heat, **stages.parts}
    built = {section: build(section, part) for section, part in stage_classes.items()}
    carried = {section: built.pop(section) for section in parts_of(stages.mechanism)}
    if "sheath" in carried and not (
        values.get("sheath.friction") or values.get("sheath.conduction") or any(n.startswith("sheath.") for n in freed)
    ):
        carried["sheath"] = None
    return Plant(mechanism=mechanism(**carried), sensor=Sensor.identity(()), **built)


def _effects(content: Any, traits: frozenset[str]) -> tuple[tuple[AbstractEffect, ...], dict[str, str]]:
    """The effects of ``[effects.KEY]`` sections, and why a rig like this one cannot have others. Refuses what is not in the catalogue."""
    if not isinstance(content, dict):
        raise InputError('effects is not a section: write an effect as [effects.latent-heat] with strength = "60 MJ/m^3" below it')
    found, misplaced = [], {}
    for key, values in content.items():
        kind = catalogue().get(key)
        if kind is None:
            raise InputError(f"effects.{key} is not in the catalogue{nearest(key, catalogue())}")
        section = f"effects.{key}"
        numbers = _quantities(section, values, {f"{section}.{n}": d for n, d in declarations(kind).items()})
        if why := kind.obstacle(traits):
            misplaced[key] = why
            continue
        found.append(kind(**{n.rsplit(".", 1)[1]: as_float(v) for n, v in numbers.items()}))
    return tuple(found), misplaced


def _without(fit: FitSection, effects: Iterable[str]) -> FitSection:
    """The section without the parameters of these effects."""
    gone = tuple(f"effects.{key}." for key in effects)
    lists = {name: [n for n in getattr(fit, name) if not n.startswith(gone)] for name in ("free", "per_recording")}
    bounds = {name: ends for name, ends in flat(fit.bounds).items() if not name.startswith(gone)}
    return fit.model_copy(update=lists | {"bounds": bounds}) if gone else fit


def _sensor(channels: list[str], plant: Plant, values: Mapping[str, float]) -> Sensor:
    known = [channel for channel in dict.fromkeys(channels) if channel in plant.observable]
    gain = {channel: as_float(float(values.get(f"sensor.{channel}_gain", 1.0))) for channel in known}
    offset = {channel: as_float(float(values.get(f"sensor.{channel}_offset", 0.0))) for channel in known}
    return Sensor(gain, offset)


def _value(plant: Plant, name: str) -> float | None:
    """The value of a parameter, None where this plant has no such parameter or leaves it to the start."""
    if name not in parameters.declared(plant):
        return None
    value = float(parameters.get(plant, name))
    return None if math.isnan(value) else value


def _notes(taken: _Set, usable: set[str], settings: FitSettings) -> list[str]:
    unused = [*(n for n in taken.entries if n not in usable), *taken.apart]
    notes = [f"parameter set {taken.name}: not used here are {', '.join(unused)}"] if unused else []
    idle = [n for n in settings.bounds if n not in settings.names]
    return notes + ([f"fit.bounds without effect, since these are not free: {', '.join(idle)}"] if idle else [])


def _written(plant: Plant, section: str, keys: list[str]) -> dict[str, Any]:
    """A section as a table of quantities; a tie whose members agree is written as one key."""
    values = {f"{section}.{key}": _value(plant, f"{section}.{key}") for key in keys}
    for tie, members in TIES.items():
        if tie.startswith(f"{section}.") and len({values.get(member) for member in members}) == 1:
            values = {tie if n == members[0] else n: value for n, value in values.items() if n not in members[1:]}
    units = {n: d.unit for n, d in parameters.declared(plant).items()}
    return {n.rsplit(".", 1)[1]: as_text(value, units[n]) for n, value in values.items() if value is not None}


def _written_fit(fit: FitSettings, plant: Plant) -> dict[str, Any]:
    units = {n: d.unit for n, d in parameters.declared(plant).items()}
    return {
        "model": fit.model,
        **{key: list(getattr(fit, key)) for key in ("free", "per_recording", "initial") if getattr(fit, key)},
        "observe": list(fit.observe),
        "starts": fit.starts,
        "seed": fit.seed,
        "bounds": {n: [as_text(end, units[n]) for end in span] for n, span in fit.bounds.items()} or None,
        "noise": {c: as_text(value, channel_unit(c, difference=True)) for c, value in fit.noise.items()} or None,
    }
