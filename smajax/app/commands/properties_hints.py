"""Cures in the error messages of ``smajax properties``.

The cures of the readers of recordings name keys of a rig file; this command has no rig. The errors have codes; for each
one there is the option of this command, or the change of the file, with the same effect.
"""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers import TOPIC_SUFFIXES
from smajax.recordings.recognition.recognise import recognise

_COLUMNS_HINT = "--columns, with - for one to ignore, as in --columns '-,temperature [degC],strain [%]'"
# Channels of thermal cycles, and the time, which is in most files.
_CHANNELS = ("time", "temperature", "strain", "stress")

Fields = Mapping[str, Any]


def _delimiter(fields: Fields) -> str:
    name = "space" if fields["delimiter"] == " " else fields["delimiter"]
    return f"give --delimiter {name}" + (" --decimal ," if fields.get("decimal") == "," else "")


def _unit_of(fields: Fields) -> str:
    """Unit in the example of a header, as in 'strain [%]'."""
    return fields["example"].partition("[")[2].removesuffix("]")


# Cures by code that hold for all files.
_CURES: dict[str, Callable[[Fields], str]] = {
    "delimiter": _delimiter,
    "delimiter-is-decimal": lambda fields: 'give --delimiter ";" or "\\t"',
    "decimal": lambda fields: "give --decimal ,",
    "decimal-commas": lambda fields: "save with another delimiter and give --delimiter and --decimal",
    "header-missing": lambda fields: f"name the columns by {fields['columns_hint']}",
    "title-rows": lambda fields: f"give --skip-rows {fields['skip_rows']}",
    "columns-count": lambda fields: "name every column, with - for one to ignore, or give --skip-rows",
    "bad-first-row": lambda fields: (
        "give --units-row if the row has units, else correct it, or leave such rows out with --drop-bad-rows"
    ),
    "stamp": lambda fields: "give its format, as in --time-format '%d.%m.%Y %H:%M:%S', or correct it",
    "date-format": lambda fields: "give the format of both with a space between: --time-format '%d.%m.%Y %H:%M:%S'",
    "columns-missing": lambda fields: f"name its columns by {fields['columns_hint']}",
    "columns-named": lambda fields: "leave --columns out, and export its fields as CSV",
    "mat-variable": lambda fields: f"name it by --variable, as in --variable {fields['variable']}",
    "mat-matrix": lambda fields: f"save one vector per channel, or give --variable {fields['variable']} and --columns",
    "topic-stamps": lambda fields: f"give --clock-topic {fields['topic']} and --topic-interpolation hold or linear",
    "no-column-mapped": lambda fields: "export its fields as CSV, with headers like 'temperature [degC]'",
    "header-blank": lambda fields: f"write one, or name the columns with - for this one by {fields['columns_hint']}",
    "encoding": lambda fields: "give another --encoding, such as cp1252, or save the file as UTF-8",
    "clock-restart": lambda fields: "split the recording there with --on-bad-rows split",
    "constant-channel": lambda fields: "check the sensor",
    "implausible": lambda fields: "",
}
_CURES_OF_COLUMNS: dict[str, Callable[[Fields], str]] = {
    "unknown-column": lambda fields: f"rename it, or name the columns by {fields['columns_hint']}",
    "unit-missing": lambda fields: f"write the header like '{fields['example']}', in the file or by --columns",
    "channel-missing": lambda fields: (
        f"add a column '{fields['example']}' or name the columns by {fields['columns_hint']}"
    ),
}
# The order of the variables of a .mat file is not what MATLAB shows, so that no list of columns names them.
_CURES_OF_MAT: dict[str, Callable[[Fields], str]] = {
    "unknown-column": lambda fields: "save one vector per channel, named temperature, strain and stress",
    "unit-missing": lambda fields: f"save a struct next to it with units.{fields['channel']} = '{_unit_of(fields)}'",
    "channel-missing": lambda fields: f"save a vector {fields['channel']} next to them",
    "columns-named": lambda fields: (
        "name its variables temperature and strain, with a struct units: units.strain = '%'"
    ),
}
# A ROS bag or MCAP file, whose fields are only mapped in a rig.
_CURES_OF_TOPICS: dict[str, Callable[[Fields], str]] = {
    "unknown-column": lambda fields: "rename it in the file, or remove it",
    "unit-missing": lambda fields: f"write the header like '{fields['example']}'",
    "channel-missing": lambda fields: f"add a column '{fields['example']}'",
}


def with_cure_of_this_command(error: InputError, path: Path | None, reading: Mapping[str, Any]) -> InputError:
    """Return an error of the readers of recordings with the cure of this command.

    Args:
        error: The error.
        path: The file that cannot be read; ``None`` for other errors.
        reading: Options of reading by name.
    """
    ending = path.suffix.lower() if path else ""
    of_format = _CURES_OF_TOPICS if ending in TOPIC_SUFFIXES else _CURES_OF_COLUMNS
    of_format = _CURES_OF_MAT if ending == ".mat" else of_format
    cure = {**_CURES, **of_format}.get(error.code)
    if cure is None:
        return error
    hint = _columns_hint(path, reading) if path and ending not in (*TOPIC_SUFFIXES, ".mat") else _COLUMNS_HINT
    return error.with_cure(cure({**error.fields, "columns_hint": hint}))


def _columns_hint(path: Path, reading: Mapping[str, Any]) -> str:
    """Return the option that names the columns of a file as they are recognised, or an example if they are not."""
    names = {field.name for field in dataclasses.fields(ReadOptions)} - {"columns"}
    try:
        recognition = recognise(path, {}, {k: v for k, v in reading.items() if k in names and v is not None})
    except InputError:
        return _COLUMNS_HINT
    columns = [column.text if column.channel in _CHANNELS else "-" for column in recognition.columns]
    is_cycle = {"temperature", "strain"} <= {column.channel for column in recognition.columns}
    if not is_cycle or any("=" in column or "," in column for column in columns):  # a factor has no place there
        return _COLUMNS_HINT
    return f"--columns '{','.join(columns)}'"
