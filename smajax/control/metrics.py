"""What a rollout is judged by: numbers for people, from arrays of shape ``(n,)``."""

from typing import NamedTuple

import numpy as np

BAND = 0.02  # of a step's size, within which it counts as settled


class Jumps(NamedTuple):
    """Where the reference jumps and holds: at each sample the time since the last jump (s) and that jump's size; 0 before the first."""

    since: np.ndarray
    size: np.ndarray
    rows: tuple[int, ...]

    def ends(self) -> list[tuple[int, int]]:
        """First row of each jump and the row after its hold's last."""
        return list(zip(self.rows, (*self.rows[1:], len(self.since))[: len(self.rows)], strict=True))


def jumps(reference: np.ndarray, before: float, period: float) -> Jumps:
    """The jumps of a reference that holds otherwise; none of one that moves at more than a tenth of its samples.

    Samples on end at which it moves, as a recorded reference does from one of its rows to the next, are one jump.
    """
    change = np.diff(reference, prepend=before)
    moves = change != 0.0
    since, size = np.zeros(len(reference)), np.zeros(len(reference))
    if np.sum(moves) > 0.1 * len(reference):
        return Jumps(since, size, ())
    at = np.flatnonzero(moves & ~np.append(False, moves[:-1]))
    for row, end in zip(at, np.append(at, len(reference))[1:], strict=True):
        since[row:end] = period * np.arange(end - row)
        size[row:end] = reference[end - 1] - (reference[row] - change[row])
    kept = [int(row) for row in at if size[row] != 0.0]
    return Jumps(np.where(size != 0.0, since, 0.0), size, tuple(kept))


class Answer(NamedTuple):
    """How a loop answers a jump: rise 10 to 90 % and settling within ``BAND`` in s (infinite: not by the end), overshoot as a share."""

    rise: float
    settling: float
    overshoot: float


def answers(value: np.ndarray, reference: np.ndarray, found: Jumps, period: float, band: float = BAND) -> list[Answer]:
    """One for each jump; between samples the value goes straight."""
    told = []
    for first, end in found.ends():
        share = 1.0 + (value[first:end] - reference[end - 1]) / found.size[first]
        rise = _first(share, 0.9) - _first(share, 0.1)
        told.append(Answer(rise * period, settled(share - 1.0, band) * period, max(float(np.max(share)) - 1.0, 0.0)))
    return told


def settled(share: np.ndarray, band: float) -> float:
    """The row, between rows by a straight line, from which on ``|share| <= band``; infinite if the last row is outside."""
    outside = np.flatnonzero(~(np.abs(share) <= band))
    if not len(outside):
        return 0.0
    k = int(outside[-1])
    if k == len(share) - 1:
        return float("inf")
    a, b = abs(share[k]), abs(share[k + 1])
    if share[k] * share[k + 1] < 0.0:
        b = -b
    return k + (a - band) / (a - b)


def _first(share: np.ndarray, level: float) -> float:
    above = np.flatnonzero(share >= level)
    if not len(above):
        return float("inf")
    k = int(above[0])
    return float(k) if k == 0 else k - 1 + (level - share[k - 1]) / (share[k] - share[k - 1])


def tracking(value: np.ndarray, reference: np.ndarray, period: float) -> dict[str, float]:
    """RMSE, largest error and ITAE (integral of time times absolute error) in the channel's unit."""
    error = value - reference
    time = period * np.arange(len(error))
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "max_error": float(np.max(np.abs(error))),
        "itae": float(np.sum(time * np.abs(error)) * period),
    }
