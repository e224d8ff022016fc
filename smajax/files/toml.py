"""TOML files: reading, checks of sections against pydantic models, and writing.

Every mistake is reported in one sentence with its place (row and column if the file is not TOML, else section and key)
and the cure. The fields of the section models have an example of their value for these sentences; their validators
raise ``InputError`` for what a type does not express.
"""

import math
import os
import re
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel, ConfigDict, ValidationError

from smajax.errors import InputError, shortened, suggestion
from smajax.recordings.paths import check_name, replacing, similar_name, unreadable
from smajax.units import parse_quantity

Section = TypeVar("Section", bound=BaseModel)

STRICT = ConfigDict(extra="forbid", strict=True, arbitrary_types_allowed=True)
# Bytes of the largest file: far above the usual 2 kB, so that a recording passed by mistake is refused at once.
_MAX_BYTES = 2**20
# Number of names up to which a sentence lists them even if it suggests one; chosen to keep the sentence on one line.
_MAX_LISTED = 8
# Characters of a value that a sentence shows; chosen to keep it on one line.
_SHOWN_CHARACTERS = 60
# Tables and lists in each other, far above what a file of smajax has.
_MAX_DEPTH = 16
# Parts of the longest key, above the tables that may be in each other: tomllib needs memory by the square of them.
_MAX_KEY_PARTS = 64
_KEY_PART = r"(?:[\w\-]++|\"[^\"\n]*+\"|'[^'\n]*+')"
_DOTTED_KEY = re.compile(rf"{_KEY_PART}(?:[ \t]*+\.[ \t]*+{_KEY_PART})*+")
# Smallest whole number that TOML, which has 64 bits, does not have.
_TOO_LARGE = 2**63
_HEADING = re.compile(r"\s*\[\s*([\w.\-]+)\s*\]")
_SETTING = re.compile(r"\s*([\w.\-]+)\s*=")
# Form of the messages of tomllib: what is wrong, and where.
_TOML_ERROR = re.compile(
    r"^(?P<what>.*) \(at (?:line (?P<row>\d+), column (?P<column>\d+)|end of document)\)$", re.DOTALL
)
_QUOTES = 'put quantities and names in quotation marks, as in diameter = "0.15 mm"'
_NO_SETTING = "this is neither a [section] nor a key = value: write one of the two"
_OPEN_QUOTE = "a quotation mark is not closed on its line, or a character is not allowed here: close it, or remove it"
# Explanations for the author of a file, by the beginning of tomllib's message.
_EXPLANATIONS = {
    "Cannot declare": "this section is in the file twice: put its keys together under one heading",
    "Cannot overwrite": "this key (or section) already has a value: keep one of the two",
    "Expected newline or end of document": f"something follows the value: {_QUOTES}",
    "Expected '=' after a key": _NO_SETTING,
    "Invalid statement": _NO_SETTING,
    "Invalid value": f"this is not a value: {_QUOTES}",
    "Unterminated string": "a quotation mark is not closed: close it on its line",
    "Illegal character": _OPEN_QUOTE,
    "Unclosed array": "a bracket [ is not closed: close it with ]",
}
# Expected values in words, by the type of pydantic's error.
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


def read_text(path: Path, kind: str) -> str:
    """Return the text of a TOML file.

    Args:
        path: The file.
        kind: Kind of the file in messages, such as "rig" or "parameter set".

    Raises:
        InputError: If the file is missing, too large, or not text in UTF-8.
    """
    check_name(path)
    try:
        if path.is_dir():
            raise InputError(f"{path}: this is a folder: name the {kind} file in it, one ending in .toml")
        if not path.exists():
            raise InputError(f"{path}: there is no such file{similar_name(path)}: check the path of the {kind}")
        if not path.is_file():  # a pipe or a device, which may never end
            raise InputError(f"{path}: this is not a regular file: name the {kind} file, one ending in .toml")
        if path.stat().st_size > _MAX_BYTES:
            problem = f"{path.stat().st_size} bytes are too many for a {kind}"
            raise InputError(f"{path}: {problem}: name the .toml file, not a recording")
        content = path.read_bytes()
    except OSError as error:
        raise unreadable(path, error) from None
    try:
        text = content.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        row = content[: error.start].count(b"\n") + 1
        cure = f"name the .toml file of the {kind}, saved as UTF-8"
        raise InputError(f"{path}: row {row} is not text in UTF-8: {cure}") from None
    if "\0" in text:
        raise InputError(f"{path}: this is a binary file: name the .toml file of the {kind}, saved as UTF-8 text")
    if not text.strip():
        cure = f"a {kind} begins with a line 'schema = ...', as 'smajax init' writes it"
        raise InputError(f"{path}: the file is empty: {cure}")
    return text


def parse_toml(text: str, name: str) -> dict[str, Any]:
    """Parse a TOML text into its tables.

    Args:
        text: The text.
        name: Name of the file in messages.

    Raises:
        InputError: If the text is not TOML; the message names row, column and cure.
    """
    for key in _DOTTED_KEY.finditer(text):
        if key[0].count(".") > _MAX_KEY_PARTS and len(re.findall(_KEY_PART, key[0])) > _MAX_KEY_PARTS:
            row = text.count("\n", 0, key.start()) + 1
            raise InputError(f"{name}: row {row}: a key has more than {_MAX_KEY_PARTS} parts: correct it")
    try:
        data = tomllib.loads(text)
    except tomllib.TOMLDecodeError as error:
        match = _TOML_ERROR.search(str(error))
        reason = match["what"] if match else str(error)
        rows = text.rstrip("\n").split("\n")
        row, column = (match["row"], match["column"]) if match and match["row"] else (len(rows), len(rows[-1]) + 1)
        default = f"{reason[0].lower()}{reason[1:]}: {_QUOTES}"
        meaning = next((words for start, words in _EXPLANATIONS.items() if reason.startswith(start)), default)
        raise InputError(f"{name}: row {row}, column {column}: {meaning}") from None
    except (ValueError, RecursionError):
        problem = "a number or a nesting of brackets in this file is too large to be read"
        raise InputError(f"{name}: {problem}: correct it") from None
    check_sizes(data, name)
    return data


def check_sizes(data: Mapping[str, Any], name: str) -> None:
    """Check that tables are not nested too deeply, and that whole numbers have at most 64 bits.

    Args:
        data: The tables.
        name: Name of the file or dictionary in messages.

    Raises:
        InputError: If they are; the message names the section.
    """
    values: list[tuple[str, Any, int]] = [(key, value, 1) for key, value in data.items()]
    while values:
        key, value, depth = values.pop()
        if depth > _MAX_DEPTH:
            raise InputError(f"{name}: {key} has tables or lists nested more than {_MAX_DEPTH} times: correct it")
        if isinstance(value, int) and not -_TOO_LARGE <= value < _TOO_LARGE:
            problem = f"a whole number of {key} needs {value.bit_length() + 1} bits, above the 64 of a TOML file"
            raise InputError(f"{name}: {problem}: correct it")
        parts = value.values() if isinstance(value, Mapping) else value if isinstance(value, list | tuple) else ()
        values += [(key, part, depth + 1) for part in parts]


def line_numbers(text: str) -> dict[str, int]:
    """Return the row, counted from 1, in which each ``section.key`` stands."""
    section, rows = "", {}
    for row, line in enumerate(text.splitlines(), 1):
        if heading := _HEADING.match(line):
            section = heading[1] + "."
        elif setting := _SETTING.match(line):
            rows.setdefault(section + setting[1], row)
    return rows


def flatten_keys(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return nested tables as one table with dotted keys.

    An unquoted key such as ``heat.h0 = [...]`` is a nested table in TOML.
    """
    flat: dict[str, Any] = {}
    for key, value in table.items():
        if isinstance(value, dict):
            flat |= {f"{key}.{inner}": v for inner, v in flatten_keys(value).items()}
        else:
            flat[key] = value
    return flat


def validate(model: type[Section], data: Any, section: str) -> Section:
    """Return the data of a section as an instance of its model.

    Args:
        model: The pydantic model.
        data: Content of the section as parsed from the file.
        section: Name of the section in messages.

    Raises:
        InputError: If the data do not fit the model; the message names section, key and cure.
    """
    if not isinstance(data, dict):
        raise InputError(f"[{section}] is a section, not a value: write its keys below a line [{section}]")
    try:
        return model.model_validate(data)
    except ValidationError as error:
        # A misspelt key is also reported as a missing one: the misspelling is what to correct.
        errors = error.errors(include_url=False)
        unknown = [e for e in errors if e["type"] == "extra_forbidden"]
        raise InputError(_sentence((unknown or errors)[0], model, section)) from None


def advice(word: str, candidates: Iterable[str], intro: str) -> str:
    """Return the end of a sentence about an unknown word, with the most similar candidate and a list of all.

    Args:
        word: The unknown word.
        candidates: Known words; they are listed if they are few or none is similar.
        intro: Beginning of the list, such as "the sections are".
    """
    candidates = list(candidates)
    hint = suggestion(word, candidates)
    is_long = hint and len(candidates) > _MAX_LISTED
    return f"{hint}: " + ("correct it, or remove it" if is_long else f"{intro} {', '.join(candidates)}")


def show(value: Any) -> str:
    """Return a value from a TOML file as text for a sentence, shortened if it is long."""
    if isinstance(value, bool):
        return str(value).lower()
    return shortened(repr(value), _SHOWN_CHARACTERS)


def _sentence(error: Any, model: type[BaseModel], section: str) -> str:
    """Return the sentence on one of pydantic's errors."""
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
    """Check the key ``schema`` of a file.

    Raises:
        InputError: If this version of smajax does not read that schema.
    """
    if data.get("schema", 1) != 1 or isinstance(data.get("schema"), bool):
        raise InputError(f"schema = {show(data['schema'])} is not known: this version reads schema = 1")


def quantity_at(value: Any, unit: str, place: str, *, least: float = -math.inf) -> float:
    """Return a quantity from a file in an internal unit.

    Args:
        value: Value in the file.
        unit: Internal unit.
        place: Section and key of the value, for messages.
        least: Smallest value that is accepted, in the internal unit.

    Raises:
        InputError: If the value is not a quantity of that kind, or is too small.
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
    """Return the TOML text of nested tables; ``parse_toml`` returns the same tables and the same floats.

    Args:
        data: Tables of text, numbers, booleans and lists; keys with the value ``None`` are omitted.
    """
    import tomlkit  # slow to import, and not needed to read a file

    return tomlkit.dumps(_present(data))


def write_text(path: Path, text: str) -> None:
    """Write a text file completely or not at all, even if the computer stops in the middle.

    Args:
        path: The file.
        text: Its text.

    Raises:
        InputError: If it cannot be written.
    """
    with replacing(path) as part, part.open("w", encoding="utf-8", newline="\n") as file:
        file.write(text)
        file.flush()
        os.fsync(file.fileno())


def _present(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table without the keys that have no value, also in its own tables."""
    return {
        key: _present(value) if isinstance(value, Mapping) else value
        for key, value in table.items()
        if value is not None
    }
