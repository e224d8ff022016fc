"""Checks of the values of a recording: number of rows, increasing time, changing sensors, plausible scales."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_of, channel_unit
from smajax.errors import InputError
from smajax.recordings.column_mapping import FileColumn
from smajax.recordings.readers.base import REPAIR_HINT
from smajax.recordings.unit_checks import check_scale
from smajax.units import to_si

# Number of rows with decreasing time up to which they count as single errors, and not as unsorted rows. Chosen by
# trial; tested in tests/unit/recordings/test_bad_recordings.py.
_MAX_TIME_SLIPS = 2

Place = Callable[[FileColumn, int], str]


def check_values(
    path: Path,
    columns: Sequence[FileColumn],
    values: Mapping[str, NDArray[np.float64]],
    observed: Sequence[str],
    place: Place,
) -> None:
    """Check the values of a recording.

    Args:
        path: The file, for messages.
        columns: Columns that are read.
        values: Arrays, shape ``(rows,)``, by channel, in the units of the file.
        observed: Channels that must change.
        place: Returns a text such as "file: row 5, column 'x'" for a column and an index.

    Raises:
        InputError: If there is a single row, time does not increase, a value is not plausible, or an observed channel
            is constant.
    """
    rows = len(values[columns[0].name])
    if rows < 2:
        raise InputError(f"{path}: the recording has a single row of data: record at least two")
    peaks = _peaks(columns, values)
    for column in columns:
        numbers = values[column.name]
        if column.name == "time":
            _check_time(column, numbers, place)
        if not column.any_scale:
            source = f"[channels] {column.name} to unit = " + '"{unit}"'
            cure = source if column.mapped else f"the header to '{column.name} [{{unit}}]'"
            peak = peaks[channel_of(column.name)]
            check_scale(numbers, column.name, column.unit, peak, lambda i, column=column: place(column, i), cure)
        if column.name in observed and numbers.min() == numbers.max():
            constant = f"the observed channel {column.name} is {numbers[0]:.15g} {column.unit} in all {rows} rows"
            cure = "check the sensor, or remove it from [fit] observe"
            raise InputError(f"{path}: column '{column.header}': {constant}: {cure}")


def _peaks(columns: Sequence[FileColumn], values: Mapping[str, NDArray[np.float64]]) -> dict[str | None, float]:
    """Return the largest magnitude of each kind of channel, in its internal unit."""
    peaks: dict[str | None, float] = {}
    for column in columns:
        ends = np.array([values[column.name].min(), values[column.name].max()])
        peak = np.abs(to_si(ends, column.unit, channel_unit(column.name))).max()
        peaks[channel_of(column.name)] = max(peak, peaks.get(channel_of(column.name), 0.0))
    return peaks


def _check_time(column: FileColumn, time: NDArray[np.float64], place: Place) -> None:
    """Refuse time that does not increase."""
    slips = np.flatnonzero(time[1:] <= time[:-1])
    if slips.size:
        i = int(slips[0]) + 1
        constant = f"does not increase at {time[i]:.15g}"
        problem = constant if time[i] == time[i - 1] else f"decreases from {time[i - 1]:.15g} to {time[i]:.15g}"
        sort = "sort the rows by time, or leave such rows out with --drop-bad-rows"
        cure = sort if slips.size > _MAX_TIME_SLIPS else REPAIR_HINT
        raise InputError(f"{place(column, i)}: time {problem} {column.unit}: {cure}")
