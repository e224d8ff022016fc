"""An actuator's rig.toml: ``kind`` under ``[rig]``, and a section for each part with its declared parameters.

schema = 1

[rig]
kind = "flexural"

[wire]
diameter = "0.3 mm"
"""

import math
import tomllib
from collections.abc import Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, NamedTuple

from pydantic import BaseModel, Field

from smajax import parameters
from smajax.errors import InputError
from smajax.files.renamed_keys import current_line_numbers, with_current_keys
from smajax.files.rig_checks import check_coil, check_order, check_whole
from smajax.files.rig_classes import rig_classes
from smajax.files.toml import STRICT, advice, check_schema, parse_toml, read_text, render_toml, validate, write_text
from smajax.files.validators import one_of, section_model
from smajax.parameters.definitions import Declaration, declarations, tie_declarations
from smajax.recordings.datasets import data_path
from smajax.units import as_text, example_of

if TYPE_CHECKING:
    from smajax.actuators.base import AbstractActuator


class _Head(BaseModel):
    """``[rig]``."""

    model_config = STRICT
    kind: Annotated[str, one_of(lambda: rig_classes().actuators)] = Field(examples=['"flexural"'])


def is_actuator(text: str) -> bool:
    """Return whether the ``kind`` in a TOML text is that of an actuator, not of a rig."""
    try:
        head = tomllib.loads(text).get("rig")
    except tomllib.TOMLDecodeError:
        return False
    kind, classes = head.get("kind") if isinstance(head, dict) else None, rig_classes()
    return isinstance(kind, str) and kind not in classes.mechanisms and kind in classes.actuators


def kind_of(actuator: "AbstractActuator") -> str:
    """Return the value of ``kind`` under ``[rig]`` for an actuator."""
    return next(kind for kind, actuator_class in rig_classes().actuators.items() if actuator_class is type(actuator))


def read_actuator(path: str | Path) -> "AbstractActuator":
    """Read and check an actuator file.

    Raises:
        InputError: If the file is missing or invalid; the message names file, section and key.
    """
    return parse_actuator(read_text(Path(path), "actuator"), str(path))


def parse_actuator(text: str, name: str = "actuator.toml") -> "AbstractActuator":
    """Parse and check the text of an actuator file.

    Args:
        text: The text.
        name: Name of the file in messages.

    Raises:
        InputError: If the text is invalid; the message names file, section and key.
    """
    data = parse_toml(text, name)
    try:
        return _build(with_current_keys(data), Path(name).name, current_line_numbers(text))
    except InputError as error:
        raise InputError(f"{name}: {error}") from None


def to_toml(actuator: "AbstractActuator", values: Mapping[str, Any] | None = None) -> str:
    """Return the text of a file with every parameter; reading it gives the same actuator.

    Args:
        actuator: The actuator.
        values: Values by parameter name in internal units, which replace those of the actuator.

    Raises:
        InputError: If a name is unknown, or the values fail the checks of ``parse_actuator``.
    """
    for name in values or {}:
        parameters.declaration(actuator, name)
    actuator = parameters.replace(actuator, values or {})
    data: dict[str, Any] = {"schema": 1, "rig": {"kind": kind_of(actuator)}}
    for section, part in parameters.sections(actuator).items():
        units = {key: d.unit for key, d in declarations(part).items() if getattr(part, key) is not None}
        data[section] = {key: as_text(float(getattr(part, key)), unit) for key, unit in units.items()}
    text = render_toml(data)
    parse_actuator(text, "the actuator with new values")
    return text


def write(path: str | Path, actuator: "AbstractActuator", values: Mapping[str, Any] | None = None) -> None:
    """Write the text of ``to_toml`` to a file, completely or not at all.

    Args:
        path: The file.
        actuator: The actuator.
        values: Values by parameter name in internal units, which replace those of the actuator.

    Raises:
        InputError: If the values fail the checks of ``parse_actuator``, or the file cannot be written.
    """
    write_text(Path(path), to_toml(actuator, values))


class _Values(NamedTuple):
    """Values in an actuator file, checked by their declarations.

    Attributes:
        actuator: Class of the actuator.
        parts: Classes of its parts by section.
        values: Values by section and key.
        place: Place of each parameter in the file, for messages.
    """

    actuator: type[Any]
    parts: Mapping[str, type[Any]]
    values: Mapping[str, Mapping[str, Any]]
    place: Mapping[str, str]


def check_actuator_values(text: str, name: str) -> dict[str, Declaration]:
    """Check the text of an actuator file as far as its classes are not needed.

    Args:
        text: The text.
        name: Name of the file in messages.

    Returns:
        Declarations of the parameters by name.

    Raises:
        InputError: As ``parse_actuator``.
    """
    data = parse_toml(text, name)
    try:
        read = _read_values(with_current_keys(data), Path(name).name, current_line_numbers(text))
    except InputError as error:
        raise InputError(f"{name}: {error}") from None
    table = {f"{section}.{key}": d for section, part in read.parts.items() for key, d in declarations(part).items()}
    return table | tie_declarations(table)


def _build(data: Mapping[str, Any], name: str, rows: Mapping[str, int]) -> "AbstractActuator":
    read = _read_values(data, name, rows)
    parts = {
        s: part(**{k: parameters.as_float(v) for k, v in read.values[s].items()}) for s, part in read.parts.items()
    }
    actuator = read.actuator(**parts)
    _check(actuator, read.place)
    return actuator


def _read_values(data: Mapping[str, Any], name: str, rows: Mapping[str, int]) -> _Values:
    check_schema(data)
    if "rig" not in data:
        raise InputError('the section [rig] is missing: add [rig] with a line kind = "flexural"')
    kind = validate(_Head, data["rig"], "rig").kind
    actuator_class = rig_classes().actuators[kind]
    part_classes = actuator_class.rig_sections()
    for section, content in data.items():
        if section not in part_classes and section not in ("schema", "rig"):
            is_section = isinstance(content, dict | list)
            problem = f"[{section}] is not a section of this actuator" if is_section else f"{section} is not known"
            raise InputError(f"{problem}{advice(section, ['rig', *part_classes], 'the sections are')}")
    tables = {section: declarations(part) for section, part in part_classes.items()}
    units = {f"{section}.{key}": d.unit for section, table in tables.items() for key, d in table.items()}
    place = {n: f"{name} line {rows[n]}" if n in rows else name for n in units}
    values = {s: _part_values(kind, s, table, data.get(s, {})) for s, table in tables.items()}
    # Parts check the order as well, without the place of a value.
    check_order({f"{s}.{k}": v for s, keys in values.items() for k, v in keys.items()}.get, units.__getitem__, place)
    return _Values(actuator_class, part_classes, values, place)


def _check(actuator: "AbstractActuator", place: Mapping[str, str]) -> None:
    """Check what holds for every rig (counts, coils), then what this actuator requires.

    ``place`` is the place of each parameter in the file, for messages.
    """
    table = parameters.all_declarations(actuator)

    def value(name: str) -> float | None:
        number = float(parameters.get(actuator, name)) if name in table else math.nan
        return None if math.isnan(number) else number

    from smajax.plant.coil import Coil  # a file is checked first without JAX

    check_whole(table, value, place)
    for part in parameters.sections(actuator).values():
        if isinstance(part, Coil):
            check_coil(part)
    actuator.check()


def _part_values(kind: str, section: str, table: Mapping[str, Declaration], content: Any) -> dict[str, Any]:
    values = validate(section_model(section, table), content, section).model_dump(exclude_unset=True)
    for key, declaration in table.items():
        if key not in values and declaration.default is None:
            path = data_path("actuators", kind, "rig.toml")
            template = parse_toml(path.read_text("utf-8"), str(path))
            example = template.get(section, {}).get(key, example_of(declaration.unit))
            cure = f'an actuator of kind {kind} needs a line like {key} = "{example}" under [{section}]'
            raise InputError(f"{section}.{key} is missing: {cure}")
    return values
