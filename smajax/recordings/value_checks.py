"""Checks of the values of a recording: number of rows, increasing time, changing sensors, plausible scales."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_of, channel_unit
from smajax.errors import InputError
from smajax.recordings.bad_rows import time_order, time_slips
from smajax.recordings.column_mapping import FileColumn
from smajax.recordings.readers.base import repair_hint
from smajax.recordings.unit_checks import check_scale
from smajax.units import to_si

# Number of rows with decreasing time up to which they count as single errors, and not as unsorted rows. Chosen by
# trial; tested in tests/unit/recordings/test_bad_recordings.py.
_MAX_TIME_SLIPS = 2
# Number of restarts of the clock up to which they are those of a logger that is switched on again, and not unsorted
# rows. Chosen by trial.
_MAX_RESTARTS = 20

Place = Callable[[FileColumn, int], str]


def check_values(
    path: Path | str,
    columns: Sequence[FileColumn],
    values: Mapping[str, NDArray[np.float64]],
    observed: Sequence[str],
    place: Place,
    drop_option: str,
    may_repeat: bool = False,
) -> None:
    """Check the values of a recording.

    Args:
        path: The file, or the name of the object, for messages.
        columns: Columns that are read.
        values: Arrays, shape ``(rows,)``, by channel, in the units of the file.
        observed: Channels that must change.
        place: Returns a text such as "file: row 5, column 'x'" for a column and an index.
        drop_option: The option that leaves bad rows out, for messages.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Raises:
        InputError: If there is a single row, time does not increase, a value is not plausible, or an observed channel
            is constant.
    """
    check_row_count(path, len(values[columns[0].name]))
    peaks = _peaks(columns, values)
    for column in columns:
        numbers = values[column.name]
        if column.name == "time":
            check_time(numbers, column.unit, lambda i, column=column: place(column, i), drop_option, may_repeat)
        if not column.any_scale:
            mapping = f"[channels] {column.name} to unit = " + '"{unit}"'
            unit_place = mapping if column.mapped else f"the header to '{column.name} [{{unit}}]'"
            if column.source is not None and column.source.is_scaled:
                unit_place = ""
            peak = peaks[channel_of(column.name)]
            check_scale(numbers, column.name, column.unit, peak, lambda i, column=column: place(column, i), unit_place)
        if column.name in observed:
            check_changes(path, column, numbers)


def check_row_count(path: Path | str, rows: int) -> None:
    """Refuse a recording with a single row."""
    if rows < 2:
        raise InputError(f"{path}: the recording has a single row of data: record at least two")


def check_changes(path: Path | str, column: FileColumn, values: NDArray[np.float64]) -> None:
    """Refuse an observed channel that is constant.

    Args:
        path: The file, or the name of the object, for messages.
        column: Column of the channel.
        values: Values, shape ``(rows,)``, in the unit of the column.

    Raises:
        InputError: If all values are equal.
    """
    if values.min() == values.max():
        constant = f"the observed channel {column.name} is {values[0]:.15g} {column.unit} in all {len(values)} rows"
        cure = "check the sensor, or remove it from [fit] observe"
        message = f"{path}: column '{column.header}': {constant}: {cure}"
        raise InputError(message, code="constant-channel", cure=cure)


def check_time(
    time: NDArray[np.float64], unit: str, place: Callable[[int], str], drop_option: str, may_repeat: bool = False
) -> None:
    """Refuse time that does not increase.

    Args:
        time: Times, shape ``(rows,)``.
        unit: Their unit.
        place: Returns a text such as "file: row 5, column 'x'" for an index.
        drop_option: The option that leaves bad rows out, for messages.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Raises:
        InputError: If a time is not above the one before.
    """
    slips = np.flatnonzero(time_slips(time, may_repeat))
    if slips.size:
        i = int(slips[0]) + 1
        constant = f"does not increase at {time[i]:.15g}"
        problem = constant if time[i] == time[i - 1] else f"decreases from {time[i - 1]:.15g} to {time[i]:.15g}"
        sort = f"sort the rows by time, or leave such rows out with {drop_option}"
        code, cure = ("time-order", sort) if slips.size > _MAX_TIME_SLIPS else ("bad-row", repair_hint(drop_option))
        restarts = time_order(time, may_repeat).restarts
        if i in restarts and len(restarts) <= _MAX_RESTARTS:
            problem += f" {unit}, where the clock begins again"
            options = '--on-bad-rows split, or on_bad_rows = "split" under [recording] in the rig'
            cure = f"split the recording there with {options}"
            raise InputError(f"{place(i)}: time {problem}: {cure}", code="clock-restart", cure=cure)
        raise InputError(f"{place(i)}: time {problem} {unit}: {cure}", code=code, cure=cure)


def _peaks(columns: Sequence[FileColumn], values: Mapping[str, NDArray[np.float64]]) -> dict[str | None, float]:
    """Return the largest magnitude of each kind of channel, in its internal unit."""
    peaks: dict[str | None, float] = {}
    for column in columns:
        ends = np.array([values[column.name].min(), values[column.name].max()])
        peak = np.abs(to_si(ends, column.unit, channel_unit(column.name))).max()
        peaks[channel_of(column.name)] = max(peak, peaks.get(channel_of(column.name), 0.0))
    return peaks
