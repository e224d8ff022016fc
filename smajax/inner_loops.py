"""Loops within a branch of a thermal cycle: where the temperature turns back, further than noise takes it, and comes again.

An alloy remembers where it turned and goes on from there, so that the branch without a loop is as if it had not been. Noise, too, takes a
thermometer back and forth: it is averaged over as many rows as keep a loop visible, and what goes back has to go further than the averages
scatter.
"""

import numpy as np
from scipy.ndimage import uniform_filter1d

from smajax.errors import InputError

_LEAST = 0.5  # K
_QUANTA = 2.0  # steps of the thermometer
_OF_NOISE = 9.0  # standard deviations of the averaged temperatures
_WANTED = 0.01  # of the branch's temperatures: noise is averaged down to what hides no larger loop than this
_ROWS = 24  # averages that a branch has at least
_NINE_TENTHS, _HALF, _SECOND = 1.645, 0.6745, 6.0**0.5  # so many normal deviates are less; what second differences multiply noise by
_SHARED = 0.5  # of the rows: fewer different temperatures are those of a coarse thermometer
_ABRUPT = 0.8  # of a loop's depth
_BLOCK = 5  # rows that run backwards, at least


def inner_loops(temperature: np.ndarray, branch: np.ndarray) -> list[tuple[int, int]]:
    """First and last rows of the loops among the rows ``branch`` (m,) of temperatures (n,).

    Raises ``InputError`` where the temperature comes again in one jump: such rows run backwards.
    """
    raw = temperature[branch] if temperature[branch[-1]] > temperature[branch[0]] else -temperature[branch]
    noise = _noise(raw)
    rows = _averaged(noise, raw)
    way = uniform_filter1d(raw, rows, mode="nearest")
    back = np.maximum.accumulate(way) - way
    least = max(_LEAST, _QUANTA * _quantum(raw), _OF_NOISE * max(noise / np.sqrt(rows), scatter(way, rows) if noise > 0.0 else 0.0))
    edges = np.flatnonzero(np.diff(np.r_[False, back > 0.0, False]))
    spans = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    found = [(a, b) for a, b in spans if np.max(back[a : b + 1]) > least]
    for a, b in found:
        depth = float(np.max(back[a : b + 1]))
        if rows == 1 and b - a >= _BLOCK and b + 1 < len(raw) and back[b] > _ABRUPT * depth:
            told = f"rows {branch[a] + 1} to {branch[b] + 1} go back by {depth:.3g} K, and the next one is there again at once"
            raise InputError(f"{told}: rows are missing, or not in the order in which they were recorded; sort them by time")
    beside = rows // 2  # averages turn so much earlier and later
    return [(int(branch[max(a - beside, 0)]), int(branch[min(b + beside, len(raw) - 1)])) for a, b in found]


def _noise(raw: np.ndarray) -> float:
    """Standard deviation from row to row (K) of temperatures that rise but for noise and loops; none where at most one row goes back."""
    if np.sum(np.diff(raw) < 0.0) < 2:
        return 0.0
    return float(np.quantile(np.abs(np.diff(raw, 2)), 0.9)) / (_NINE_TENTHS * _SECOND)


def _averaged(noise: float, raw: np.ndarray) -> int:
    """An odd number of rows over which noise is averaged."""
    wanted = (_OF_NOISE * noise / (_WANTED * float(np.ptp(raw)))) ** 2
    return 2 * int(min(wanted, len(raw) / _ROWS) / 2.0) + 1


def scatter(way: np.ndarray, rows: int) -> float:
    """Standard deviation of values (n,) averaged over ``rows``: more than the noise's share of it where noise goes together."""
    bent = way[: -2 * rows] - 2.0 * way[rows:-rows] + way[2 * rows :]
    return float(np.median(np.abs(bent))) / (_HALF * _SECOND)


def _quantum(raw: np.ndarray) -> float:
    """The thermometer's step (K), where temperatures are so coarse that most rows share theirs with another; else none."""
    found = np.unique(raw)
    return float(np.min(np.diff(found))) if 1 < len(found) < _SHARED * len(raw) else 0.0
