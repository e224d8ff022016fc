"""References: what the channel should do, sampled; arrays of shape ``(n,)`` in the channel's unit."""

from collections.abc import Sequence

import numpy as np

from smajax.errors import InputError

# A rollout remembers about a kilobyte for each.
_MOST = 500_000


def clock(duration: float, period: float) -> np.ndarray:
    """Times of the samples in s, from 0 to before ``duration``. Raises ``InputError`` if there are fewer than two, or too many."""
    count = round(duration / period)
    if not 2 <= count <= _MOST:
        raise InputError(f"a duration of {duration:g} s has {count:,} samples of {period:g} s: make it 2 to {_MOST:,}")
    return np.arange(count) * period


def step(time: np.ndarray, low: float, high: float, at: float = 0.0) -> np.ndarray:
    """``low`` before ``at`` s, ``high`` from then on."""
    return np.where(time >= at - 1e-9, high, low)


def staircase(time: np.ndarray, levels: Sequence[float], hold: float) -> np.ndarray:
    """Each level for ``hold`` s, the last to the end."""
    return np.asarray(levels, float)[np.minimum((time / hold + 1e-9).astype(int), len(levels) - 1)]


def sine(time: np.ndarray, low: float, high: float, frequency: float) -> np.ndarray:
    """From ``low`` to ``high`` and back ``frequency`` times a second, beginning at ``low``."""
    return low + 0.5 * (high - low) * (1.0 - np.cos(2.0 * np.pi * frequency * time))


def recorded(time: np.ndarray, known: np.ndarray, values: np.ndarray) -> np.ndarray:
    """A recorded trajectory ``values`` at the times ``known``, straight between its rows and held after the last."""
    return np.interp(time, known - known[0], values)
