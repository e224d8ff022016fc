"""Reading of recordings, from files and from tables in memory.

A recording file has one header row, ``name [unit]`` per column, and rows of numbers (``readers`` has the formats); a
DataFrame, dictionary or array has the same columns.
Reading makes all checks that do not need the rig, so that later code can rely on them: every channel is known and its
unit can be converted, every number is finite, time increases. A bad file is refused in one sentence with file, row and
column. Rows are dropped only on request, and then counted.
"""

import dataclasses
import os
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_unit
from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap, FileColumn, assign_columns, require_channels
from smajax.recordings.readers import Table, open_table
from smajax.recordings.readers.memory import open_memory_table
from smajax.recordings.recording import Floats, Recording
from smajax.recordings.recording_checks import check_recording
from smajax.recordings.sources import DEFAULT_NAME, RecordingSource
from smajax.recordings.value_checks import check_values
from smajax.units import conversion, to_si

# Dropped rows that a note lists by number, followed by the number of the others; chosen to keep the note on one line.
_ROWS_LISTED = 5
# Share of bad rows above which a file is refused instead of repaired: most of the recording would be lost.
_MAX_BAD_SHARE = 0.5


def read_recording(
    source: RecordingSource,
    *,
    name: str | None = None,
    mapping: Mapping[str, ChannelMap] | None = None,
    ignore: Sequence[str] = (),
    required: Sequence[str] = (),
    observed: Sequence[str] = (),
    clock: bool = True,
    skip_rows: int = 0,
    delimiter: str = ",",
    decimal: str = ".",
    sheet: str | None = None,
    headers: Sequence[str] | None = None,
    drop_bad_rows: bool = False,
) -> Recording:
    """Read and check a recording: a file (.csv, .txt, .mat, .parquet, .xlsx) or a table in memory.

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
        clock: Whether the file must have a time; otherwise it may be a path without a clock.
        skip_rows: Rows of a text file or sheet before the header.
        delimiter: Character between the cells of a text file.
        decimal: Decimal sign of a text file, ``.`` or ``,``.
        sheet: Sheet of a workbook; the first by default.
        headers: Headers of an array, or of a text file without a header row.
        drop_bad_rows: Whether to omit rows with a wrong number of cells, rows with a blank or unreadable cell in a
            column that is read, and rows in which time does not increase. ``Recording.notes`` has their numbers.

    Raises:
        InputError: If the source cannot be used; the message names file or object, row and column.
    """
    mapping = mapping or {}
    names = [*required, *observed, *(["time"] if clock else [])]
    if isinstance(source, Recording):
        if headers is not None:
            raise InputError(f"{source.name}: a Recording has channels with names already: leave out headers")
        recording = source if name is None else dataclasses.replace(source, name=name)
        if drop_bad_rows:
            recording = _without_bad_rows(recording, [n for n in names if n not in observed])
        return check_recording(recording, names, observed, mapping)
    if isinstance(source, str | os.PathLike):
        path = Path(source)
        layout = {"skip_rows": skip_rows, "delimiter": delimiter, "decimal": decimal, "sheet": sheet}
        table: Table = open_table(path, **layout, headers=headers)
        origin, name = path, name or path.name
    else:
        table = open_memory_table(source, name, headers, "time" in mapping)
        origin, name = table.origin, name or DEFAULT_NAME
    columns = assign_columns(origin, table.headers, mapping, ignore)
    require_channels(origin, columns, names, mapping)
    return _read_table(table, origin, name, columns, observed, drop_bad_rows)


def _read_table(
    table: Table,
    origin: Path | str,
    name: str,
    columns: Sequence[FileColumn],
    observed: Sequence[str],
    drop_bad_rows: bool,
) -> Recording:
    """Return the columns of a table as a recording, with all checks of their values."""
    values = _load(origin, table, columns, drop_bad_rows)
    rows, notes = None, tuple(column.note for column in columns if column.note)
    if drop_bad_rows:
        rows, dropped = _good_rows(origin, values, table.first_row)
        notes += dropped
        if rows is not None:
            values = {channel: column[rows] for channel, column in values.items()}

    def place(column: FileColumn, i: int) -> str:
        return f"{origin}: row {table.first_row + int(i if rows is None else rows[i])}, column '{column.header}'"

    with np.errstate(over="ignore", invalid="ignore"):
        check_values(origin, columns, values, observed, place, table.drop_option)
        _convert_to_si(origin, columns, values)
    has_clock = "time" in values
    time = values.pop("time") if has_clock else np.arange(len(next(iter(values.values()))), dtype=float)
    units = {column.name: column.unit for column in columns}
    return Recording(name, time, values, units, table.sha256(), has_clock, notes)


def _load(origin: Path | str, table: Table, columns: Sequence[FileColumn], drop_bad_rows: bool) -> dict[str, Floats]:
    """Return the values by channel, in the units of the table."""
    try:
        arrays = table.load([column.index for column in columns], drop_bad_rows)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{origin}: the file cannot be read to its end ({reason}): copy it again") from None
    return dict(zip((column.name for column in columns), arrays, strict=True))


def _convert_to_si(origin: Path | str, columns: Sequence[FileColumn], values: dict[str, Floats]) -> None:
    """Convert the values to internal units, in place."""
    for column in columns:
        canonical = channel_unit(column.name)
        if conversion(column.unit, canonical) != (1, 0):
            values[column.name] = to_si(values[column.name], column.unit, canonical)
        if not np.isfinite(values[column.name]).all():
            problem = f"numbers too large for {canonical}"
            raise InputError(f"{origin}: column '{column.header}': {problem}: correct the unit")


def _without_bad_rows(recording: Recording, names: Sequence[str]) -> Recording:
    """Return a recording without the rows in which a channel of ``names`` is not finite or time does not increase."""
    values = {n: recording.channels[n] for n in names if n in recording.channels}
    values |= {"time": recording.time} if recording.has_clock else {}
    rows, notes = _good_rows(recording.name, values, first_row=0) if values else (None, ())
    if rows is None:
        return recording
    channels = {n: column[rows] for n, column in recording.channels.items()}
    time = recording.time[rows] if recording.has_clock else np.arange(len(rows), dtype=float)
    return dataclasses.replace(recording, time=time, channels=channels, notes=(*recording.notes, *notes))


def _good_rows(
    origin: Path | str, values: Mapping[str, Floats], first_row: int
) -> tuple[NDArray[np.intp] | None, tuple[str, ...]]:
    """Return the indices of the rows to keep (``None`` for all) and notes on the others."""
    readable = np.all([np.isfinite(column) for column in values.values()], axis=0)
    good = readable.copy()
    if "time" in values:
        time = np.where(readable, values["time"], -np.inf)
        good[1:] &= time[1:] > np.maximum.accumulate(time)[:-1]
    if good.all():
        return None, ()
    if np.count_nonzero(~good) > _MAX_BAD_SHARE * len(good):
        bad_rows = f"{np.count_nonzero(~good)} of {len(good)} rows are bad"
        first = f"the first of them row {first_row + int(np.argmin(good))}"
        raise InputError(f"{origin}: {bad_rows}, {first}, too many to drop: correct them")
    notes = []
    for problem, bad in (
        ("with a blank or unreadable cell", ~readable),
        ("in which time does not increase", readable & ~good),
    ):
        if bad.any():
            indices = np.flatnonzero(bad)
            row_numbers = ", ".join(str(first_row + i) for i in indices[:_ROWS_LISTED])
            rest = f" and {len(indices) - _ROWS_LISTED} more" if len(indices) > _ROWS_LISTED else ""
            notes.append(f"{len(indices)} of {len(good)} rows {problem} dropped on request: row {row_numbers}{rest}")
    return np.flatnonzero(good), tuple(notes)
