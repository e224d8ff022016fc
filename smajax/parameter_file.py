"""Parameter files: named values with bounds and sources, shipped or written by a fit, which a rig takes up with ``set``.

    schema = "smajax.parameters/1"
    title = "..."

    [material.martensite_start]
    value = "48.4 degC"
    bounds = ["30 degC", "70 degC"]
    source = "..."

A fit adds ``interval95``, ``free`` and ``at_bound``, a table ``[fit]`` that says where the values come from, and parameters that belong to
one recording under ``[per_recording."NAME@RECORDING"]``. What is written reads back to the same floats.
"""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from pydantic import BaseModel, Field

from smajax.errors import InputError, nearest
from smajax.rig_schema import as_text, declarations_of, names_of_all, quantity
from smajax.toml_file import STRICT, parse, read_text, render, show, validate, write_text
from smajax.units import parse as parse_quantity

SCHEMA = "smajax.parameters/1"
_OPEN = "none"


@dataclass(frozen=True)
class Entry:
    """One parameter of a file: ``value``, ``lower``, ``upper`` and ``interval95`` in the internal ``unit``; an end at infinity is open."""

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
    """The entries of a parameter file by name, per-recording ones by ``NAME@RECORDING``. InputError with file, key and cure."""
    return _read(Path(path))[1]


def read_header(path: str | Path) -> dict[str, Any]:
    """What else stands in a parameter file: ``title``, ``source``, and after a fit the table ``fit``."""
    return _read(Path(path))[0]


def write_parameters(path: str | Path, entries: Mapping[str, Entry], header: Mapping[str, Any]) -> None:
    """Write a parameter file, completely or not at all. ``header`` goes to its top: ``title``, ``source``, a mapping ``fit``."""
    tables: dict[str, Any] = {"schema": SCHEMA, **header}
    for name, entry in entries.items():
        if not math.isfinite(entry.value):
            raise InputError(f"{path}: {name} is {entry.value} and cannot be written: give it a finite value")
        section, key = ("per_recording", name) if "@" in name else name.split(".", 1)
        tables.setdefault(section, {})[key] = _table(entry)
    write_text(Path(path), render(tables))


def _read(path: Path) -> tuple[dict[str, Any], dict[str, Entry]]:
    data = parse(read_text(path, "parameter set"), str(path))
    try:
        if data.pop("schema", None) != SCHEMA:
            raise InputError(f'this is not a parameter file: one begins with the line schema = "{SCHEMA}"')
        header = {key: value for key, value in data.items() if key == "fit" or not isinstance(value, dict)}
        entries = {}
        for section, keys in data.items():
            for key, table in (keys if section not in header else {}).items():
                name = key if section == "per_recording" else f"{section}.{key}"
                entries[name] = _entry(name, section, table)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    return header, entries


def _entry(name: str, section: str, table: Any) -> Entry:
    parameter, at, _ = name.partition("@")
    candidates = declarations_of(parameter)
    if not candidates or bool(at) != (section == "per_recording"):
        near = nearest(parameter, names_of_all()) if not candidates else ""
        cure = 'name it "SECTION.KEY@RECORDING"' if section == "per_recording" else "correct the name, or take the table out"
        raise InputError(f"there is no parameter '{name}'{near}: {cure}")
    if not isinstance(table, dict):
        raise InputError(f'{name} = {show(table)} is not a table: write it as [{name}] with a line value = "..."')
    checked = validate(_EntryTable, table, f'per_recording."{name}"' if at else name)
    errors = []
    for declaration in candidates:
        try:
            value = quantity(checked.value, declaration)
            lower, upper = _span(checked.bounds, declaration.unit)
            interval = _span(checked.interval95, declaration.unit) if checked.interval95 else None
        except InputError as error:
            errors.append(error)
            continue
        if not lower <= value <= upper or not lower < upper:
            raise InputError(f"{name}.bounds = {show(checked.bounds)} do not hold the value {show(checked.value)}: correct one of them")
        if interval and not interval[0] <= interval[1]:
            raise InputError(f"{name}.interval95 = {show(checked.interval95)} runs backwards: put the smaller end first")
        return Entry(value, declaration.unit, lower, upper, checked.source, interval, checked.free, checked.at_bound)
    raise InputError(f"{name}: {errors[0]}")


def _span(ends: list[Any] | None, unit: str) -> tuple[float, float]:
    """Two quantities in the internal unit; ``"none"`` is an open end."""
    low, high = ends or (_OPEN, _OPEN)
    return -math.inf if low == _OPEN else parse_quantity(low, unit), math.inf if high == _OPEN else parse_quantity(high, unit)


def _table(entry: Entry) -> dict[str, Any]:
    def both(low: float, high: float) -> list[str]:
        return [as_text(end, entry.unit) if math.isfinite(end) else _OPEN for end in (low, high)]

    bounded = math.isfinite(entry.lower) or math.isfinite(entry.upper)
    return {
        "value": as_text(entry.value, entry.unit),
        "bounds": both(entry.lower, entry.upper) if bounded else None,
        "interval95": both(*entry.interval95) if entry.interval95 else None,
        "free": entry.free,
        "at_bound": entry.at_bound,
        "source": entry.source or None,
    }
