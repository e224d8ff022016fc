"""The splits of a diagnosis: training, selection and holdout recordings, and which of their rows are scored."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from smajax.errors import InputError
from smajax.plant.stages import SURROUNDINGS
from smajax.recordings.recording import Recording

# Positions of the splits in ``DiagnosisProblem.splits``, and their names in documents.
TRAIN = 0
SELECT = 1
HOLDOUT = 2
SPLIT_NAMES = ("train", "select", "holdout")


class DataSplit(NamedTuple):
    """Recordings that serve one purpose: training, selection or holdout.

    Attributes:
        recordings: The recordings.
        scored: Boolean mask of the scored rows of each recording, shape ``(rows,)``; empty for all rows.
        anchor: Boolean mask of the rows of each recording to which its own parameters are fitted, where each recording
            has some and the split is not the training split; empty for the scored rows.
    """

    recordings: tuple[Recording, ...]
    scored: tuple[np.ndarray, ...] = ()
    anchor: tuple[np.ndarray, ...] = ()

    def rows(self) -> list[np.ndarray]:
        """Return the indices of the scored rows of each recording."""
        return [np.flatnonzero(mask) for mask in self.scored or (np.ones(len(r), bool) for r in self.recordings)]

    def anchor_rows(self) -> list[np.ndarray]:
        """Return the indices of the rows of each recording to which its own parameters are fitted."""
        return [np.flatnonzero(mask) for mask in self.anchor] or self.rows()


def check_complete(splits: Sequence[DataSplit], observe: Sequence[str]) -> None:
    """Check that all recordings have every observed channel at every row.

    Args:
        splits: The splits.
        observe: The observed channels.

    Raises:
        InputError: If a row of an observed channel is NaN.
    """
    for recording in (r for split in splits for r in split.recordings):
        gaps = [c for c in observe if not np.all(np.isfinite(recording.channels.get(c, 0.0)))]
        if gaps:
            raise InputError(
                f"{recording.name}: a diagnosis needs {gaps[0]} at every row: leave out the rows without a value"
            )


def changing_surroundings(splits: Sequence[DataSplit]) -> tuple[str, ...]:
    """Return the channels of the surroundings that every recording has and that change in a training recording.

    Args:
        splits: Training, selection and holdout split.
    """
    recordings = [r for split in splits for r in split.recordings]
    names = [name for name in SURROUNDINGS if all(name in r.channels for r in recordings)]
    return tuple(name for name in names if any(np.ptp(r.channels[name]) > 0.0 for r in splits[TRAIN].recordings))
