"""Parameter sets: files of named values with bounds and sources, shipped or written by a fit.

    schema = "smajax.parameters/1"
    title = "..."

    [material.martensite_start]
    value = "48.4 degC"
    bounds = ["30 degC", "70 degC"]
    source = "..."

A fit adds ``interval95``, ``free`` and ``at_bound``, a table ``[fit]`` with the origin of the values, and parameters
that belong to one recording under ``[per_recording."NAME@RECORDING"]``. Writing and reading returns the same floats.
``[limits]`` and ``[catalogue]`` are read by ``material_limits``.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from pydantic import BaseModel, Field

from smajax import parameters
from smajax.errors import InputError, suggestion
from smajax.files.parameter_names import all_parameter_names, declarations_of
from smajax.files.renamed_keys import current_name
from smajax.files.rig_classes import rig_classes
from smajax.files.toml import STRICT, parse_toml, read_text, render_toml, show, validate, write_text
from smajax.files.validators import quantity
from smajax.parameters import declarations
from smajax.recordings.datasets import data_path
from smajax.units import as_text, parse_quantity

if TYPE_CHECKING:
    from smajax.plant.materials.base import AbstractMaterial

SCHEMA = "smajax.parameters/1"
# Tables that are no section of parameters.
_HEADER_TABLES = ("fit", "limits", "catalogue")
# Text of an infinite end of bounds or of an interval.
_OPEN = "none"


@dataclass(frozen=True)
class Entry:
    """One parameter of a parameter set.

    Attributes:
        value: Value in ``unit``.
        unit: Internal unit of the parameter.
        lower: Lower bound in ``unit``; minus infinity if there is none.
        upper: Upper bound in ``unit``; infinity if there is none.
        source: Where the value comes from.
        interval95: Ends of the 95 % confidence interval in ``unit``.
        free: Whether the parameter was free in a fit; ``None`` if the file does not say.
        at_bound: Whether the estimate is at a bound; ``None`` if the file does not say.
    """

    value: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    source: str = ""
    interval95: tuple[float, float] | None = None
    free: bool | None = None
    at_bound: bool | None = None


class EntryTable(BaseModel):
    """``[SECTION.KEY]``, a parameter."""

    model_config = STRICT
    value: Any = Field(description="value of the parameter", examples=['"..."'])
    bounds: list[Any] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="lower and upper bound in a fit",
        examples=['["30 degC", "70 degC"]'],
    )
    source: str = Field("", description="where the value comes from", examples=['"data sheet"'])
    interval95: list[Any] | None = Field(
        None,
        min_length=2,
        max_length=2,
        description="95 % interval of an estimate, as a fit writes it",
        examples=['["47.9 degC", "48.9 degC"]'],
    )
    free: bool | None = Field(None, description="whether a fit has estimated it", examples=["true"])
    at_bound: bool | None = Field(None, description="whether the estimate is at its bound", examples=["false"])


def read_parameters(path: str | Path) -> dict[str, Entry]:
    """Read a parameter set.

    Returns:
        Entries by parameter name; those of one recording by ``NAME@RECORDING``.

    Raises:
        InputError: If the file is missing or invalid; the message names file and key.
    """
    return _read(Path(path))[1]


def shipped_sets() -> list[str]:
    """Return the names of the parameter sets that are shipped."""
    return sorted(path.stem for path in data_path("parameters").glob("*.toml"))


def find_set(name: str, folder: Path | None = None, place: str = "parameter set ") -> Path:
    """Return the path of a parameter set.

    Args:
        name: Name of a shipped set, or the path of a file that ends in ``.toml``.
        folder: Folder to which a path is relative; the current one by default.
        place: Text before the name in messages.

    Raises:
        InputError: If no shipped set has the name.
    """
    shipped = shipped_sets()
    if name in shipped:
        return data_path("parameters", f"{name}.toml")
    if name.endswith(".toml") or "/" in name:
        return (folder or Path()) / name
    choices = f"the shipped ones are {', '.join(shipped)}, and a file of your own ends in .toml"
    choices += " (smajax explain parameter-sets)"
    raise InputError(f"{place}'{name}' is not known{suggestion(name, shipped)}: {choices}")


def load_material(name: str | Path, model: str = "brinson", **values: float) -> "AbstractMaterial":
    """Return a material law with the values of a parameter set.

    Args:
        name: Name of a shipped set such as ``rotary-table1``, or the path of a file that ends in ``.toml``.
        model: The law, as in rig files.
        values: Parameters of the law in internal units (SI, degC); they have precedence over those of the set.

    Raises:
        InputError: If the set or the law is unknown, or a parameter of the law has no value.
    """
    materials = rig_classes().materials
    if model not in materials:
        raise InputError(f"there is no material '{model}'{suggestion(model, materials)}: choose {', '.join(materials)}")
    entries, law = parameters.by_leaf(read_parameters(find_set(str(name)))), materials[model]
    declared = declarations(law)
    for key in values.keys() - declared.keys():
        raise InputError(f"{model} has no parameter '{key}'{suggestion(key, declared)}: correct or remove it")
    of_set = {key: entries[n].value for key in declared if (n := f"material.{key}") in entries}
    arguments: dict[str, Any] = {**of_set, **values}
    missing = [key for key, declaration in declared.items() if declaration.default is None and key not in arguments]
    if missing:
        problem = f"parameter set {name} has no {', '.join(missing)}"
        raise InputError(f"{problem}, which {model} needs: give the missing values as arguments")
    return law(**arguments)


def read_header(path: str | Path) -> dict[str, Any]:
    """Read the header of a parameter set: ``title``, ``source``, after a fit ``fit``, and ``limits`` and ``catalogue``.

    Raises:
        InputError: If the file is missing or invalid; the message names file and key.
    """
    return _read(Path(path))[0]


def write_parameters(path: str | Path, entries: Mapping[str, Entry], header: Mapping[str, Any]) -> None:
    """Write a parameter set, completely or not at all.

    Args:
        path: The file.
        entries: Entries by parameter name; those of one recording by ``NAME@RECORDING``.
        header: Values at the top of the file: ``title``, ``source``, and a table ``fit``.

    Raises:
        InputError: If a value is not finite, or the file cannot be written.
    """
    try:
        text = parameters_text(entries, header)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    write_text(Path(path), text)


def parameters_text(entries: Mapping[str, Entry], header: Mapping[str, Any]) -> str:
    """Return the text of a parameter set; the arguments are those of ``write_parameters``.

    Raises:
        InputError: If a value is not finite.
    """
    tables: dict[str, Any] = {"schema": SCHEMA, **header}
    for name, entry in entries.items():
        if not math.isfinite(entry.value):
            raise InputError(f"{name} is {entry.value} and cannot be written: give it a finite value")
        section, key = ("per_recording", name) if "@" in name else name.split(".", 1)
        tables.setdefault(section, {})[key] = _table(entry)
    return render_toml(tables)


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Entry]]:
    data = parse_toml(read_text(path, "parameter set"), str(path))
    try:
        if data.pop("schema", None) != SCHEMA:
            raise InputError(f'this is not a parameter file: one begins with the line schema = "{SCHEMA}"')
        header = {key: value for key, value in data.items() if key in _HEADER_TABLES or not isinstance(value, dict)}
        entries = {}
        for section, keys in data.items():
            for key, table in (keys if section not in header else {}).items():
                name = current_name(key if section == "per_recording" else f"{section}.{key}")
                if name in entries:
                    raise InputError(f"{name} is also given under its old name: remove one of the two")
                entries[name] = _entry(name, section, table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return header, entries


def _entry(name: str, section: str, table: Any) -> Entry:
    parameter, at, _ = name.partition("@")
    candidates = declarations_of(parameter)
    if not candidates or bool(at) != (section == "per_recording"):
        hint = suggestion(parameter, all_parameter_names()) if not candidates else ""
        rename = 'name it "SECTION.KEY@RECORDING"'
        cure = rename if section == "per_recording" else "correct the name, or remove the table"
        raise InputError(f"there is no parameter '{name}'{hint}: {cure}")
    if not isinstance(table, dict):
        raise InputError(f'{name} = {show(table)} is not a table: write it as [{name}] with a line value = "..."')
    fields = validate(EntryTable, table, f'per_recording."{name}"' if at else name)
    errors = []
    # The unit of a name with two declarations, such as heat.h2, selects the law.
    for declaration in candidates:
        try:
            value = quantity(fields.value, declaration)
            lower, upper = _read_span(fields.bounds, declaration.unit)
            interval = _read_span(fields.interval95, declaration.unit) if fields.interval95 else None
        except InputError as error:
            errors.append(error)
            continue
        if not lower <= value <= upper or not lower < upper:
            problem = f"{name}.bounds = {show(fields.bounds)} do not contain the value {show(fields.value)}"
            raise InputError(f"{problem}: correct one of them")
        if interval and not interval[0] <= interval[1]:
            problem = f"{name}.interval95 = {show(fields.interval95)} is in the wrong order"
            raise InputError(f"{problem}: put the smaller end first")
        return Entry(value, declaration.unit, lower, upper, fields.source, interval, fields.free, fields.at_bound)
    raise InputError(f"{name}: {errors[0]}")


def _read_span(ends: list[Any] | None, unit: str) -> tuple[float, float]:
    """Return two quantities in the internal unit; ``"none"`` is an infinite end."""
    low, high = ends or (_OPEN, _OPEN)
    lower = -math.inf if low == _OPEN else parse_quantity(low, unit)
    upper = math.inf if high == _OPEN else parse_quantity(high, unit)
    return lower, upper


def _table(entry: Entry) -> dict[str, Any]:
    def span(low: float, high: float) -> list[str]:
        return [as_text(end, entry.unit) if math.isfinite(end) else _OPEN for end in (low, high)]

    bounded = math.isfinite(entry.lower) or math.isfinite(entry.upper)
    return {
        "value": as_text(entry.value, entry.unit),
        "bounds": span(entry.lower, entry.upper) if bounded else None,
        "interval95": span(*entry.interval95) if entry.interval95 else None,
        "free": entry.free,
        "at_bound": entry.at_bound,
        "source": entry.source or None,
    }
