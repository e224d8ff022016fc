"""Rows that cannot be used: those with an unreadable cell, and those in which time does not increase.

They are left out, or the recording is split there, on request only, and counted in the notes.
"""

from collections.abc import Mapping
from pathlib import Path

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
    good = readable.copy()
    if "time" in values:
        time = np.where(readable, values["time"], -np.inf)
        latest = np.maximum.accumulate(time)[:-1]
        good[1:] &= (time[1:] >= latest) if may_repeat else (time[1:] > latest)
    if good.all():
        return None, ()
    if np.count_nonzero(~good) > _MAX_BAD_SHARE * len(good):
        bad_rows = f"{np.count_nonzero(~good)} of {len(good)} rows are bad"
        first = f"the first of them row {first_row + int(np.argmin(good))}"
        raise InputError(
            f"{origin}: {bad_rows}, {first}, too many to drop: correct them{_split_hint(readable, values)}"
        )
    notes = []
    for problem, bad in (
        ("with a blank or unreadable cell", ~readable),
        ("in which time does not increase", readable & ~good),
    ):
        if bad.any():
            row_numbers = _listed(np.flatnonzero(bad), first_row)
            notes.append(f"{np.count_nonzero(bad)} of {len(good)} rows {problem} dropped on request: row {row_numbers}")
    return np.flatnonzero(good), tuple(notes)


def split_rows(
    origin: Path | str, values: Mapping[str, NDArray[np.float64]], first_row: int, may_repeat: bool = False
) -> list[tuple[Rows | None, tuple[str, ...]]]:
    """Return the rows of each part of a recording, split where a row cannot be read or time does not increase.

    Args:
        origin: The file, or the name of the object, for messages.
        values: Arrays, shape ``(rows,)``, by channel; NaN where a cell cannot be read.
        first_row: Number of the first row.
        may_repeat: Whether a time may be that of the row before, as in a path.

    Returns:
        Pairs of rows (``None`` for all) and notes; a row that does not increase in time begins the next part.

    Raises:
        InputError: If no part has two rows.
    """
    readable = _readable(values)
    begins = np.zeros(len(readable), bool)
    begins[1:] = ~readable[:-1]
    restarts = np.zeros(len(readable), bool)
    if "time" in values:
        restarts[1:] = readable[1:] & readable[:-1] & time_slips(values["time"], may_repeat)
    rows = np.flatnonzero(readable)
    parts = [part for part in np.split(rows, np.flatnonzero((begins | restarts)[rows][1:]) + 1) if len(part)]
    long = [part for part in parts if len(part) >= _MIN_PART_ROWS]
    if not long:
        problem = f"no two rows follow each other without a bad one, the first of them row {first_row}"
        raise InputError(f"{origin}: {problem}: correct them")
    if len(long) == 1 and len(long[0]) == len(readable):
        return [(None, ())]
    single = np.array([part[0] for part in parts if len(part) < _MIN_PART_ROWS], int)
    counts = [
        f"{len(bad)} of {len(readable)} rows {problem}: row {_listed(bad, first_row)}"
        for problem, bad in (
            ("with a blank or unreadable cell left out, and the recording split there", np.flatnonzero(~readable)),
            ("in which time does not increase begin a part", np.flatnonzero(restarts)),
            ("left out, since a part needs two rows", single),
        )
        if len(bad)
    ]
    return [
        (part, (f"part {k} of {len(long)}: rows {first_row + part[0]} to {first_row + part[-1]}", *counts))
        for k, part in enumerate(long, 1)
    ]


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


def is_restart(time: NDArray[np.float64], row: int) -> bool:
    """Return whether the clock begins again at a row: time goes back, and goes on from there.

    Args:
        time: Times, shape ``(rows,)``.
        row: Index of a row whose time is below the one before.
    """
    later = time[row : row + 2]
    return len(later) == 2 and time[row - 1] > later[1] > later[0]


def _readable(values: Mapping[str, NDArray[np.float64]]) -> NDArray[np.bool_]:
    return np.all([np.isfinite(column) for column in values.values()], axis=0)


def _split_hint(readable: NDArray[np.bool_], values: Mapping[str, NDArray[np.float64]]) -> str:
    """Return the advice to split where most rows are bad because the clock begins again."""
    time = values["time"][readable] if "time" in values else np.zeros(0)
    slips = np.flatnonzero(time[1:] <= time[:-1]) + 1
    restarts = any(is_restart(time, int(row)) for row in slips[:_ROWS_LISTED])
    return ', or set on_bad_rows = "split", since the clock begins again' if restarts else ""


def _listed(indices: Rows, first_row: int) -> str:
    row_numbers = ", ".join(str(first_row + i) for i in indices[:_ROWS_LISTED])
    return row_numbers + (f" and {len(indices) - _ROWS_LISTED} more" if len(indices) > _ROWS_LISTED else "")
