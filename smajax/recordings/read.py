"""Reading of recordings, from files and from tables in memory.

A recording file has one header row, ``name [unit]`` per column, and rows of numbers (``readers`` has the formats); a
DataFrame, dictionary or array has the same columns.
Reading makes all checks that do not need the rig, so that later code can rely on them: every channel is known and its
unit can be converted, every number is finite, time increases. A bad file is refused in one sentence with file, row and
column. Rows are dropped, and a file is split where its clock begins again, only on request, and then counted.
"""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_unit
from smajax.errors import InputError
from smajax.recordings.bad_rows import good_rows, impossible_values, split_rows
from smajax.recordings.column_mapping import (
    ROW_NUMBER_HEADERS,
    ChannelMap,
    ColumnNote,
    FileColumn,
    assign_columns,
    require_channels,
)
from smajax.recordings.column_selection import select_columns
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers import Table, open_tables
from smajax.recordings.readers.memory import open_memory_table
from smajax.recordings.recording import Floats, Recording
from smajax.recordings.recording_checks import check_recording, parts_without_bad_rows
from smajax.recordings.sources import DEFAULT_NAME, RecordingSource
from smajax.recordings.value_checks import check_values
from smajax.units import as_text, conversion, to_si


@dataclasses.dataclass(frozen=True)
class _Request:
    """What a recording is read for: the arguments of ``read_recordings``."""

    mapping: Mapping[str, ChannelMap]
    ignore: Sequence[str]
    names: Sequence[str]
    observed: Sequence[str]
    options: ReadOptions
    clock: bool

    @property
    def times_may_repeat(self) -> bool:
        """Whether rows may have the same time: those of a path, which needs no clock."""
        return not self.clock


def read_recording(source: RecordingSource, **arguments: Any) -> Recording:
    """Read and check a recording: a file of one of the formats of ``readers``, or a table in memory.

    Args:
        source: A path, a table in memory or a ``Recording``, as in ``read_recordings``.
        **arguments: Arguments of ``read_recordings``.

    Raises:
        InputError: If the source cannot be used, or has several recordings; the message names file or object, row and
            column.
    """
    return only_recording(read_recordings(source, **arguments), "read_recordings")


def only_recording(recordings: Sequence[Recording], function: str) -> Recording:
    """Return the only one of the recordings of a file.

    Args:
        recordings: The recordings.
        function: Function that returns all of them, for the message.

    Raises:
        InputError: If there are several.
    """
    if len(recordings) > 1:
        names = ", ".join(recording.name for recording in recordings)
        raise InputError(f"{len(recordings)} recordings were read ({names}), and one is needed: use {function}")
    return recordings[0]


def read_recordings(
    source: RecordingSource,
    *,
    name: str | None = None,
    mapping: Mapping[str, ChannelMap] | None = None,
    ignore: Sequence[str] = (),
    required: Sequence[str] = (),
    observed: Sequence[str] = (),
    clock: bool = True,
    headers: Sequence[str] | None = None,
    drop_bad_rows: bool = False,
    options: ReadOptions | None = None,
    **changes: Any,
) -> list[Recording]:
    """Read and check the recordings of a file: one, or several if sheets are named or it is split.

    Args:
        source: A path; a DataFrame or pyarrow table; a dictionary or structured array such as
            ``{"time [s]": t, "current [A]": i}``; an array of shape (rows, columns) with ``headers``; or a
            ``Recording``, whose observed channels may be NaN, and which is returned if it has the required channels.
            An index of dates or durations is the time.
        name: Name of the recording; by default that of the file, or "recording".
        mapping: Columns of channels whose headers are not ``name [unit]``, by channel.
        ignore: Headers of columns that are not read; every other column must be a known channel.
        required: Channels that must be in the file.
        observed: Channels that must be in the file and must change.
        clock: Whether the file must have a time; otherwise it may be a path without a clock, and its time may repeat.
        headers: Headers of an array, or of a text file without a header row, as ``columns`` of ``ReadOptions``.
        drop_bad_rows: Whether to omit rows with a wrong number of cells, rows with a blank or unreadable cell in a
            column that is read, and rows in which time does not increase (``on_bad_rows="drop"``).
            ``Recording.notes`` has their numbers.
        options: Layout of the file, its clock, and what is done with bad rows.
        **changes: Single options of ``ReadOptions``, such as ``skip_rows=3`` or ``on_bad_rows="split"``.

    Raises:
        InputError: If the source cannot be used; the message names file or object, row and column.
    """
    is_file = isinstance(source, str | os.PathLike)
    if not is_file and headers is None:
        headers = changes.get("columns")
    try:
        changes |= {"on_bad_rows": "drop"} if drop_bad_rows else {}
        changes |= {"columns": tuple(headers)} if headers is not None and is_file else {}
        options = (options or ReadOptions()).replace(**changes)
    except InputError as error:
        if not is_file:  # a table in memory has no name
            raise
        raise InputError(f"{source}: {error}") from None
    needs_time = clock and (options.sample_period is None or isinstance(source, Recording))
    names = [*required, *observed, *(["time"] if needs_time else [])]
    request = _Request(mapping or {}, ignore, names, observed, options, clock)
    if isinstance(source, Recording):
        return _check_recording(source, name, headers, request)
    if is_file:
        path = Path(source)
        tables = [(table, path, _with_label(name or path.name, table)) for table in open_tables(path, options)]
    else:
        table = open_memory_table(source, name, headers, "time" in request.mapping, options.time_format)
        tables = [(table, table.origin, name or DEFAULT_NAME)]
    return [recording for table, origin, title in tables for recording in _read_table(table, origin, title, request)]


def _with_label(name: str, table: Table) -> str:
    return f"{name} {table.label_kind} '{table.label}'" if table.label else name


def _check_recording(
    source: Recording, name: str | None, headers: Sequence[str] | None, request: _Request
) -> list[Recording]:
    """Return a recording that is already read, or its parts, if it has the channels."""
    if headers is not None:
        raise InputError(f"{source.name}: a Recording has channels with names already: leave out headers")
    recording = source if name is None else dataclasses.replace(source, name=name)
    parts = [recording]
    if request.options.on_bad_rows != "refuse":
        parts = parts_without_bad_rows(
            recording,
            [n for n in request.names if n not in request.observed],
            request.options.on_bad_rows,
            request.times_may_repeat,
        )
    return [check_recording(part, request.names, request.observed, request.mapping) for part in parts]


def _read_table(table: Table, origin: Path | str, name: str, request: _Request) -> list[Recording]:
    """Return the columns of a table as recordings, with all checks of their values."""
    origin = f"{origin}: {table.label_kind} '{table.label}'" if table.label else origin
    if not table.headers:
        raise InputError(f"{origin}: there are no columns: record a time and the channels of the rig")
    skipped, selection_notes = select_columns(origin, table, request.mapping, request.ignore, request.options)
    columns = assign_columns(origin, table.headers, request.mapping, request.ignore, table.stamps, skipped)
    require_channels(origin, columns, request.names, request.mapping)
    has_time_column = any(column.name == "time" for column in columns)
    period = request.options.sample_period
    if period is not None and has_time_column:
        cure = "remove sample_period, or leave the column out with [channels] ignore"
        raise InputError(f"{origin}: there is a time column, and sample_period = {as_text(period, 's')}: {cure}")
    table.stamps = {c.index: table.stamps[c.index] for c in columns if c.name == "time" and c.index in table.stamps}
    values, notes = _load(origin, table, columns, request)
    notes += (*selection_notes, *(column.note for column in columns if column.note))
    parts: list[tuple[NDArray[np.intp] | None, tuple[str, ...]]] = [(None, ())]
    if request.options.on_bad_rows == "drop":
        parts = [good_rows(origin, values, table.first_row, request.times_may_repeat)]
    elif request.options.on_bad_rows == "split":
        parts = split_rows(origin, values, table.first_row, request.times_may_repeat)
    recordings = []
    for k, (rows, part_notes) in enumerate(parts, 1):
        title = name if len(parts) == 1 else f"{name} part {k}"
        recordings.append(_recording(table, origin, title, columns, values, rows, request))
        recordings[-1] = dataclasses.replace(
            recordings[-1], notes=(*table.notes, *notes, *part_notes, *recordings[-1].notes)
        )
    return recordings


def _recording(
    table: Table,
    origin: Path | str,
    name: str,
    columns: Sequence[FileColumn],
    table_values: Mapping[str, Floats],
    rows: NDArray[np.intp] | None,
    request: _Request,
) -> Recording:
    """Return some rows of a table as a recording."""
    values = {c: v if rows is None else v[rows] for c, v in table_values.items()}

    def place(column: FileColumn, i: int) -> str:
        return f"{origin}: row {table.first_row + int(i if rows is None else rows[i])}, column '{column.header}'"

    with np.errstate(over="ignore", invalid="ignore"):
        drop_option, may_repeat = table.drop_option, request.times_may_repeat
        check_values(origin, columns, values, request.observed, place, drop_option, may_repeat)
        _convert_to_si(origin, columns, values)
    units, notes = {column.name: column.unit for column in columns}, ()
    if "time" in values:
        time = values.pop("time")
        if np.any(time != time[0]):
            return Recording(name, time, values, units, table.sha256(), True, _repeats_note(time))
        del units["time"]
        notes = ("the time is the same in all rows, and was left out: a path is led in the order of its rows",)
    count = len(next(iter(values.values())))
    period = request.options.sample_period
    if period is None:
        return Recording(name, np.arange(count, dtype=float), values, units, table.sha256(), False, notes)
    time = np.array((np.arange(count) if rows is None else rows) * period, float)
    return Recording(name, time, values, {"time": "s"} | units, table.sha256(), True)


def _repeats_note(time: Floats) -> tuple[str, ...]:
    """Return a note with the number of rows at the time of the row before."""
    repeats = int(np.count_nonzero(time[1:] == time[:-1]))
    plural = "s have" if repeats > 1 else " has"
    return (f"{repeats} row{plural} the time of the row before, which is allowed here",) if repeats else ()


def _load(
    origin: Path | str, table: Table, columns: Sequence[FileColumn], request: _Request
) -> tuple[dict[str, Floats], tuple[str, ...]]:
    """Return the values by channel, in the units of the table, and a note on a column of row numbers."""
    has_row_numbers = (
        table.headers[0] in ROW_NUMBER_HEADERS
        and table.headers[0] not in request.ignore
        and all(column.index for column in columns)
    )
    indices = [*([0] if has_row_numbers else []), *(column.index for column in columns)]
    try:
        arrays = table.load(indices, request.options.on_bad_rows != "refuse")
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{origin}: the file cannot be read to its end ({reason}): copy it again") from None
    notes: tuple[str, ...] = ()
    if has_row_numbers:
        _refuse_other_than_row_numbers(origin, arrays.pop(0))
        notes = (ColumnNote("column 1, which has no header and counts the rows, was left out"),)
    scaled = [c.source.scaled(a) if c.source else a for c, a in zip(columns, arrays, strict=True)]
    limited = [c.source.limits_note(c.name, a) for c, a in zip(columns, arrays, strict=True) if c.source]
    notes += tuple(filter(None, limited))
    values = dict(zip((column.name for column in columns), scaled, strict=True))
    return values, notes + (_blank_impossible(columns, values) if request.options.on_bad_rows != "refuse" else ())


def _blank_impossible(columns: Sequence[FileColumn], values: dict[str, Floats]) -> tuple[str, ...]:
    """Make NaN of values that cannot be, in place, so that their rows are bad ones; return notes on them."""
    notes = []
    for column in columns:
        bad = impossible_values(column.name, values[column.name], column.unit)
        if bad.any() and not column.any_scale:
            values[column.name] = np.where(bad, np.nan, values[column.name])
            notes.append(f"{column.name} is outside 0 to 1 in {np.count_nonzero(bad)} rows, which count as unreadable")
    return tuple(notes)


def _refuse_other_than_row_numbers(origin: Path | str, numbers: Floats) -> None:
    """Refuse a first column without a header whose values do not rise by one from row to row."""
    readable = np.flatnonzero(np.isfinite(numbers))
    if np.array_equal(np.diff(numbers[readable]), np.diff(readable)):
        return
    cure = "write one like 'current [A]', or leave the column out with [channels] ignore = [\"\"] in the rig"
    message = f"{origin}: column 1 has no header, and does not count the rows: {cure}"
    raise InputError(message, code="header-blank", cure=cure)


def _convert_to_si(origin: Path | str, columns: Sequence[FileColumn], values: dict[str, Floats]) -> None:
    """Convert the values to internal units, in place."""
    for column in columns:
        canonical = channel_unit(column.name)
        if conversion(column.unit, canonical) != (1, 0):
            values[column.name] = to_si(values[column.name], column.unit, canonical)
        if not np.isfinite(values[column.name]).all():
            problem = f"numbers too large for {canonical}"
            raise InputError(f"{origin}: column '{column.header}': {problem}: correct the unit")
