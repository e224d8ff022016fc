"""Rows of a file that cannot be used: how many, of what kind, and what is done with them."""

from collections.abc import Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from smajax.recordings.bad_rows import impossible_values, rows_to_keep, time_order
from smajax.recordings.recognition.column_choice import ColumnChoice
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.value_ranges import Floats


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
    repeated, late, restarts = _time_slips(time, unreadable | impossible)
    kinds = (
        (unreadable, "have a cell that cannot be read"),
        (impossible, "have a duty outside 0 to 1"),
        (repeated, "repeat the time of the row before"),
        (late, "are out of order in time"),
        (restarts, "are those in which the clock begins again"),
    )
    sentences = [
        f"{np.count_nonzero(bad)} of {len(bad)} rows {what}, the first in row {first_row + int(np.argmax(bad))}"
        for bad, what in kinds
        if bad.any()
    ]
    if not sentences:
        return None
    text = "; ".join(sentences)
    if not restarts.any():
        return Question("on_bad_rows", text, "drop", ("refuse",), False, "--on-bad-rows refuse")
    dropped = len(unreadable) - len(rows_to_keep(~(unreadable | impossible), time, may_repeat=False))
    text += f"; split begins a recording where the clock begins again, drop would leave out {dropped} rows"
    return Question("on_bad_rows", text, "split", ("drop", "refuse"), False, "--on-bad-rows drop")


def _time_slips(
    time: Floats | None, bad: NDArray[np.bool_]
) -> tuple[NDArray[np.bool_], NDArray[np.bool_], NDArray[np.bool_]]:
    """Return which rows repeat the time before, which are out of order, and which begin the clock again."""
    repeated, late, restarts = np.zeros((3, len(bad)), bool)
    if time is None:
        return repeated, late, restarts
    rows = np.flatnonzero(~bad)
    order = time_order(time[rows], may_repeat=False)
    repeated[rows[1:][np.diff(time[rows]) == 0]] = True
    late[rows[~order.good]] = True
    restarts[rows[order.restarts]] = True
    return repeated, late & ~repeated, restarts
