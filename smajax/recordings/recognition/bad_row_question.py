"""Rows of a file that cannot be used: how many, of what kind, and what is done with them."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from smajax.recordings.bad_rows import impossible_values, is_restart
from smajax.recordings.recognition.column_choice import ColumnChoice
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.value_ranges import Floats

# Rows with unreadable cells, or repeated times, that may be at the ends of parts where a recording is split at a clock
# that begins again; with more of them the parts would be single rows.
_FEW = 20


def bad_row_question(choices: Sequence[ColumnChoice], values: Mapping[int, Floats], first_row: int) -> Question | None:
    """Return the question what is done with bad rows; ``None`` where every row is good.

    Args:
        choices: What each column is taken for.
        values: Values, shape ``(rows,)``, by the number of the column.
        first_row: Number of the first row of data.
    """
    chosen = [choice for choice in choices if choice.channel is not None]
    unreadable = np.any([~np.isfinite(values[choice.index]) for choice in chosen], axis=0)
    impossible = np.zeros(len(unreadable), bool)
    for choice in chosen:
        if choice.source is not None and choice.channel is not None:
            impossible |= impossible_values(
                choice.channel, choice.source.scaled(values[choice.index]), choice.source.unit
            )
    impossible &= ~unreadable
    time = next((values[choice.index] for choice in chosen if choice.channel == "time"), None)
    repeated, reset, restarts = _time_slips(time, unreadable | impossible)
    kinds = (
        (unreadable, "have a cell that cannot be read"),
        (impossible, "have a duty outside 0 to 1"),
        (repeated, "repeat the time of the row before"),
        (reset, "go back in time"),
    )
    sentences = [
        f"{np.count_nonzero(bad)} of {len(bad)} rows {what}, the first in row {first_row + int(np.argmax(bad))}"
        for bad, what in kinds
        if bad.any()
    ]
    if not sentences:
        return None
    others = np.count_nonzero(unreadable | impossible | repeated)
    split = restarts > 0 and others <= _FEW
    choice, other = ("split", "drop") if split else ("drop", "split")
    text = "; ".join(sentences)
    if reset.any():
        text += (
            f"; drop would leave out {_drop_count(time, unreadable | impossible)} rows, split begins a recording there"
        )
    return Question("on_bad_rows", text, choice, (other, "refuse"), False, f"--on-bad-rows {other}")


def _drop_count(time: Floats | None, bad: NDArray[np.bool_]) -> int:
    """Return the number of rows that are left out where every time has to be above all earlier ones."""
    if time is None:
        return int(np.count_nonzero(bad))
    highest = np.maximum.accumulate(np.where(bad, -np.inf, time))
    late = np.zeros(len(bad), bool)
    late[1:] = time[1:] <= highest[:-1]
    return int(np.count_nonzero(bad | late))


def _time_slips(time: Floats | None, bad: NDArray[np.bool_]) -> tuple[NDArray[np.bool_], NDArray[np.bool_], int]:
    """Return which rows repeat the time before, which go back, and the number of restarts of the clock."""
    repeated, reset = np.zeros(len(bad), bool), np.zeros(len(bad), bool)
    if time is None:
        return repeated, reset, 0
    rows = np.flatnonzero(~bad)
    steps = np.diff(time[rows])
    repeated[rows[1:][steps == 0]] = True
    reset[rows[1:][steps < 0]] = True
    return repeated, reset, sum(is_restart(time[rows], int(k) + 1) for k in np.flatnonzero(steps < 0))
