"""TOML files: read, checked section by section against a pydantic model, and written; every mistake is one sentence.

A sentence names the place (row and column where the file is not TOML at all, section and key otherwise) and the cure.
Section models say how a value is written by an example on the field, and raise ``InputError`` in their own validators
where a type alone says too little.
"""

import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from smajax.errors import InputError, suggestion
from smajax.units import parse_quantity

Section = TypeVar("Section", bound=BaseModel)

STRICT = ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True)
# Bytes of the largest file: far above a usual one of 2 kB, so that a recording given in its place is refused at once.
_MAX_BYTES = 2**20
# Names up to which a sentence lists all of them even where a similar one is suggested; chosen to keep it one line.
_MAX_LISTED = 8
# Characters of a value that a sentence shows.
_SHOWN_CHARACTERS = 60
_HEADING = re.compile(r"\s*\[\s*([\w.\-]+)\s*\]")
_SETTING = re.compile(r"\s*([\w.\-]+)\s*=")
_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+", re.ASCII)
# tomllib's message: what is wrong, and where.
_TOML_ERROR = re.compile(
    r"^(?P<what>.*) \(at (?:line (?P<row>\d+), column (?P<column>\d+)|end of document)\)$", re.DOTALL
)
_QUOTES = 'quantities and names stand in quotation marks, as in diameter = "0.15 mm"'
_NO_SETTING = "this is neither a [section] nor a key = value: write one of the two"
_OPEN_QUOTE = (
    "a quotation mark is never closed on its line, or a character is not allowed here: close it, or take it out"
)
# What tomllib finds, by the beginning of its message, in the words of somebody who writes a rig file.
_FINDINGS = {
    "Cannot declare": "this section stands in the file a second time: put its keys together under one heading",
    "Cannot overwrite": "this key (or section) has a value already: keep one of the two",
    "Expected newline or end of document": f"something follows the value: {_QUOTES}",
    "Expected '=' after a key": _NO_SETTING,
    "Invalid statement": _NO_SETTING,
    "Invalid value": f"this is not a value: {_QUOTES}",
    "Unterminated string": "a quotation mark is never closed: close it on its line",
    "Illegal character": _OPEN_QUOTE,
    "Unclosed array": "a bracket [ is never closed: close it with ]",
}
# What pydantic expects, by the type of its error.
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
    """Return the text of a TOML file.

    Args:
        path: The file.
        what: Kind of the file in messages: "rig", "parameter set".

    Raises:
        InputError: if there is no such file, or it is no text.
    """
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder: name the {what} file in it, one ending in .toml")
        if not path.exists():
            there = [other.name for other in path.parent.iterdir()] if path.parent.is_dir() else []
            hint = suggestion(path.name, there)
            raise InputError(f"{path}: there is no such file{hint}: check the path of the {what}")
        if path.stat().st_size > _MAX_BYTES:
            size = f"{path.stat().st_size} bytes are too many for a {what}"
            raise InputError(f"{path}: {size}: name the .toml file, not a recording")
        content = path.read_bytes()
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: the file cannot be read ({reason}): check its permissions") from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content[: error.start].count(b"\n") + 1
        cure = f"name the .toml file of the {what}, saved as UTF-8"
        raise InputError(f"{path}: row {row} is not text in UTF-8: {cure}") from None
    if "\0" in text:
        raise InputError(f"{path}: this is a binary file: name the .toml file of the {what}, saved as UTF-8 text")
    if not text.strip():
        begins = f"a {what} begins with a line 'schema = ...', as 'smajax init' writes it"
        raise InputError(f"{path}: the file is empty: {begins}")
    return text


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse a TOML text into its tables.

    Args:
        text: The text.
        name: Name of the file in messages.

    Raises:
        InputError: with row, column and cure, if the text is not TOML.
    """
    try:
        return tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = _TOML_ERROR.search(str(error))
        what = match["what"] if match else str(error)
        rows = text.rstrip("\n").split("\n")
        row, column = (match["row"], match["column"]) if match and match["row"] else (len(rows), len(rows[-1]) + 1)
        other = f"{what[0].lower()}{what[1:]}: {_QUOTES}"
        meaning = next((words for start, words in _FINDINGS.items() if what.startswith(start)), other)
        raise InputError(f"{name}: row {row}, column {column}: {meaning}") from None
    except (ValueError, RecursionError):
        beyond = "a number or a nesting of brackets in this file goes beyond all bounds"
        raise InputError(f"{name}: {beyond}: write it anew") from None


def line_numbers(text: str) -> dict[str, int]:
    """Return the row of each ``section.key``, for those written one a row."""
    section, rows = "", {}
    for row, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            section = heading[1] + "."
        elif setting := _SETTING.match(line):
            rows.setdefault(section + setting[1], row)
    return rows


def flatten_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Flatten nested tables to dotted keys: ``heat.h0 = [...]`` without quotation marks is a table in a table."""
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{inner}": v for inner, v in flatten_keys(value).items()}
        else:
            flat[key] = value
    return flat


def validate(model: type[Section], data: Any, section: str) -> Section:
    """Return the data of a section as an instance of its model.

    Raises:
        InputError: with the key, its section and the cure.
    """
    if not isinstance(data, dict):
        raise InputError(f"[{section}] is a section, not a value: write its keys below a line [{section}]")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # A misspelt key also leaves the right one missing: the misspelling is the one to report.
        errors = error.errors(include_url=False)
        unknown = [e for e in errors if e["type"] == "extra_forbidden"]
        raise InputError(_sentence((unknown or errors)[0], model, section)) from None


def advice(word: str, candidates: Iterable[str], what: str) -> str:
    """Return the end of a sentence about an unknown word: the most similar candidate, and all of them where useful.

    Args:
        word: The unknown word.
        candidates: Known words; they are listed where they are few or none is similar.
        what: Begins the list, such as "the sections are".
    """
    candidates = list(candidates)
    hint = suggestion(word, candidates)
    many = hint and len(candidates) > _MAX_LISTED
    return f"{hint}: " + ("correct it, or take it out" if many else f"{what} {', '.join(candidates)}")


def show(value: Any) -> str:
    """Return a value from a TOML file as it stands in a sentence."""
    if isinstance(value, bool):
        return str(value).lower()
    text = repr(value)
    return text if len(text) <= _SHOWN_CHARACTERS else text[: _SHOWN_CHARACTERS - 3] + "..."


def _sentence(error: Any, model: type[BaseModel], section: str) -> str:
    location, kind, context = error["loc"], error["type"], error.get("ctx", {})
    key = str(location[0]) if location else ""
    place = section + "".join(f", item {part + 1}" if isinstance(part, int) else f".{part}" for part in location)
    if kind == "value_error":
        return f"{place}: {context['error']}"
    fields = {field.alias or name: field for name, field in model.model_fields.items()}
    if kind == "extra_forbidden":
        return f"{place} is not known{advice(key, fields, f'the keys of [{section}] are')}"
    field = fields.get(key)
    example = f"{key} = {field.examples[0]}" if field and field.examples else ""
    if kind == "missing":
        return f"{place} is missing: add " + (f"a line like {example} to [{section}]" if example else "it")
    expected = _EXPECTED[kind].format_map(context) if kind in _EXPECTED else "possible here"
    cure = f"write it like {example}" if example else "correct it"
    return f"{place} = {show(error['input'])} is not {expected}: {cure}"


def check_schema(data: Mapping[str, Any]) -> None:
    """Refuse a file of a version that this one does not know."""
    if data.get("schema", 1) != 1 or isinstance(data.get("schema"), bool):
        raise InputError(f"schema = {show(data['schema'])} is not known: this version reads schema = 1")


def quantity_at(value: Any, unit: str, place: str, *, least: float = -math.inf) -> float:
    """Return a quantity from a file in an internal unit.

    Args:
        value: Value in the file.
        unit: Internal unit.
        place: Its place in the file, for messages.
        least: Smallest value that is accepted.

    Raises:
        InputError: with the place and the cure.
    """
    try:
        number = parse_quantity(value, unit)
    except InputError as error:
        raise InputError(f"{place}: {error}") from None
    if not number >= least:
        limit = f"{least:g}{'' if unit == '1' else ' ' + unit}"
        raise InputError(f"{place} = {show(value)} is too small: give {limit} or more")
    return number


def render_toml(data: Mapping[str, Any]) -> str:
    """Return the TOML text of nested tables, which ``parse_toml`` reads back to the same.

    Args:
        data: Tables of text, numbers, booleans and lists; ``None`` is left out.
    """
    return "\n".join(_table(data, ())).strip("\n") + "\n"


def write_text(path: Path, text: str) -> None:
    """Write a text file completely or not at all, even if the computer stops meanwhile."""
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
    present = {key: value for key, value in data.items() if value is not None}
    plain = {key: value for key, value in present.items() if not isinstance(value, Mapping)}
    rows = ["", f"[{'.'.join(map(_key, names))}]"] if names and (plain or not present) else []
    rows += [f"{_key(key)} = {_value(value)}" for key, value in plain.items()]
    for key, value in present.items():
        if key not in plain:
            rows += _table(value, (*names, key))
    return rows


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
    control = {chr(code): f"\\u{code:04x}" for code in (*range(32), 127)}
    return '"' + "".join(escapes.get(c) or control.get(c, c) for c in text) + '"'
