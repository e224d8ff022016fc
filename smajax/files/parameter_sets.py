"""Parameter files: named values with bounds and sources, shipped or written by a fit, which a rig file names.

    schema = "smajax.parameters/1"
    title = "..."

    [material.martensite_start]
    value = "48.4 degC"
    bounds = ["30 degC", "70 degC"]
    source = "..."

A fit adds ``interval95``, ``free`` and ``at_bound``, a table ``[fit]`` with the origin of the values, and parameters
that belong to one recording under ``[per_recording."NAME@RECORDING"]``. What is written reads back to the same floats.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from smajax.errors import InputError, suggestion
from smajax.files.parameter_names import all_parameter_names, declarations_of
from smajax.files.renamed_keys import current_name
from smajax.files.toml import STRICT, parse_toml, read_text, render_toml, show, validate, write_text
from smajax.files.validators import quantity
from smajax.units import as_text, parse_quantity

SCHEMA = "smajax.parameters/1"
# An end of bounds or of an interval that is at infinity.
_OPEN = "none"


@dataclass(frozen=True)
class Entry:
    """One parameter of a file.

    Attributes:
        value: In the internal unit.
        unit: Internal unit.
        lower: Lower bound; minus infinity where open.
        upper: Upper bound; infinity where open.
        source: Where the value comes from.
        interval95: Its 95 % interval.
        free: Whether a fit changed it.
        at_bound: Whether the fit ended at a bound.
    """

    value: float
    unit: str
    lower: float = -math.inf
    upper: float = math.inf
    source: str = ""
    interval95: tuple[float, float] | None = None
    free: bool | None = None
    at_bound: bool | None = None


class _EntryTable(BaseModel):
    model_config = STRICT
    value: Any = Field(examples=['"..."'])
    bounds: list[Any] | None = Field(None, min_length=2, max_length=2, examples=['["30 degC", "70 degC"]'])
    source: str = Field("", examples=['"data sheet"'])
    interval95: list[Any] | None = Field(None, min_length=2, max_length=2, examples=['["47.9 degC", "48.9 degC"]'])
    free: bool | None = Field(None, examples=["true"])
    at_bound: bool | None = Field(None, examples=["false"])


def read_parameters(path: str | Path) -> dict[str, Entry]:
    """Return the entries of a parameter file by name, those of one recording by ``NAME@RECORDING``.

    Raises:
        InputError: with file, key and cure.
    """
    return _read(Path(path))[1]


def read_header(path: str | Path) -> dict[str, Any]:
    """Return what else is in a parameter file: ``title``, ``source``, and after a fit the table ``fit``."""
    return _read(Path(path))[0]


def write_parameters(path: str | Path, entries: Mapping[str, Entry], header: Mapping[str, Any]) -> None:
    """Write a parameter file, completely or not at all.

    Args:
        path: The file.
        entries: Entries by name, those of one recording by ``NAME@RECORDING``.
        header: What is written at its top: ``title``, ``source``, a table ``fit``.
    """
    tables: dict[str, Any] = {"schema": SCHEMA, **header}
    for name, entry in entries.items():
        if not math.isfinite(entry.value):
            raise InputError(f"{path}: {name} is {entry.value} and cannot be written: give it a finite value")
        section, key = ("per_recording", name) if "@" in name else name.split(".", 1)
        tables.setdefault(section, {})[key] = _table(entry)
    write_text(Path(path), render_toml(tables))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Entry]]:
    data = parse_toml(read_text(path, "parameter set"), str(path))
    try:
        if data.pop("schema", None) != SCHEMA:
            raise InputError(f'this is not a parameter file: one begins with the line schema = "{SCHEMA}"')
        header = {key: value for key, value in data.items() if key == "fit" or not isinstance(value, dict)}
        entries = {}
        for section, keys in data.items():
            for key, table in (keys if section not in header else {}).items():
                name = current_name(key if section == "per_recording" else f"{section}.{key}")
                if name in entries:
                    raise InputError(f"{name} is given under its old name, too: take one of the two out")
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
        cure = rename if section == "per_recording" else "correct the name, or take the table out"
        raise InputError(f"there is no parameter '{name}'{hint}: {cure}")
    if not isinstance(table, dict):
        raise InputError(f'{name} = {show(table)} is not a table: write it as [{name}] with a line value = "..."')
    checked = validate(_EntryTable, table, f'per_recording."{name}"' if at else name)
    errors = []
    # A name with two units, such as heat.h2, is of the law whose unit fits.
    for declaration in candidates:
        try:
            value = quantity(checked.value, declaration)
            lower, upper = _read_span(checked.bounds, declaration.unit)
            interval = _read_span(checked.interval95, declaration.unit) if checked.interval95 else None
        except InputError as error:
            errors.append(error)
            continue
        if not lower <= value <= upper or not lower < upper:
            outside = f"{name}.bounds = {show(checked.bounds)} do not hold the value {show(checked.value)}"
            raise InputError(f"{outside}: correct one of them")
        if interval and not interval[0] <= interval[1]:
            backwards = f"{name}.interval95 = {show(checked.interval95)} runs backwards"
            raise InputError(f"{backwards}: put the smaller end first")
        return Entry(value, declaration.unit, lower, upper, checked.source, interval, checked.free, checked.at_bound)
    raise InputError(f"{name}: {errors[0]}")


def _read_span(ends: list[Any] | None, unit: str) -> tuple[float, float]:
    """Return two quantities in the internal unit; ``"none"`` is an open end."""
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
