"""Steps of a converter in a log: those that never occur, and how long a reading stays on one."""

from __future__ import annotations

from experiments.common.base import Row

import numpy as np


def step_row(time: np.ndarray, values: np.ndarray, first: int, step: float, unit: str) -> Row:
    """Return a row on the steps of a log, and on how long the reading before a row stays on its own.

    Args:
        time: Times, s.
        values: Readings, whole multiples of the step.
        first: The row.
        step: The step.
        unit: Unit of the readings.
    """
    changes = np.flatnonzero(np.diff(values)) + 1
    begin, end = changes[changes < first], changes[changes >= first]
    stay = time[end[0] if len(end) else -1] - time[begin[-1] if len(begin) else 0]
    counts = np.unique(np.round(values / step).astype(int))
    absent = np.setdiff1d(np.arange(counts[0], counts[-1]), counts) * step
    names = ", ".join(f"{value:g}" for value in absent) or "none"
    text = f"the reading stays at {values[first - 1]:g} {unit} for {stay:.1f} s there; steps that never occur: {names}"
    return Row(f"readings about {time[first]:.0f} s", "-", text, None, {"stay_s": float(stay), "absent": list(absent)})
