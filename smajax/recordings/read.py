"""Reading of recordings.

A recording file has one header row, ``name [unit]`` per column, and numbers below (``readers`` has the formats).
Reading checks all that can be known without the rig, so that later code can rely on it: every channel is known and
convertible, every number is finite, time increases. A bad file is refused in one sentence with file, row and column.
Nothing is dropped unless asked for, and then it is counted.
"""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_unit
from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap, FileColumn, assign_columns, require_channels
from smajax.recordings.readers import Table, open_table
from smajax.recordings.recording import Floats, Recording
from smajax.recordings.value_checks import check_values
from smajax.units import conversion, to_si

# Dropped rows that a note lists by number; of more it gives the count. Chosen so that the note stays one line.
_ROWS_LISTED = 5


def read_recording(
    path: str | Path,
    *,
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
    """Read and check a recording (.csv, .txt, .mat, .parquet, .xlsx).

    Args:
        path: The file.
        mapping: Columns of channels whose headers are not ``name [unit]``, by channel.
        ignore: Headers of columns that are left out; every other column has to be a known channel.
        required: Channels that have to be in the file.
        observed: Channels that have to be in the file and to change.
        clock: Whether there has to be a time; without it the recording may be a path.
        skip_rows: Rows of a text file or sheet before the header.
        delimiter: Character between the cells of a text file.
        decimal: Decimal sign of a text file, ``.`` or ``,``.
        sheet: Sheet of a workbook; the first by default.
        headers: Headers of a text file without a header row.
        drop_bad_rows: Whether to leave out rows that are ragged, blank or unreadable in a column that is read, or whose
            time does not increase; their number and places are noted.

    Raises:
        InputError: one sentence with the place and the cure.
    """
    path = Path(path)
    table = open_table(path, skip_rows=skip_rows, delimiter=delimiter, decimal=decimal, sheet=sheet, headers=headers)
    columns = assign_columns(path, table.headers, mapping or {}, ignore)
    require_channels(path, columns, [*required, *observed, *(["time"] if clock else [])], mapping or {})
    values = _load(path, table, columns, drop_bad_rows)
    rows, notes = None, tuple(column.note for column in columns if column.note)
    if drop_bad_rows:
        rows, dropped = _good_rows(path, values, table.first_row)
        notes += dropped
        if rows is not None:
            values = {name: column[rows] for name, column in values.items()}

    def place(column: FileColumn, i: int) -> str:
        return f"{path}: row {table.first_row + int(i if rows is None else rows[i])}, column '{column.header}'"

    with np.errstate(over="ignore", invalid="ignore"):
        check_values(path, columns, values, observed, place)
        _convert_to_si(path, columns, values)
    has_clock = "time" in values
    time = values.pop("time") if has_clock else np.arange(len(next(iter(values.values()))), dtype=float)
    units = {column.name: column.unit for column in columns}
    return Recording(path.name, time, values, units, table.sha256(), has_clock, notes)


def _load(path: Path, table: Table, columns: Sequence[FileColumn], drop_bad_rows: bool) -> dict[str, Floats]:
    """Return the columns by channel, in the units of the file."""
    try:
        arrays = table.load([column.index for column in columns], drop_bad_rows)
    except OSError as error:
        reason = error.strerror or error
        raise InputError(f"{path}: the file cannot be read to its end ({reason}): copy it anew") from None
    return dict(zip((column.name for column in columns), arrays, strict=True))


def _convert_to_si(path: Path, columns: Sequence[FileColumn], values: dict[str, Floats]) -> None:
    """Convert the values to internal units, in place."""
    for column in columns:
        canonical = channel_unit(column.name)
        if conversion(column.unit, canonical) != (1, 0):
            values[column.name] = to_si(values[column.name], column.unit, canonical)
        if not np.isfinite(values[column.name]).all():
            large = f"numbers too large for {canonical}"
            raise InputError(f"{path}: column '{column.header}': {large}: correct the unit")


def _good_rows(
    path: Path, values: Mapping[str, Floats], first_row: int
) -> tuple[NDArray[np.intp] | None, tuple[str, ...]]:
    """Return the indices of the rows to keep (``None`` for all) and notes on the others."""
    readable = np.all([np.isfinite(column) for column in values.values()], axis=0)
    good = readable.copy()
    if "time" in values:
        time = np.where(readable, values["time"], -np.inf)
        good[1:] &= time[1:] > np.maximum.accumulate(time)[:-1]
    if good.all():
        return None, ()
    if 2 * np.count_nonzero(good) < len(good):
        bad_rows = f"{np.count_nonzero(~good)} of {len(good)} rows are bad"
        first = f"the first of them row {first_row + int(np.argmin(good))}"
        raise InputError(f"{path}: {bad_rows}, {first}, too many to drop: correct the file")
    notes = []
    for what, bad in (
        ("with a blank or unreadable cell", ~readable),
        ("in which time does not increase", readable & ~good),
    ):
        if bad.any():
            indices = np.flatnonzero(bad)
            listed = ", ".join(str(first_row + i) for i in indices[:_ROWS_LISTED])
            more = f" and {len(indices) - _ROWS_LISTED} more" if len(indices) > _ROWS_LISTED else ""
            notes.append(f"{len(indices)} of {len(good)} rows {what} dropped on request: row {listed}{more}")
    return np.flatnonzero(good), tuple(notes)
