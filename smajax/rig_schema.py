"""What may stand in a rig file: which sections a kind of rig has, and which keys a section, all of it from the stages' declarations.

A parameter is declared once, in the stage that uses it. The sections of a rig are the parts of the plant that its kind, control and model
choose, and the pydantic model of a section is made from that part's declarations. A new kind, control or material is one entry in a table.
"""

import dataclasses
import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Annotated, Any, get_args

import equinox as eqx
from pydantic import BaseModel, BeforeValidator, Field, create_model

from smajax.datasets import shipped
from smajax.errors import InputError, nearest
from smajax.parameters import ORDERED, TIES, Declaration, declarations
from smajax.plant.drive import DRIVES, AbstractDrive, NoDrive
from smajax.plant.heat import AbstractHeat, PolynomialHeat, PowerHeat, PrescribedTemperature
from smajax.plant.limb import TendonLimb
from smajax.plant.material.base import AbstractMaterial
from smajax.plant.material.brinson import Brinson
from smajax.plant.material.lagoudas import Lagoudas
from smajax.plant.material.tanaka import LiangRogers, Tanaka
from smajax.plant.mechanism import AbstractMechanism, BiasSpring, DeadWeight, StressPath, TestingMachine
from smajax.plant.rotary import Joint, Rotary
from smajax.plant.sensor import Sensor
from smajax.plant.wire import AbstractWire, Coil, Environment, Initial, Wire
from smajax.toml_file import STRICT, advice, parse, show
from smajax.units import CHANNELS, channel_of, example_of, format_quantity
from smajax.units import parse as parse_quantity

KINDS: Mapping[str, type[AbstractMechanism]] = {
    "dead-weight": DeadWeight,
    "bias-spring": BiasSpring,
    "antagonistic-rotary": Rotary,
    "testing-machine": TestingMachine,
    "path": StressPath,
    "coil-dead-weight": DeadWeight,
    "coil-bias-spring": BiasSpring,
    "coil-antagonistic": Rotary,
    "hip": Joint,
    "elbow": TendonLimb,
    "wrist": TendonLimb,
    "glove-finger": TendonLimb,
}
# A wire is straight unless its kind of rig is listed here.
WIRES: Mapping[str, type[AbstractWire]] = dict.fromkeys(("coil-dead-weight", "coil-bias-spring", "coil-antagonistic", "hip"), Coil)
MATERIALS: Mapping[str, type[AbstractMaterial]] = {
    "brinson": Brinson,
    "lagoudas": Lagoudas,
    "tanaka": Tanaka,
    "liang-rogers": LiangRogers,
}
HEATS: Mapping[str, type[AbstractHeat]] = {"h(T) as a polynomial": PolynomialHeat, "an exponent in h(T)": PowerHeat}
INTERPOLATIONS = ("hold", "linear")
# A path is followed by a material point: the wire's size then scales nothing but force and resistance.
DEFAULTS: Mapping[str, Mapping[str, float]] = {"path": {"wire.diameter": 1e-3, "wire.length": 1.0}}
OTHER_SECTIONS = ("rig", "effects", "sensor", "channels", "fit")


@dataclasses.dataclass(frozen=True)
class Stages:
    """The classes of which a rig's plant is made."""

    kind: str
    mechanism: type[AbstractMechanism]
    drive: type[AbstractDrive]
    heat: type[AbstractHeat]
    material: type[AbstractMaterial]

    @property
    def parts(self) -> dict[str, type[eqx.Module]]:
        """The parameter sections of the rig with their classes; a stage without parameters has no section."""
        chosen = {"drive": self.drive, "heat": self.heat, "material": self.material, **parts_of(self.mechanism)}
        shared = {"wire": WIRES.get(self.kind, Wire), "environment": Environment, "initial": Initial}
        return {section: part for section, part in (chosen | shared).items() if declarations(part)}

    @property
    def inert(self) -> frozenset[str]:
        """Parameters that the plant has and this kind has no use for."""
        return frozenset({"initial.temperature"} if self.heat is PrescribedTemperature else ())

    def table(self) -> dict[str, Declaration]:
        """All parameters by name, sensors apart, each tie after its members."""
        leaves = {f"{section}.{key}": d for section, part in self.parts.items() for key, d in declarations(part).items()}
        leaves = {name: d for name, d in leaves.items() if name not in self.inert}
        return leaves | {tie: leaves[members[0]] for tie, members in TIES.items() if all(member in leaves for member in members)}

    def keys(self, section: str) -> dict[str, Declaration]:
        """The keys of a section with their declarations, ties included."""
        return {name.split(".", 1)[1]: d for name, d in self.table().items() if name.startswith(f"{section}.")}


def choose_stages(kind: str, control: str | None, model: str, observe: Iterable[str], exponent: bool) -> Stages:
    """The stages of a rig from what its file says; a path is led in strain where its stress is observed, else in stress."""
    if kind == "path":
        mechanism = TestingMachine if "stress" in observe else StressPath
        return Stages(kind, mechanism, NoDrive, PrescribedTemperature, MATERIALS[model])
    return Stages(kind, KINDS[kind], DRIVES[control or ""], PowerHeat if exponent else PolynomialHeat, MATERIALS[model])


def parts_of(mechanism: type[AbstractMechanism]) -> dict[str, type[eqx.Module]]:
    """The sections that a mechanism brings along, such as ``load`` or ``pulley``."""
    named = [(f.name, part) for f in dataclasses.fields(mechanism) for part in (f.type, *get_args(f.type))]
    return {name: part for name, part in named if isinstance(part, type) and issubclass(part, eqx.Module)}


def owners() -> Iterator[tuple[str, type[eqx.Module], str]]:
    """Every parameter section of any rig, each class that it can have, and the choice in the rig file that gives it that class."""
    yield from (("wire", Wire, "a straight wire"), ("wire", Coil, "a coiled wire"))
    yield from (("environment", Environment, ""), ("initial", Initial, ""))
    yield from (("drive", drive, f'control = "{control}"') for control, drive in DRIVES.items())
    yield from (("heat", heat, words) for words, heat in HEATS.items())
    yield from (("material", material, f'model = "{model}"') for model, material in MATERIALS.items())
    for kind, mechanism in KINDS.items():
        yield from ((section, part, f'kind = "{kind}"') for section, part in parts_of(mechanism).items())


def declarations_of(name: str) -> list[Declaration]:
    """The declarations that a parameter name has in any rig (``heat.h2`` has one for each form of h(T)); none if there is no such name."""
    section, _, key = name.partition(".")
    if section == "sensor":
        channel = key.rpartition("_")[0]
        sensor = Sensor.identity((channel,) if channel_of(channel) else ()).declarations()
        return [sensor[key]] if key in sensor else []
    keys = {member.partition(".")[2] for member in TIES.get(name, (name,))}
    own = {part: declarations(part) for s, part, _ in owners() if s == section}
    found = [next(table[k] for k in table if k in keys) for table in own.values() if keys <= table.keys()]
    return list(dict.fromkeys(found))


def names_of_all() -> list[str]:
    """All parameter names of all rigs, sensors apart."""
    return list(dict.fromkeys([f"{section}.{key}" for section, part, _ in owners() for key in declarations(part)] + list(TIES)))


def as_text(value: float, unit: str) -> str:
    """A value in an internal unit as a user would write it; read back it is the same float."""
    return format_quantity(value, display_unit(unit), unit)


def display_unit(unit: str) -> str:
    """The unit in which quantities of an internal unit are shown: mm for m, MPa for Pa."""
    return "1" if unit == "1" else example_of(unit).split(maxsplit=1)[1]


def quantity(value: Any, declaration: Declaration) -> float:
    """A quantity from a file in the declaration's unit, within its bounds."""
    number = parse_quantity(value, declaration.unit)
    if not declaration.lower <= number <= declaration.upper:
        ends = [as_text(end, declaration.unit) if math.isfinite(end) else "" for end in (declaration.lower, declaration.upper)]
        span = f"from {ends[0]} to {ends[1]}" if all(ends) else f"at least {ends[0]}" if ends[0] else f"at most {ends[1]}"
        raise InputError(f"{show(value)} is not possible for the {declaration.meaning}: give a value {span}")
    return number


def section_model(section: str, keys: Mapping[str, Declaration]) -> type[BaseModel]:
    """The pydantic model of a parameter section: each key a quantity, none of them required here, since a set may give them."""

    def reader(declaration: Declaration) -> Any:
        return Annotated[Any, BeforeValidator(lambda value: quantity(value, declaration))]

    fields: dict[str, Any] = {key: (reader(d), None) for key, d in keys.items()}
    return create_model(section, __config__=STRICT, **fields)


def one_of(choices: Iterable[str]) -> BeforeValidator:
    """Accepts one of some words, and names the nearest of them otherwise."""
    known = tuple(choices)

    def check(value: Any) -> str:
        if value in known:
            return value
        shown = [word if word.isidentifier() or "-" in word else repr(word) for word in known]
        raise InputError(f"{show(value)} is not known{nearest(str(value), shown)}: it is one of {', '.join(shown)}")

    return BeforeValidator(check)


class RigSection(BaseModel):
    """``[rig]``."""

    model_config = STRICT
    kind: Annotated[str, one_of(KINDS)] = Field(examples=['"dead-weight"'])
    control: Annotated[str, one_of(DRIVES)] | None = Field(None, examples=['"current"'])
    interpolation: Annotated[str, one_of(INTERPOLATIONS)] = "hold"


class FitSection(BaseModel):
    """``[fit]``, as far as it can be checked without the plant."""

    model_config = STRICT
    model: Annotated[str, one_of(MATERIALS)] = "brinson"
    free: list[str] = Field([], examples=['["heat.h0", "heat.capacity"]'])
    per_recording: list[str] = Field([], examples=['["environment.ambient"]'])
    initial: list[str] = Field([], examples=['["temperature"]'])
    bounds: dict[str, Any] = Field({}, examples=['{"heat.h0" = ["50 W/m^2/K", "200 W/m^2/K"]}'])
    observe: list[str] | None = Field(None, examples=['["displacement"]'])
    noise: dict[str, Any] = Field({}, examples=['{displacement = "0.02 mm"}'])
    starts: int | None = Field(None, ge=1, le=10_000, examples=["4"])
    seed: int = Field(0, ge=0, le=2**32 - 1, examples=["0"])


def check_sections(data: Mapping[str, Any]) -> None:
    """Refuses a top-level key that is a section of no rig."""
    known = [*dict.fromkeys(["rig", *(section for section, _, _ in owners()), *OTHER_SECTIONS])]
    homes = {key: section for section, part, _ in reversed(list(owners())) for key in declarations(part)}
    homes |= {key: "fit" for key in FitSection.model_fields} | {key: "rig" for key in RigSection.model_fields}
    for section, value in data.items():
        if section in known or section == "schema":
            continue
        if section in homes and not isinstance(value, dict):
            raise InputError(f"{section} stands outside of its section: write it below a line [{homes[section]}]")
        what = f"[{section}] is not a section of a rig" if isinstance(value, dict | list) else f"{section} is not known"
        raise InputError(f"{what}{advice(section, known, 'the sections are')}")


def check_belongs(data: Mapping[str, Any], stages: Stages, control: str | None) -> None:
    """Refuses sections and keys that belong to another kind, control or form of law, and unknown keys with the nearest known one."""
    if stages.kind == "path" and control is not None:
        raise InputError("rig.control has no place on a path rig: take it out, since the recording gives the temperature itself")
    for section, content in data.items():
        if section == "schema" or section in OTHER_SECTIONS:
            continue
        choices = {words: part for s, part, words in owners() if s == section}
        if section not in stages.parts:
            others = [words for words in choices if words.startswith("kind")]
            cure = f", or set {' or '.join(others)} under [rig]" if others else ""
            raise InputError(f"[{section}] has no place on {a_rig(stages.kind)}: take it out{cure}")
        if not isinstance(content, dict):
            continue
        own = stages.keys(section)
        for key in content:
            if key in own or (section, key) == ("material", "set"):
                continue
            if f"{section}.{key}" in stages.inert:
                raise InputError(f"{section}.{key} has no place on {a_rig(stages.kind)}: take it out, since the recording gives it")
            others = [words for words, part in choices.items() if key in declarations(part)]
            if others:
                chosen = next(words for words, part in choices.items() if part is stages.parts[section])
                raise InputError(f"{section}.{key} has no place with {chosen}: it goes with {' or '.join(others)}, or take it out")
            homes = [home for home, part, _ in owners() if home in stages.parts and key in declarations(part)]
            if homes:
                raise InputError(f"{section}.{key} is not known (did you mean '{homes[0]}.{key}'?): write it under [{homes[0]}]")
            known = [*own, *(["set"] if section == "material" else [])]
            raise InputError(f"{section}.{key} is not known{advice(key, known, f'the keys of [{section}] are')}")


def a_rig(kind: str) -> str:
    """The kind with its article: a dead-weight rig, an antagonistic-rotary rig."""
    return f"{'an' if kind[0] in 'aeiou' else 'a'} {kind} rig"


def require(names: Iterable[str], given: Mapping[str, Any], stages: Stages) -> None:
    """Refuses a rig in which one of the parameters ``names`` has neither a value nor a default."""
    for name in names:
        if name not in given:
            section, key = name.split(".", 1)
            line = f"{key} = {_example(stages, name)}"
            or_set = ', or name a parameter set there, as in set = "NAME"' if section == "material" else ""
            raise InputError(f"{name} is missing: {a_rig(stages.kind)} needs a line like {line} under [{section}]{or_set}")


def _example(stages: Stages, name: str) -> str:
    """How the parameter stands in the shipped template of this kind, else any quantity of its unit."""
    section, key = name.split(".", 1)
    template = shipped("templates", f"{stages.kind}.toml")
    value = parse(template.read_text("utf-8"), template.name).get(section, {}).get(key) if template.is_file() else None
    value = value or example_of(stages.table()[name].unit)
    return f'"{value}"' if isinstance(value, str) else str(value)


def check_order(value_of: Callable[[str], float | None], unit_of: Callable[[str], str], origin: Mapping[str, str]) -> None:
    """Refuses bands of transformation that are empty or run backwards, and phase fractions that add up to more than 1."""
    for low, high in ORDERED:
        below, above = value_of(low), value_of(high)
        if below is not None and above is not None and not below < above:
            shown = [f"{name} = {as_text(value, unit_of(name))} ({origin[name]})" for name, value in ((high, above), (low, below))]
            raise InputError(f"{shown[0]} is not above {shown[1]}: correct one of the two")
    detwinned, twinned = value_of("initial.detwinned"), value_of("initial.twinned")
    if detwinned is not None and twinned is not None and detwinned + twinned > 1.0 + 1e-12:
        raise InputError(f"initial.detwinned and initial.twinned add up to {detwinned + twinned:.6g}: keep their sum at 1 or below")


def check_whole(table: Mapping[str, Declaration], value_of: Callable[[str], float | None], origin: Mapping[str, str]) -> None:
    """Refuses a part of something that is counted."""
    for name, declaration in table.items():
        value = value_of(name) if declaration.whole else None
        if value is not None and value != round(value):
            place = f"{name} = {value:.6g} ({origin[name]})"
            raise InputError(f"{place} is not a whole number, and it is the {declaration.meaning}: give a whole one")


def check_coil(wire: AbstractWire) -> None:
    """Refuses a coil that cannot be: its turns, its stretch, and a bundle's wiring."""
    if not isinstance(wire, Coil):
        return
    if wire.free_length is not None and not wire.fits:
        length, diameter = as_text(float(wire.free_length), "m"), as_text(float(wire.diameter), "m")
        turns = f"{wire.turns:.6g} turns of a wire of {diameter} take {1e3 * wire.solid_length:.6g} mm side by side"
        cure = "correct wire.turns, wire.diameter or wire.free_length (a radius taken for a diameter makes twice as much)"
        raise InputError(f"wire.free_length = {length} is too short: {turns}: {cure}")
    most = declarations(Wire)["prestrain"].upper
    if wire.prestrain > most:
        raise InputError(
            f"wire.prestretch = {as_text(float(wire.prestretch), 'm')} is too much: it strains this coil's wire like a tension of "
            f"{100 * wire.prestrain:.3g} %, and at most {100 * most:g} % is possible: give less, or correct the coil's sizes"
        )
    if wire.paths > wire.springs:
        cure = "a bundle has at most as many ways for the current as springs, and 1 where all are in series"
        raise InputError(f"wire.paths = {wire.paths:.6g} is more than wire.springs = {wire.springs:.6g}: {cure}")


def channel_unit(channel: str, *, difference: bool = False) -> str:
    """The internal unit of a channel's values, or of differences of them."""
    unit = CHANNELS[channel_of(channel) or channel].unit
    return "K" if difference and unit == "degC" else unit
