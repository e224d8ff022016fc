"""TOML files: read, checked section by section against a pydantic model, and written; every mistake is one sentence.

A sentence names the place (row and column where the file is not TOML at all, section and key from then on) and the cure. Section models
say how a value is written by an example on the field, and raise ``InputError`` in their own validators where a type alone says too little.
"""

import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from smajax.errors import InputError, nearest
from smajax.units import parse as parse_quantity

Section = TypeVar("Section", bound=BaseModel)

STRICT = ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True)
_LARGEST = 2**20
_FEW = 8
_HEADING = re.compile(r"\s*\[\s*([\w.\-]+)\s*\]")
_SETTING = re.compile(r"\s*([\w.\-]+)\s*=")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
_QUOTES = 'quantities and names stand in quotation marks, as in diameter = "0.15 mm"'
# What tomllib finds, in the words of somebody who writes a rig file.
_FINDINGS = {
    "Cannot declare": "this section stands in the file a second time: put its keys together under one heading",
    "Cannot overwrite": "this key (or section) has a value already: keep one of the two",
    "Expected newline or end of document": f"something follows the value: {_QUOTES}",
    "Expected '=' after a key": "this is neither a [section] nor a key = value: write one of the two",
    "Invalid statement": "this is neither a [section] nor a key = value: write one of the two",
    "Invalid value": f"this is not a value: {_QUOTES}",
    "Unterminated string": "a quotation mark is never closed: close it on its line",
    "Illegal character": "a quotation mark is never closed on its line, or a character is not allowed here: close it, or take it out",
    "Unclosed array": "a bracket [ is never closed: close it with ]",
}
_EXPECTED = {
    "string_type": "text in quotation marks",
    "int_type": "a whole number",
    "bool_type": "true or false",
    "list_type": "a list in square brackets",
    "dict_type": "a table of its own",
    "model_type": "a table of its own",
    "string_too_long": "text of at most {max_length} character(s)",
    "string_too_short": "text of at least {min_length} character(s)",
    "too_short": "a list of {min_length} entries",
    "too_long": "a list of {max_length} entries",
    "greater_than_equal": "{ge} or more",
    "less_than_equal": "{le} or less",
}


def read_text(path: Path, what: str) -> str:
    """The text of a TOML file; ``what`` names its kind in the sentences ("rig", "parameter set")."""
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder: name the {what} file in it, one ending in .toml")
        if not path.exists():
            there = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
            raise InputError(f"{path}: there is no such file{nearest(path.name, there)}: check the path of the {what}")
        if path.stat().st_size > _LARGEST:
            raise InputError(f"{path}: {path.stat().st_size} bytes are too many for a {what}: name the .toml file, not a recording")
        content = path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: the file cannot be read ({error.strerror or error}): check its permissions") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content[: error.start].count(b"\n") + 1
        raise InputError(f"{path}: row {row} is not text in UTF-8: name the .toml file of the {what}, saved as UTF-8") from None
    if "\0" in text:
        raise InputError(f"{path}: this is a binary file: name the .toml file of the {what}, saved as UTF-8 text")
    if not text.strip():
        raise InputError(f"{path}: the file is empty: a {what} begins with a line 'schema = ...', as 'smajax init' writes it")
    return text


def parse(text: str, name: str) -> dict[str, Any]:
    """The tables in a TOML text; ``name`` is the file's in the sentences."""
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        found = re.search(r"^(?P<what>.*) \(at (?:line (?P<row>\d+), column (?P<column>\d+)|end of document)\)$", str(error), re.DOTALL)
        what = found["what"] if found else str(error)
        lines = text.rstrip("\n").split("\n")
        row, column = (found["row"], found["column"]) if found and found["row"] else (len(lines), len(lines[-1]) + 1)
        meaning = next((words for start, words in _FINDINGS.items() if what.startswith(start)), f"{what[0].lower()}{what[1:]}: {_QUOTES}")
        raise InputError(f"{name}: row {row}, column {column}: {meaning}") from None
    except (ValueError, RecursionError):
        raise InputError(f"{name}: a number or a nesting of brackets in this file goes beyond all bounds: write it anew") from None


def lines(text: str) -> dict[str, int]:
    """The row in which each ``section.key`` stands, for those written one a row."""
    section, rows = "", {}
    for row, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            section = heading[1] + "."
        elif setting := _SETTING.match(line):
            rows.setdefault(section + setting[1], row)
    return rows


def validate(model: type[Section], data: Any, section: str) -> Section:
    """``data`` as an instance of ``model``; InputError with the key, its section and the cure otherwise."""
    if not isinstance(data, dict):
        raise InputError(f"[{section}] is a section, not a value: write its keys below a line [{section}]")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # A misspelt key also leaves the right one missing: the misspelling is what to mend.
        found = error.errors(include_url=False)
        unknown = [e for e in found if e["type"] == "extra_forbidden"]
        raise InputError(_sentence((unknown or found)[0], model, section)) from None


def advice(word: str, known: Iterable[str], what: str) -> str:
    """The end of a sentence about an unknown word: the nearest known one, and all of them where they are few or none is near."""
    known = list(known)
    near = nearest(word, known)
    return f"{near}: " + ("correct it, or take it out" if near and len(known) > _FEW else f"{what} {', '.join(known)}")


def show(value: Any) -> str:
    """A value from a TOML file as it may stand in a sentence."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= 60 else text[:57] + "..."


def _sentence(error: Any, model: type[BaseModel], section: str) -> str:
    location, kind, context = error["loc"], error["type"], error.get("ctx", {})
    key = str(location[0]) if location else ""
    place = section + "".join(f", item {part + 1}" if isinstance(part, int) else f".{part}" for part in location)
    if kind == "value_error":
        return f"{place}: {context['error']}"
    if kind == "extra_forbidden":
        return f"{place} is not known{advice(key, model.model_fields, f'the keys of [{section}] are')}"
    field = model.model_fields.get(key)
    example = f"{key} = {field.examples[0]}" if field and field.examples else ""
    if kind == "missing":
        return f"{place} is missing: add " + (f"a line like {example} to [{section}]" if example else "it")
    expected = _EXPECTED[kind].format_map(context) if kind in _EXPECTED else "possible here"
    return f"{place} = {show(error['input'])} is not {expected}: " + (f"write it like {example}" if example else "correct it")


def render(data: Mapping[str, Any]) -> str:
    """TOML text of nested tables of text, numbers, booleans and lists, which ``parse`` takes back to the same; ``None`` is left out."""
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def write_text(path: Path, text: str) -> None:
    """Write a text file completely or not at all, even if the machine stops meanwhile."""
    part = path.with_name(f".{path.name}.{os.getpid()}.part")
    try:
        with part.open("w", encoding="utf-8", newline="\n") as file:
            file.write(text)
            file.flush()
            os.fsync(file.fileno())
        os.replace(part, path)
    except OSError as error:
        raise InputError(f"{path}: the file cannot be written ({error.strerror or error}): check the folder") from None
    finally:
        part.unlink(missing_ok=True)


def _table(data: Mapping[str, Any], names: tuple[str, ...]) -> list[str]:
    inside = {key: value for key, value in data.items() if value is not None}
    plain = {key: value for key, value in inside.items() if not isinstance(value, Mapping)}
    lines = ["", f"[{'.'.join(map(_key, names))}]"] if names and (plain or not inside) else []
    lines += [f"{_key(key)} = {_value(value)}" for key, value in plain.items()]
    for key, value in inside.items():
        if key not in plain:
            lines += _table(value, (*names, key))
    return lines


def _key(key: str) -> str:
    return key if _BARE_KEY.fullmatch(key) else _text(key)


def _value(value: Any) -> str:
    if isinstance(value, str):
        return _text(value)
    if isinstance(value, Mapping):
        return "{" + ", ".join(f"{_key(k)} = {_value(v)}" for k, v in value.items()) + "}"
    if isinstance(value, list | tuple):
        return "[" + ", ".join(map(_value, value)) + "]"
    if isinstance(value, bool):
        return str(value).lower()
    return repr(float(value)) if isinstance(value, float) else str(int(value))


def _text(text: str) -> str:
    escapes = {'"': '\\"', "\\": "\\\\", "\n": "\\n", "\t": "\\t", "\r": "\\r"}
    return '"' + "".join(escapes.get(c) or (f"\\u{ord(c):04x}" if ord(c) < 32 or ord(c) == 127 else c) for c in text) + '"'


def check_schema(data: Mapping[str, Any]) -> None:
    """InputError for a file that is of a version that this one does not know."""
    if data.get("schema", 1) != 1 or isinstance(data.get("schema"), bool):
        raise InputError(f"schema = {show(data['schema'])} is not known: this version reads schema = 1")


def quantity_at(value: Any, unit: str, place: str, *, least: float = -math.inf) -> float:
    """A quantity in a unit, at least so large; InputError with its place in the file, and the cure."""
    try:
        number = parse_quantity(value, unit)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
    if not number >= least:
        raise InputError(f"{place} = {show(value)} is too small: give {least:g}{'' if unit == '1' else ' ' + unit} or more")
    return number
