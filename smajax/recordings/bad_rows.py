"""Rows that cannot be used: those with an unreadable cell, and those in which time does not increase.

They are left out on request only, and counted in the notes; on request a recording is also split where its clock begins
again.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from smajax.channels import channel_of
from smajax.errors import InputError
from smajax.recordings.unit_checks import BOUND_ROUNDING
from smajax.units import to_si

# Rows that a note lists by number, followed by the number of the others; chosen to keep the note on one line.
_ROWS_LISTED = 5
# Share of bad rows above which a file is refused instead of repaired: most of the recording would be lost.
_MAX_BAD_SHARE = 0.5
# Rows that a part of a split recording needs: a single one has no duration.
_MIN_PART_ROWS = 2

Rows = NDArray[np.intp]


def good_rows(
    origin: Path | str, values: Mapping[str, NDArray[np.float64]], first_row: int, may_repeat: bool = False
) -> tuple[Rows | None, tuple[str, ...]]:
    """Return the rows to keep (``None`` for all) and notes on the others.

    Args:
        origin: The file, or the name of the object, for messages.
        values: Arrays, shape ``(rows,)``, by channel; NaN where a cell cannot be read.
        first_row: Number of the first row.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Raises:
        InputError: If most rows are bad.
    """
    readable = _readable(values)
    rows = rows_to_keep(readable, values.get("time"), may_repeat)
    if len(rows) == len(readable):
        return None, ()
    _refuse_mostly_bad(origin, rows, readable, first_row, values)
    notes = _notes(_left_out(readable, rows), len(readable), first_row, "dropped on request")
    return rows, notes


def rows_to_keep(readable: NDArray[np.bool_], time: NDArray[np.float64] | None, may_repeat: bool) -> Rows:
    """Return the rows that can be read and whose time is above those of all rows before.

    Args:
        readable: Whether each row can be read, shape ``(rows,)``.
        time: Times, shape ``(rows,)``; ``None`` without a clock.
        may_repeat: Whether a time may be that of the row before, as in a path.
    """
    rows = np.flatnonzero(readable)
    if time is None:
        return rows
    rows = rows[time_order(time[rows], may_repeat).good]
    return rows[_increases(time[rows], may_repeat)]


def split_rows(
    origin: Path | str, values: Mapping[str, NDArray[np.float64]], first_row: int, may_repeat: bool = False
) -> list[tuple[Rows | None, tuple[str, ...]]]:
    """Return the rows of each part of a recording, which is split where the clock begins again.

    Other bad rows are left out, as by ``good_rows``: the wire went on between the rows next to them, and each part of
    a recording has its own initial state.

    Args:
        origin: The file, or the name of the object, for messages.
        values: Arrays, shape ``(rows,)``, by channel; NaN where a cell cannot be read.
        first_row: Number of the first row.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Returns:
        Pairs of rows (``None`` for all) and notes.

    Raises:
        InputError: If most rows are bad, or no part has two rows.
    """
    readable = _readable(values)
    rows = np.flatnonzero(readable)
    parts, restarts = [rows], np.zeros(0, int)
    if "time" in values:
        time = values["time"]
        order = time_order(time[rows], may_repeat)
        restarts = rows[order.restarts]
        kept = rows[order.good]
        parts = np.split(kept, np.searchsorted(kept, restarts))
        parts = [part[_increases(time[part], may_repeat)] for part in parts]
    long = [part for part in parts if len(part) >= _MIN_PART_ROWS]
    single = np.concatenate([np.zeros(0, int), *(part for part in parts if len(part) < _MIN_PART_ROWS)]).astype(int)
    if len(long) == 1 and len(long[0]) == len(readable):
        return [(None, ())]
    _refuse_mostly_bad(origin, np.concatenate([*parts]), readable, first_row, values)
    if not long:
        raise InputError(f"{origin}: no part has two rows, the first of them row {first_row}: correct the time")
    counts = (
        *_notes(_left_out(readable, np.concatenate(parts)), len(readable), first_row, "left out on request"),
        *_notes({"in which the clock begins again": restarts}, len(readable), first_row, "begin a part"),
        *_notes({"are": single}, len(readable), first_row, "left out, since a part needs two rows"),
    )
    several = len(long) > 1
    return [
        (
            part,
            (*((f"part {k} of {len(long)}: rows {first_row + part[0]} to {first_row + part[-1]}",) * several), *counts),
        )
        for k, part in enumerate(long, 1)
    ]


@dataclass(frozen=True)
class TimeOrder:
    """Which times follow the one before.

    Attributes:
        good: Whether each row follows, shape ``(rows,)``; not for one that repeats a time, or whose time alone is too
            high or too low.
        restarts: Indices of rows at which the clock begins again.
    """

    good: NDArray[np.bool_]
    restarts: Rows


def time_order(time: NDArray[np.float64], may_repeat: bool) -> TimeOrder:
    """Return which times follow the one before, and where the clock begins again.

    Where time goes back, one row alone is wrong if the rows next to it are in order without it; otherwise the clock
    begins again.

    Args:
        time: Finite times, shape ``(rows,)``.
        may_repeat: Whether a time may be that of the row before, as in a path.
    """
    good = np.ones(len(time), bool)
    if not may_repeat:
        good[1:] = time[1:] != time[:-1]
    rows = np.flatnonzero(good)
    distinct = time[rows]
    restarts = []
    for k in np.flatnonzero(distinct[1:] < distinct[:-1]) + 1:
        if k + 1 == len(distinct) or distinct[k + 1] > distinct[k - 1]:
            good[rows[k]] = False
        elif k > 1 and distinct[k] > distinct[k - 2]:
            good[rows[k - 1]] = False
        else:
            restarts.append(rows[k])
    return TimeOrder(good, np.array(restarts, int))


def _increases(time: NDArray[np.float64], may_repeat: bool) -> NDArray[np.bool_]:
    """Return whether each time is above all times before, shape ``(rows,)``."""
    good = np.ones(len(time), bool)
    latest = np.maximum.accumulate(time)[:-1]
    good[1:] = (time[1:] >= latest) if may_repeat else (time[1:] > latest)
    return good


def _left_out(readable: NDArray[np.bool_], rows: Rows) -> dict[str, Rows]:
    """Return the rows that are not among those to keep, by their problem."""
    late = readable.copy()
    late[rows] = False
    return {
        "with a blank or unreadable cell": np.flatnonzero(~readable),
        "in which time does not increase": np.flatnonzero(late),
    }


def _notes(rows: Mapping[str, Rows], count: int, first_row: int, what: str) -> tuple[str, ...]:
    """Return a note on each kind of rows of which there are any."""
    return tuple(
        f"{len(bad)} of {count} rows {problem} {what}: row {_listed(bad, first_row)}"
        for problem, bad in rows.items()
        if len(bad)
    )


def _refuse_mostly_bad(
    origin: Path | str, rows: Rows, readable: NDArray[np.bool_], first_row: int, values: Mapping[str, Any]
) -> None:
    """Refuse a file of which most rows would be left out.

    Args:
        origin: The file, or the name of the object.
        rows: Rows to keep.
        readable: Whether each row can be read, shape ``(rows,)``.
        first_row: Number of the first row.
        values: Arrays by channel.

    Raises:
        InputError: If more than half of the rows are bad.
    """
    count = len(readable)
    if count - len(rows) <= _MAX_BAD_SHARE * count:
        return
    bad = np.ones(count, bool)
    bad[rows] = False
    problem = f"{count - len(rows)} of {count} rows are bad, the first of them row {first_row + int(np.argmax(bad))}"
    raise InputError(f"{origin}: {problem}, too many to drop: {_mostly_bad_cure(readable, values)}")


def time_slips(time: NDArray[np.float64], may_repeat: bool) -> NDArray[np.bool_]:
    """Return whether each row but the first is not later than the one before, shape ``(rows - 1,)``.

    Args:
        time: Times, shape ``(rows,)``.
        may_repeat: Whether the same time twice is no slip.
    """
    return time[1:] < time[:-1] if may_repeat else time[1:] <= time[:-1]


def impossible_values(channel: str, values: NDArray[np.float64], unit: str | None) -> NDArray[np.bool_]:
    """Return which values are impossible in every rig: a duty or a fan outside 0 to 1, as in a corrupt packet.

    Args:
        channel: The channel.
        values: Values, shape ``(rows,)``.
        unit: Their unit.
    """
    if channel_of(channel) not in ("duty", "fan"):
        return np.zeros(len(values), bool)
    numbers = to_si(values, unit or "1", "1")
    return (numbers < 0) | (numbers > 1 + BOUND_ROUNDING)


def _readable(values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    return np.all([np.isfinite(column) for column in values.values()], axis=0)


def _mostly_bad_cure(readable: NDArray[np.bool_], values: Mapping[str, Any]) -> str:
    """Return what to do where most rows are bad: the clock begins again, or is coarser than the rows."""
    time = values["time"][readable] if "time" in values else np.zeros(0)
    order = time_order(time, may_repeat=False)
    if len(order.restarts):
        return 'correct them, or set on_bad_rows = "split", since the clock begins again'
    if np.count_nonzero(time[1:] == time[:-1]) > _MAX_BAD_SHARE * len(readable):
        return "the time is coarser than the rows: leave its column out, and give sample_period, the time between rows"
    return "correct them"


def _listed(indices: Rows, first_row: int) -> str:
    row_numbers = ", ".join(str(first_row + i) for i in indices[:_ROWS_LISTED])
    return row_numbers + (f" and {len(indices) - _ROWS_LISTED} more" if len(indices) > _ROWS_LISTED else "")
