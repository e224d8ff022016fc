"""Check that training and holdout recordings do not share rows."""

from collections.abc import Sequence

import numpy as np

from smajax.errors import InputError
from smajax.recordings.recording import Recording

# Rows of a block that is compared as a whole; chosen by trial, tested in tests/unit/diagnosis/test_diagnosis.py.
_BLOCK_ROWS = 20
# Share of common blocks above which a recording counts as a copy; chosen by trial.
_MAX_SHARED = 0.5


def refuse_copies(recordings: Sequence[Recording]) -> None:
    """Refuse a recording that repeats an earlier one, since it is not an independent test.

    Raises:
        InputError: If a recording has the content, or most of the rows, of an earlier one.
    """
    for k, recording in enumerate(recordings):
        for earlier in recordings[:k]:
            overlap = ""
            if has_same_content(recording, earlier):
                overlap = "has the same content as"
            elif _shared_blocks(recording, earlier) > _MAX_SHARED:
                overlap = "has rows of"
            if overlap:
                cure = "name a recording of another input, since a copy is not an independent test"
                raise InputError(f"{recording.name} {overlap} {earlier.name}: {cure}")


def has_same_content(recording: Recording, other: Recording) -> bool:
    """Return whether two recordings have the same rows of the same file or table.

    Two parts of one file have its SHA-256 and other times, two of its sheets other values.
    """
    if not recording.sha256 or recording.sha256 != other.sha256 or not np.array_equal(recording.time, other.time):
        return False
    common = recording.channels.keys() & other.channels.keys()
    return all(np.array_equal(recording.channels[c], other.channels[c], equal_nan=True) for c in common)


def _shared_blocks(recording: Recording, other: Recording) -> float:
    """Return the fraction of the blocks of a recording that another one also has, without blocks of constant rows."""
    names = [c for c in recording.channels if c in other.channels]
    rows, other_rows = (np.column_stack([r.channels[c] for c in names]) for r in (recording, other))
    other_blocks = {other_rows[k : k + _BLOCK_ROWS].tobytes() for k in range(len(other_rows) - _BLOCK_ROWS + 1)}
    blocks = [rows[k : k + _BLOCK_ROWS] for k in range(0, len(rows) - _BLOCK_ROWS + 1, _BLOCK_ROWS)]
    shared = [block.tobytes() in other_blocks for block in blocks if np.ptp(block, axis=0).any()]
    return float(np.mean(shared)) if shared else 0.0
