"""Formats of time stamps other than ISO 8601, tried one after the other."""

from collections.abc import Sequence

from smajax.recordings.read_options import ReadOptions
from smajax.recordings.readers.base import parse_number
from smajax.recordings.readers.time_stamps import find_stamps, is_like_stamp
from smajax.recordings.recognition.findings import Question

_CLOCKS = ("%H:%M:%S.%f", "%H:%M:%S", "%H:%M", "%I:%M:%S %p", "%I:%M:%S.%f %p", "%H:%M:%S,%f")
_DAYS_FIRST = ("%d.%m.%Y", "%d/%m/%Y", "%d-%m-%Y", "%d.%m.%y", "%d/%m/%y")
_OTHERS = ("%m/%d/%Y", "%Y/%m/%d", "%Y.%m.%d", "%m/%d/%y", "%Y%m%d")
_DATES = (*_DAYS_FIRST, *_OTHERS)
FORMATS = tuple(f"{date} {clock}" for date in _DATES for clock in _CLOCKS)
# Rows with stamps that have to be of one format.
_ROWS = 50


def find_time_format(
    rows: Sequence[Sequence[str]], options: ReadOptions, fixed: Sequence[str]
) -> tuple[ReadOptions, tuple[Question, ...]]:
    """Return the options with a format of time stamps, where there are stamps that are not recognised without.

    Args:
        rows: Texts of the cells of the first rows.
        options: Options of reading.
        fixed: Names of the options that the caller gave.
    """
    if "time_format" in fixed or options.sample_period is not None:
        return options, ()
    columns: dict[int, list[str]] = {}
    for cells in rows:
        for k, cell in enumerate(cells):
            is_other = is_like_stamp(cell) and not find_stamps([[cell]], None)
            if is_other and parse_number(cell, options.decimal) is None:
                columns.setdefault(k, []).append(cell)
    for stamps in columns.values():
        fitting = _fitting(stamps[-_ROWS:])
        if fitting and len(stamps) > 1:
            return options.replace(time_format=fitting[0]), _day_or_month(fitting, stamps[0])
    return options, ()


def _fitting(stamps: Sequence[str]) -> list[str]:
    """Return the formats that fit all stamps."""
    return [name for name in FORMATS if all(find_stamps([[stamp]], name) for stamp in stamps)]


def _day_or_month(fitting: Sequence[str], stamp: str) -> tuple[Question, ...]:
    """Return the question whether the day or the month comes first, where both are possible."""
    if len(fitting) < 2:
        return ()
    text = f"in '{stamp}' either the day or the month may come first, which matters only past midnight"
    return (Question("time_format", text, fitting[0], tuple(fitting[1:]), False, f"--time-format '{fitting[1]}'"),)
