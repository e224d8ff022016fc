"""References: sampled trajectories that a channel is to follow, in the channel's unit."""

from collections.abc import Sequence

import numpy as np
from jaxtyping import Float

from smajax.errors import InputError

# Largest number of samples: a rollout needs about a kilobyte of memory for each, half a gigabyte in all.
_MAX_SAMPLES = 500_000
# Tolerance for rounding errors of sample times, s, and of quotients of times: double precision rounds numbers up to 1e5
# to 1e-11.
_ROUNDING = 1e-9


def sample_times(duration: float, period: float) -> Float[np.ndarray, " samples"]:
    """Return the times of the samples in s, from 0 to before ``duration``.

    Args:
        duration: Duration, s; rounded to whole periods.
        period: Period of the samples, s.

    Raises:
        InputError: if there are fewer than two samples, or too many.
    """
    count = round(duration / period)
    if not 2 <= count <= _MAX_SAMPLES:
        raise InputError(
            f"a duration of {duration:g} s has {count:,} samples of {period:g} s: make it 2 to {_MAX_SAMPLES:,}"
        )
    return np.arange(count) * period


def step(
    time: Float[np.ndarray, " samples"], low: float, high: float, at: float = 0.0
) -> Float[np.ndarray, " samples"]:
    """Return a step.

    Args:
        time: Times of the samples, s.
        low: Value before the step.
        high: Value from the step on.
        at: Time of the step, s.
    """
    return np.where(time >= at - _ROUNDING, high, low)


def staircase(
    time: Float[np.ndarray, " samples"], levels: Sequence[float], hold: float
) -> Float[np.ndarray, " samples"]:
    """Return a staircase.

    Args:
        time: Times of the samples, s.
        levels: Values of the stairs in their order; the last one is held to the end.
        hold: Duration of each stair, s.
    """
    return np.asarray(levels, float)[np.minimum((time / hold + _ROUNDING).astype(int), len(levels) - 1)]


def sine(
    time: Float[np.ndarray, " samples"], low: float, high: float, frequency: float
) -> Float[np.ndarray, " samples"]:
    """Return a sine that begins at its lowest value.

    Args:
        time: Times of the samples, s.
        low: Lowest value.
        high: Highest value.
        frequency: Frequency, Hz.
    """
    return low + 0.5 * (high - low) * (1.0 - np.cos(2.0 * np.pi * frequency * time))


def recorded(
    time: Float[np.ndarray, " samples"], recorded_time: Float[np.ndarray, " rows"], values: Float[np.ndarray, " rows"]
) -> Float[np.ndarray, " samples"]:
    """Return a recorded trajectory, interpolated linearly and held after the last row.

    Args:
        time: Times of the samples, s.
        recorded_time: Times of the rows of the recording, s; the first one counts as 0.
        values: Values at the rows.
    """
    return np.interp(time, recorded_time - recorded_time[0], values)
