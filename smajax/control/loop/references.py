"""References: the sampled course that a channel shall follow; arrays of shape ``(n,)`` in the channel's unit."""

from collections.abc import Sequence

import numpy as np

from smajax.errors import InputError

# Largest number of samples: a rollout needs about a kilobyte of memory for each, half a gigabyte in all.
_MAX_SAMPLES = 500_000
# Rounding errors of sample times, s, and of quotients of times.
_ROUNDING = 1e-9


def sample_times(duration: float, period: float) -> np.ndarray:
    """Return the times of the samples in s, from 0 to before ``duration``.

    Raises:
        InputError: if there are fewer than two samples, or too many.
    """
    count = round(duration / period)
    if not 2 <= count <= _MAX_SAMPLES:
        raise InputError(
            f"a duration of {duration:g} s has {count:,} samples of {period:g} s: make it 2 to {_MAX_SAMPLES:,}"
        )
    return np.arange(count) * period


def step(time: np.ndarray, low: float, high: float, at: float = 0.0) -> np.ndarray:
    """Return a step: ``low`` before ``at`` s, ``high`` from then on."""
    return np.where(time >= at - _ROUNDING, high, low)


def staircase(time: np.ndarray, levels: Sequence[float], hold: float) -> np.ndarray:
    """Return a staircase: each level for ``hold`` s, the last one to the end."""
    return np.asarray(levels, float)[np.minimum((time / hold + _ROUNDING).astype(int), len(levels) - 1)]


def sine(time: np.ndarray, low: float, high: float, frequency: float) -> np.ndarray:
    """Return a sine between ``low`` and ``high`` of ``frequency`` in Hz, beginning at ``low``."""
    return low + 0.5 * (high - low) * (1.0 - np.cos(2.0 * np.pi * frequency * time))


def recorded(time: np.ndarray, recorded_time: np.ndarray, values: np.ndarray) -> np.ndarray:
    """Return a recorded trajectory, interpolated linearly and held after the last row.

    Args:
        time: Times of the samples, s.
        recorded_time: Times of the recording's rows, s; they may begin anywhere.
        values: Values at the rows.
    """
    return np.interp(time, recorded_time - recorded_time[0], values)
