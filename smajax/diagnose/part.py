"""The recordings that serve one purpose in a diagnosis, and which of their rows count."""

from typing import NamedTuple

import numpy as np

from smajax.recording import Recording


class Part(NamedTuple):
    """Recordings that serve one purpose: training, selection or holdout.

    ``scored`` says which rows of each count (boolean arrays; default: all). Where every recording has parameters of its own, those of a
    recording that nothing else is fitted to are set on its rows ``anchor`` (default: those that count).
    """

    recordings: tuple[Recording, ...]
    scored: tuple[np.ndarray, ...] = ()
    anchor: tuple[np.ndarray, ...] = ()

    def rows(self) -> list[np.ndarray]:
        """Numbers of the rows of each recording that count."""
        return [np.flatnonzero(mask) for mask in self.scored or (np.ones(len(r), bool) for r in self.recordings)]

    def anchor_rows(self) -> list[np.ndarray]:
        """Numbers of the rows of each recording on which its own parameters are set."""
        return [np.flatnonzero(mask) for mask in self.anchor] or self.rows()
