"""Step responses and tracking errors of a rollout, from NumPy arrays of shape ``(n,)``."""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Share of a jump within which the response counts as settled: the usual 2 % band.
SETTLING_BAND = 0.02
# A reference that changes at more than this share of its samples has no jumps. Chosen by trial;
# tests/unit/control/test_control.py holds it.
_MAX_MOVING_SHARE = 0.1
# Shares of the jump between which the rise time is measured: the usual 10 to 90 %.
_RISE_START = 0.1
_RISE_END = 0.9


class Jumps(NamedTuple):
    """Jumps of a reference that is constant otherwise.

    Attributes:
        since_jump: Time since the last jump in s, shape ``(n,)``; 0 before the first.
        jump_size: Size of the last jump in the channel's unit, shape ``(n,)``; 0 before the first.
        rows: First row of each jump.
    """

    since_jump: np.ndarray
    jump_size: np.ndarray
    rows: tuple[int, ...]

    def segments(self) -> list[tuple[int, int]]:
        """Return the first row of each jump, and the row after the last one of the hold that follows it."""
        return list(zip(self.rows, (*self.rows[1:], len(self.since_jump))[: len(self.rows)], strict=True))


def find_jumps(reference: Float[np.ndarray, " samples"], initial_reference: float, period: float) -> Jumps:
    """Return the jumps of a reference; none if it changes at more than a tenth of its samples.

    Consecutive samples at which the reference changes are one jump, as between two rows of a recorded reference.

    Args:
        reference: Reference at the samples, shape ``(n,)``.
        initial_reference: Reference before the first sample.
        period: Time between samples, s.
    """
    change = np.diff(reference, prepend=initial_reference)
    moves = change != 0.0
    since_jump, jump_size = np.zeros(len(reference)), np.zeros(len(reference))
    if np.sum(moves) > _MAX_MOVING_SHARE * len(reference):
        return Jumps(since_jump, jump_size, ())
    starts = np.flatnonzero(moves & ~np.append(False, moves[:-1]))
    for row, end in zip(starts, np.append(starts, len(reference))[1:], strict=True):
        since_jump[row:end] = period * np.arange(end - row)
        jump_size[row:end] = reference[end - 1] - (reference[row] - change[row])
    rows = [int(row) for row in starts if jump_size[row] != 0.0]
    return Jumps(np.where(jump_size != 0.0, since_jump, 0.0), jump_size, tuple(rows))


class StepResponse(NamedTuple):
    """Response to one jump.

    Attributes:
        rise: Rise time from 10 to 90 % in s; infinite if 90 % is not reached.
        settling: Settling time in s; infinite if the last sample is outside the band.
        overshoot: Overshoot as a share of the jump; 0 if there is none.
    """

    rise: float
    settling: float
    overshoot: float


def step_responses(
    value: Float[np.ndarray, " samples"],
    reference: Float[np.ndarray, " samples"],
    jumps: Jumps,
    period: float,
    band: float = SETTLING_BAND,
) -> list[StepResponse]:
    """Return the response to each jump, with linear interpolation between samples.

    Args:
        value: Channel at the samples, shape ``(n,)``.
        reference: Reference at the samples, shape ``(n,)``.
        jumps: Jumps of the reference.
        period: Time between samples, s.
        band: Settling band as a share of the jump.
    """
    responses = []
    for first, end in jumps.segments():
        share = 1.0 + (value[first:end] - reference[end - 1]) / jumps.jump_size[first]
        rise = _first_row_above(share, _RISE_END) - _first_row_above(share, _RISE_START)
        settling = settling_row(share - 1.0, band)
        responses.append(StepResponse(rise * period, settling * period, max(float(np.max(share)) - 1.0, 0.0)))
    return responses


def settling_row(share: Float[np.ndarray, " rows"], band: float) -> float:
    """Return the row, interpolated linearly, from which on ``|share| <= band``; infinite if the last row is outside.

    Args:
        share: Error over the jump, dimensionless, shape ``(n,)``.
        band: Settling band as a share of the jump.
    """
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


def _first_row_above(share: np.ndarray, level: float) -> float:
    above = np.flatnonzero(share >= level)
    if not len(above):
        return float("inf")
    k = int(above[0])
    return float(k) if k == 0 else k - 1 + (level - share[k - 1]) / (share[k] - share[k - 1])


def tracking_errors(
    value: Float[np.ndarray, " samples"], reference: Float[np.ndarray, " samples"], period: float
) -> dict[str, float]:
    """Return RMSE, largest absolute error and ITAE (integral of time times absolute error) of a rollout.

    Args:
        value: Channel at the samples, shape ``(n,)``.
        reference: Reference at the samples, shape ``(n,)``, same unit.
        period: Time between samples, s.

    Returns:
        ``rmse`` and ``max_error`` in the channel's unit, ``itae`` in the channel's unit times s^2.
    """
    error = value - reference
    time = period * np.arange(len(error))
    return {
        "rmse": float(np.sqrt(np.mean(error**2))),
        "max_error": float(np.max(np.abs(error))),
        "itae": float(np.sum(time * np.abs(error)) * period),
    }
