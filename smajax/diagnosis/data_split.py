"""The recordings that serve one purpose in a diagnosis, and which of their rows are scored."""

from typing import NamedTuple

import numpy as np

from smajax.recordings.recording import Recording

# Positions of the splits in ``DiagnosisProblem.splits``, and their names in documents.
TRAIN = 0
SELECT = 1
HOLDOUT = 2
SPLIT_NAMES = ("train", "select", "holdout")


class DataSplit(NamedTuple):
    """Recordings that serve one purpose: training, selection or holdout.

    ``scored`` are boolean masks of the rows of each recording that are scored (default: all rows). Where every
    recording has parameters of its own, those of a recording outside of the training split are fitted to its rows
    ``anchor`` (default: the scored ones).
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
