"""A machine's rig.toml: ``kind`` under ``[rig]``, and one section for each part of the machine, its keys the declared parameters.

schema = 1

[rig]
kind = "flexural"

[wire]
diameter = "0.3 mm"
"""

import dataclasses
import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import Annotated, Any

import equinox as eqx
from pydantic import BaseModel, Field

from smajax import parameters
from smajax.datasets import shipped
from smajax.errors import InputError
from smajax.machines.flexural import FlexuralActuator
from smajax.machines.knee import Knee
from smajax.machines.machine import AbstractMachine
from smajax.machines.soft_bending import SoftBending
from smajax.parameters import as_float, declarations
from smajax.plant.wire import Coil
from smajax.rig_schema import as_text, check_coil, check_order, check_whole, one_of, section_model
from smajax.toml_file import STRICT, advice, check_schema, lines, parse, read_text, render, validate, write_text
from smajax.units import example_of

MACHINES: Mapping[str, type[AbstractMachine]] = {"flexural": FlexuralActuator, "soft-bending": SoftBending, "knee": Knee}


class _Head(BaseModel):
    """``[rig]``."""

    model_config = STRICT
    kind: Annotated[str, one_of(MACHINES)] = Field(examples=['"flexural"'])


def is_machine(text: str) -> bool:
    """Whether a TOML text is a machine's, by its kind, and not a rig's."""
    try:
        head = tomllib.loads(text).get("rig")
    except tomllib.TOMLDecodeError:
        return False
    return isinstance(head, dict) and head.get("kind") in MACHINES


def kind_of(machine: AbstractMachine) -> str:
    """The kind by which files name a machine."""
    return next(kind for kind, made in MACHINES.items() if made is type(machine))


def read(path: str | Path) -> AbstractMachine:
    """Read and check a machine's file. InputError: one sentence with file, section and key, and the cure."""
    return parse_machine(read_text(Path(path), "machine"), str(path))


def parse_machine(text: str, name: str = "machine.toml") -> AbstractMachine:
    """The machine in a TOML text; ``name`` is the file's in sentences."""
    data = parse(text, name)
    try:
        return _machine(data, Path(name).name, lines(text))
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def to_toml(machine: AbstractMachine, values: Mapping[str, Any] | None = None) -> str:
    """The machine as a file that holds every parameter, those in ``values`` (internal units) in place of its own; read back it is the same.

    InputError if the values make no machine.
    """
    machine = parameters.replace(
        machine, {name: values[name] for name in values if parameters.declaration(machine, name)} if values else {}
    )
    data: dict[str, Any] = {"schema": 1, "rig": {"kind": kind_of(machine)}}
    for section, part in parameters.sections(machine).items():
        given = {key: d.unit for key, d in declarations(part).items() if getattr(part, key) is not None}
        data[section] = {key: as_text(float(getattr(part, key)), unit) for key, unit in given.items()}
    text = render(data)
    parse_machine(text, "the machine with new values")
    return text


def write(path: str | Path, machine: AbstractMachine, values: Mapping[str, Any] | None = None) -> None:
    """Write ``to_toml`` to a file, completely or not at all."""
    write_text(Path(path), to_toml(machine, values))


def _machine(data: Mapping[str, Any], name: str, rows: Mapping[str, int]) -> AbstractMachine:
    check_schema(data)
    if "rig" not in data:
        raise InputError('the section [rig] is missing: add [rig] with a line kind = "flexural"')
    kind = validate(_Head, data["rig"], "rig").kind
    made = MACHINES[kind]
    parts = {f.name: f.type for f in dataclasses.fields(made) if isinstance(f.type, type) and issubclass(f.type, eqx.Module)}
    for section, content in data.items():
        if section not in parts and section not in ("schema", "rig"):
            what = f"[{section}] is not a section of this machine" if isinstance(content, dict | list) else f"{section} is not known"
            raise InputError(f"{what}{advice(section, ['rig', *parts], 'the sections are')}")
    built: dict[str, Any] = {section: _part(kind, section, part, data.get(section, {})) for section, part in parts.items()}
    machine = made(**built)
    _check(machine, {n: f"{name} line {rows[n]}" if n in rows else name for n in parameters.declared(machine)})
    return machine


def _check(machine: AbstractMachine, place: Mapping[str, str]) -> None:
    """Refuses what no machine, rig or coil can be, then what this machine cannot be; ``place`` says where each parameter stands."""
    table = parameters.declared(machine)

    def value(name: str) -> float | None:
        found = float(parameters.get(machine, name)) if name in table else math.nan
        return None if math.isnan(found) else found

    check_whole(table, value, place)
    check_order(value, lambda n: table[n].unit, place)
    for part in parameters.sections(machine).values():
        if isinstance(part, Coil):
            check_coil(part)
    machine.check()


def _part(kind: str, section: str, part: type[eqx.Module], content: Any) -> eqx.Module:
    table = declarations(part)
    given = validate(section_model(section, table), content, section).model_dump(exclude_unset=True)
    for key, declaration in table.items():
        if key not in given and declaration.default is None:
            template = shipped("machines", kind, "rig.toml")
            value = parse(template.read_text("utf-8"), str(template)).get(section, {}).get(key, example_of(declaration.unit))
            raise InputError(f'{section}.{key} is missing: a machine of kind {kind} needs a line like {key} = "{value}" under [{section}]')
    return part(**{key: as_float(value) for key, value in given.items()})
