"""Corrupt packets of a logger: single rows of a large input, and whether the wire was heated by them."""

from __future__ import annotations

from experiments.common.base import Row

import numpy as np

from smajax.recordings.recording import Recording

BEFORE = (-2.0, -0.2)  # s about a packet between which the reading before it is taken
AFTER = (0.4, 0.8)  # s between which that after it is taken
SIZES = {"a full register": (1.0, 1.0), "40 to 50 % of it": (0.38, 0.5)}  # smallest and largest duty of a row
IDLE = 0.005  # largest duty of an idle row


def packet_rows(log: Recording, rows: slice) -> list[Row]:
    """Return the rise of the temperature reading at single rows of a large duty between idle ones.

    Args:
        log: The log with all of its rows.
        rows: The rows to look at.
    """
    time, duty, reading = log.time[rows], log.channels["duty"][rows], log.channels["temperature"][rows]
    single = np.zeros(len(duty), bool)
    single[1:-1] = (duty[:-2] <= IDLE) & (duty[2:] <= IDLE)
    result = []
    for what, (low, high) in SIZES.items():
        rises = []
        for k in np.flatnonzero(single & (duty >= low) & (duty <= high)):
            windows = [(time >= time[k] + a) & (time <= time[k] + b) for a, b in (BEFORE, AFTER)]
            if all(np.any(window) for window in windows):
                rises.append(float(np.median(reading[windows[1]]) - np.median(reading[windows[0]])))
        if rises:
            text = f"the reading rises by {np.mean(rises):.2f} K within {AFTER[1]} s, {len(rises)} packets"
            numbers = {"rise_K": float(np.mean(rises)), "deviation_K": float(np.std(rises)), "count": len(rises)}
            result.append(
                Row(f"{log.name}: single rows of {what}, second half", "above 0", text, np.mean(rises) > 0, numbers)
            )
    return result
