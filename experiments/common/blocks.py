"""Blocks of a dense log: the mean of the inputs and the median of the readings of some rows."""

from __future__ import annotations

import itertools
from collections.abc import Collection

import numpy as np

from smajax.recordings.recording import Recording


def block_rows(recording: Recording, rows: int, inputs: Collection[str]) -> Recording:
    """Return a recording with one row for each block of rows, without a look ahead.

    A row has the medians of the readings of the block before it, and the means of the inputs of the block after it,
    which are held until the next row, so that no heat of a short pulse is lost. The rows that do not fill a block at
    the end are left out.

    Args:
        recording: A recording with equally spaced rows; rows that were left out of it are missing in their block.
        rows: Number of rows of a block.
        inputs: Channels that are inputs.

    Returns:
        The first row, and one row for each whole block.
    """
    period = float(np.min(np.diff(recording.time)))
    block = ((recording.time - recording.time[0]) / period + 0.5).astype(int) // rows
    count = int(block[-1] + 1) if (recording.time[-1] - recording.time[0]) / period % rows > rows - 1.5 else block[-1]
    time = recording.time[0] + np.arange(count + 1) * rows * period
    ends = np.searchsorted(block, np.arange(count + 1))
    channels = {}
    for name, values in recording.channels.items():
        combine = np.mean if name in inputs else np.median
        combined = [combine(values[i:k]) if k > i else np.nan for i, k in itertools.pairwise(ends)]
        if name in inputs:  # a block without rows keeps the input of the one before
            combined = [v if np.isfinite(v) else combined[max(j - 1, 0)] for j, v in enumerate(combined)]
            channels[name] = np.append(combined, combined[-1])
        else:
            channels[name] = np.append(values[0], combined)
    return Recording.from_arrays(recording.name, time, channels, recording.units)
