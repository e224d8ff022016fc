"""Checks of a rig file: its sections and keys against those of its kind, and values that are not possible."""

from collections.abc import Callable, Iterable, Mapping
from typing import TYPE_CHECKING, Any

from smajax.errors import InputError
from smajax.files.parameter_names import owners
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import Stages, rig_phrase
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE, FitSection, RigSection
from smajax.files.rig_structure import STRUCTURE_KEYS
from smajax.files.toml import advice, parse_toml
from smajax.parameters import checks, declarations
from smajax.parameters.definitions import Declaration
from smajax.recordings.datasets import data_path
from smajax.units import as_text, example_of

if TYPE_CHECKING:
    from smajax.plant.wire import AbstractWire

OTHER_SECTIONS = ("rig", "effects", "sensor", "channels", "recording", "fit")
# What selects the sections of a wire of several cells or grains.
_STRUCTURE_CURES = {
    "cells": ", or set a number of cells, as in cells = 9 under [wire]",
    "grains": ", or set a number of grains, as in grains = 6 under [material]",
}
# Excess of the sum of phase fractions over 1 that counts as rounding of decimals in the file.
_FRACTION_ROUNDING = 1e-12


def check_sections(data: Mapping[str, Any]) -> None:
    """Refuse top-level keys that are not sections of a rig file.

    Args:
        data: Sections of the file.

    Raises:
        InputError: For the first such key, with its section if it is a known key of one.
    """
    if data.keys() <= {"schema", *OTHER_SECTIONS, *(section for section, _, _ in owners(installed=False))}:
        return
    sections = [*dict.fromkeys(["rig", *(section for section, _, _ in owners()), *OTHER_SECTIONS])]
    homes = {key: section for section, part, _ in reversed(list(owners())) for key in declarations(part)}
    homes |= {key: "fit" for key in FitSection.model_fields} | {key: "rig" for key in RigSection.model_fields}
    for section, value in data.items():
        if section in sections or section == "schema":
            continue
        if section in homes and not isinstance(value, dict):
            raise InputError(f"{section} is outside of its section: write it below a line [{homes[section]}]")
        is_section = isinstance(value, dict | list)
        problem = f"[{section}] is not a section of a rig" if is_section else f"{section} is not known"
        raise InputError(f"{problem}{advice(section, sections, 'the sections are')}")


def check_belongs(data: Mapping[str, Any], stages: Stages, control: str | None) -> None:
    """Refuse sections and keys that this rig does not have.

    Args:
        data: Sections of the rig file.
        stages: Classes of the stages of this rig.
        control: Electrical input.

    Raises:
        InputError: For a section or key of another kind, control or law, and for an unknown key with the most similar
            one.
    """
    if stages.kind == "path" and control is not None:
        cure = "remove it, since the recording has the temperature"
        raise InputError(f"rig.control does not apply to a path rig: {cure}")
    for section, content in data.items():
        if section == "schema" or section in OTHER_SECTIONS:
            continue
        if section in stages.parts and (not isinstance(content, dict) or content.keys() <= stages.keys(section).keys()):
            continue
        choices = {words: part for other, part, words in owners() if other == section}
        if section not in stages.parts:
            if section in ("heat", "drive") and control == PRESCRIBED_TEMPERATURE:
                cure = "remove it, since the recording has the temperature, or name the electrical input"
                raise InputError(f'[{section}] does not apply with control = "{control}": {cure}')
            kinds = [
                f'kind = "{kind}"'
                for kind, mechanism in rig_classes().mechanisms.items()
                if section in mechanism.rig_sections()
            ]
            cure = f", or set {' or '.join(kinds)} under [rig]" if kinds else _STRUCTURE_CURES.get(section, "")
            raise InputError(f"[{section}] does not apply to {rig_phrase(stages.kind)}: remove it{cure}")
        key = next(key for key in content if key not in stages.keys(section))
        raise InputError(_misplaced_key(section, key, stages, choices))


def _misplaced_key(section: str, key: str, stages: Stages, choices: Mapping[str, type[Any]]) -> str:
    """Return the sentence about a key that a section of this rig does not have."""
    if f"{section}.{key}" in stages.inert:
        cure = "remove it, since it follows from the recording"
        return f"{section}.{key} does not apply to {rig_phrase(stages.kind)}: {cure}"
    others = [words for words, part in choices.items() if key in declarations(part)]
    if others:
        choice = next(words for words, part in choices.items() if part is stages.parts[section])
        cure = f"choose {' or '.join(others)}, or remove it"
        return f"{section}.{key} does not apply with {choice}: {cure}"
    homes = [home for home, part, _ in owners() if home in stages.parts and key in declarations(part)]
    if homes:
        return f"{section}.{key} is not known (did you mean '{homes[0]}.{key}'?): write it under [{homes[0]}]"
    keys = [*stages.keys(section), *STRUCTURE_KEYS.get(section, ())]
    return f"{section}.{key} is not known{advice(key, keys, f'the keys of [{section}] are')}"


def require_values(names: Iterable[str], values: Mapping[str, Any], stages: Stages) -> None:
    """Refuse a rig in which a parameter without a default has no value.

    Args:
        names: Names of the parameters without a default.
        values: Values by leaf.
        stages: Classes of the stages of this rig.

    Raises:
        InputError: For the first missing value, with a line to add.
    """
    for name in names:
        if name not in values:
            section, key = name.split(".", 1)
            line = f"{key} = {_example(stages, name)}"
            or_set = ', or name a parameter set under [rig], as in parameters = "NAME"' if section == "material" else ""
            cure = f"{rig_phrase(stages.kind)} needs a line like {line} under [{section}]{or_set}"
            raise InputError(f"{name} is missing: {cure}")


def _example(stages: Stages, name: str) -> str:
    """Return the value of a parameter in the shipped template of this kind, else some quantity in its unit."""
    section, key = name.split(".", 1)
    path = data_path("templates", f"{stages.kind}.toml")
    template = parse_toml(path.read_text("utf-8"), path.name) if path.is_file() else {}
    value = template.get(section, {}).get(key) or example_of(stages.table()[name].unit)
    return f'"{value}"' if isinstance(value, str) else str(value)


def check_order(
    value_of: Callable[[str], float | None], unit_of: Callable[[str], str], origin: Mapping[str, str]
) -> None:
    """Check that transformations end above their start, and that the phase fractions add up to at most 1.

    Args:
        value_of: Returns the value of a parameter in its internal unit, or ``None`` if it has none.
        unit_of: Returns the internal unit of a parameter.
        origin: Where the value of each parameter comes from, for messages.

    Raises:
        InputError: If they do not.
    """
    checks.check_order(value_of, lambda n, value: f"{n} = {as_text(value, unit_of(n))} ({origin[n]})")
    detwinned, twinned = value_of("initial.detwinned"), value_of("initial.twinned")
    if detwinned is not None and twinned is not None and detwinned + twinned > 1.0 + _FRACTION_ROUNDING:
        total = f"initial.detwinned and initial.twinned add up to {detwinned + twinned:.6g}"
        raise InputError(f"{total}: keep their sum at 1 or below")


def check_whole(
    table: Mapping[str, Declaration], value_of: Callable[[str], float | None], origin: Mapping[str, str]
) -> None:
    """Check that parameters which are counts have whole values.

    Args:
        table: Declarations of the parameters to check.
        value_of: Returns the value of a parameter, or ``None`` if it has none.
        origin: Where the value of each parameter comes from, for messages.

    Raises:
        InputError: If one has not.
    """
    for name, declaration in table.items():
        value = value_of(name) if declaration.whole else None
        if value is not None and value != round(value):
            problem = f"{name} = {value:.6g} ({origin[name]}) is not a whole number, but is the {declaration.meaning}"
            raise InputError(f"{problem}: give a whole number")


def check_coil(wire: "AbstractWire") -> None:
    """Check the geometry of a coil, its stretch and the wiring of a bundle; a straight wire passes.

    Raises:
        InputError: If the turns do not fit into the free length, the coil is stretched too far, or a bundle has more
            current paths than springs.
    """
    from smajax.plant.coil import Coil  # the other checks are made before JAX is loaded
    from smajax.plant.wire import Wire

    if not isinstance(wire, Coil):
        return
    if wire.free_length is not None and not wire.fits:
        length, diameter = as_text(float(wire.free_length), "m"), as_text(float(wire.diameter), "m")
        turns = f"{wire.turns:.6g} turns of a wire of {diameter} take {1e3 * wire.solid_length:.6g} mm side by side"
        sizes = "wire.turns, wire.diameter or wire.free_length"
        cure = f"correct {sizes} (a radius taken for a diameter makes twice as much)"
        raise InputError(f"wire.free_length = {length} is too short: {turns}: {cure}")
    max_prestrain = declarations(Wire)["prestrain"].upper
    if wire.prestrain > max_prestrain:
        stretch = f"wire.prestretch = {as_text(float(wire.prestretch), 'm')} is too large"
        strain = f"the equivalent tensile strain of the wire is {100 * wire.prestrain:.3g} %"
        limit = f"at most {100 * max_prestrain:g} % is possible"
        raise InputError(f"{stretch}: {strain}, and {limit}: reduce it, or correct the dimensions of the coil")
    if wire.paths > wire.springs:
        problem = f"wire.paths = {wire.paths:.6g} is more than wire.springs = {wire.springs:.6g}"
        cure = "a bundle has at most as many parallel current paths as springs, and 1 if all are in series"
        raise InputError(f"{problem}: {cure}")
