"""Recordings that share rows: training and holdout data must differ."""

from collections.abc import Sequence

import numpy as np

from smajax.errors import InputError
from smajax.recordings.recording import Recording

# Rows that are compared together; chosen by trial, tests/unit/diagnosis/test_diagnosis.py
# holds it.
_BLOCK_ROWS = 20
# Share of such blocks above which a recording counts as a copy; chosen by trial.
_MAX_SHARED = 0.5


def refuse_copies(recordings: Sequence[Recording]) -> None:
    """Refuse a recording that repeats an earlier one, since it tests nothing.

    Raises:
        InputError: if a recording has the content, or most of the rows, of one before it.
    """
    for k, recording in enumerate(recordings):
        for earlier in recordings[:k]:
            what = ""
            if recording.sha256 == earlier.sha256:
                what = "has the same content as"
            elif _shared_blocks(recording, earlier) > _MAX_SHARED:
                what = "has rows of"
            if what:
                cure = "give another recording, of another input"
                raise InputError(f"{recording.name} {what} {earlier.name}: it tests nothing; {cure}")


def _shared_blocks(recording: Recording, other: Recording) -> float:
    """Return the share of the recording's blocks (those in which something changes) that the other one has, too."""
    names = [c for c in recording.channels if c in other.channels]
    rows, other_rows = (np.column_stack([r.channels[c] for c in names]) for r in (recording, other))
    other_blocks = {other_rows[k : k + _BLOCK_ROWS].tobytes() for k in range(len(other_rows) - _BLOCK_ROWS + 1)}
    blocks = [rows[k : k + _BLOCK_ROWS] for k in range(0, len(rows) - _BLOCK_ROWS + 1, _BLOCK_ROWS)]
    shared = [block.tobytes() in other_blocks for block in blocks if np.ptp(block, axis=0).any()]
    return float(np.mean(shared)) if shared else 0.0
