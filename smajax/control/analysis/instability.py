"""Instability of a rollout: overflow, divergence from the reference, or oscillation that does not decay."""

import itertools
import math
from collections.abc import Iterator
from typing import Literal, NamedTuple

import numpy as np
from jaxtyping import Float

# RMS of the command's changes from sample to sample, as a share of its range, above which it does not settle. Chosen by
# trial on the wire of experiments/control/wire_position.py; tests/unit/control/test_control.py holds it.
_MAX_MOVES = 0.02
# Number of samples from which on a constant reference counts as a hold; chosen by trial.
_MIN_HOLD = 10
# Oscillations of less than this share of the reference's span count as settled; chosen by trial.
_MIN_SWING = 0.05
# Largest number of swings of a loop that settles, and the addition for each turning point of the reference. Chosen by
# trial; tests/unit/control/test_control.py holds them.
_SETTLING_SWINGS = 4
_SWINGS_PER_TURN = 4
# An oscillation is sustained if its last swings are more than this share of its first; chosen by trial.
_SUSTAINED = 0.7
# Distance from the reference in the last quarter of a rollout, in spans of the reference, above which a loop diverges.
_DIVERGED = 3.0


class Instability(NamedTuple):
    """Why a rollout counts as unstable.

    Attributes:
        code: Whether it has values that are not finite, it diverges from its reference, its command keeps changing
            from sample to sample, or it keeps oscillating about its reference.
        share: Size of the changes as a share of the command's range, or of the oscillation as a share of the
            reference's span; 0 for the other codes.
    """

    code: Literal["not_finite", "diverging", "changing_command", "oscillating"]
    share: float = 0.0


def instability_reason(
    command: Float[np.ndarray, "samples wires"],
    reference: Float[np.ndarray, " samples"],
    value: Float[np.ndarray, " samples"],
    command_range: float,
) -> Instability | None:
    """Return why a rollout without noise counts as unstable; ``None`` if it does not.

    The command has to settle in the second half of each hold of the reference; if the reference has no holds, changes
    of the command that reverse its direction have to be small. In both cases the channel must not oscillate about the
    reference without decay.

    Args:
        command: Commands, shape ``(n, wires)``.
        reference: Reference, shape ``(n,)``.
        value: Controlled channel, shape ``(n,)``, unit of the reference.
        command_range: Largest minus smallest allowed command; if it is infinite, the largest absolute command of the
            rollout is used instead.
    """
    if not (np.all(np.isfinite(value)) and np.all(np.isfinite(command))):
        return Instability("not_finite")
    span = float(np.ptp(np.append(reference, value[0]))) or 1.0
    last_quarter = slice(3 * len(value) // 4, None)
    if np.max(np.abs(value[last_quarter] - reference[last_quarter])) > _DIVERGED * span:
        return Instability("diverging")
    size = command_range if math.isfinite(command_range) else float(np.max(np.abs(command)))
    change = np.diff(command, axis=0, prepend=command[:1])
    settled_rows = _second_halves(reference)
    holds = bool(np.any(settled_rows))
    if not holds:
        reversals = change * np.roll(change, 1, axis=0) < 0.0
        change, settled_rows = np.where(reversals, change, 0.0), np.ones(len(value), bool)
    moves = float(np.sqrt(np.mean(change[settled_rows] ** 2))) / max(size, 1e-300)
    if moves > _MAX_MOVES:
        return Instability("changing_command", moves)
    parts = _settled_parts(reference, holds)
    swing = max((_sustained_swing(reference[part], value[part], _MIN_SWING * span) for part in parts), default=0.0)
    return Instability("oscillating", swing / span) if swing > 0.0 else None


def _settled_parts(reference: np.ndarray, holds: bool) -> Iterator[slice]:
    """All but the first quarter of each hold, or of the whole rollout if the reference has no holds."""
    for first, end in _holds(reference) if holds else [(0, len(reference))]:
        yield slice(first + (end - first) // 4, end)


def _sustained_swing(reference: np.ndarray, value: np.ndarray, min_swing: float) -> float:
    """Size of a sustained oscillation of a value about its reference; 0 if there is none.

    A sustained oscillation has more swings than a loop that settles, and its last swings are not much smaller than its
    first.
    """
    swings = swing_sizes(value - reference, min_swing)
    turns = len(swing_sizes(reference, min_swing))
    if len(swings) < _SETTLING_SWINGS + _SWINGS_PER_TURN * turns:
        return 0.0
    first, last = float(np.mean(swings[:2])), float(np.mean(swings[-2:]))
    return last if last > _SUSTAINED * first else 0.0


def swing_sizes(values: Float[np.ndarray, " samples"], min_swing: float) -> list[float]:
    """Return the distances between consecutive turning points, in the unit of ``values``.

    Args:
        values: Values at the samples, shape ``(n,)``.
        min_swing: Reversals of at most this size are ignored; unit of ``values``.
    """
    sizes: list[float] = []
    low = high = start = float(values[0])
    direction = 0
    for v in values.tolist():
        low, high = min(low, v), max(high, v)
        if direction >= 0 and high - v > min_swing:
            sizes += [high - start] if direction else []
            direction, start, low = -1, high, v
        elif direction <= 0 and v - low > min_swing:
            sizes += [start - low] if direction else []
            direction, start, high = 1, low, v
    return sizes


def _second_halves(reference: np.ndarray) -> np.ndarray:
    """Which samples lie in the second half of a hold."""
    rows = np.zeros(len(reference), bool)
    for first, end in _holds(reference):
        rows[(first + end + 1) // 2 : end] = True
    return rows


def _holds(reference: np.ndarray) -> Iterator[tuple[int, int]]:
    """First row of each hold, and the row after its last one."""
    edges = np.r_[0, np.flatnonzero(np.diff(reference)) + 1, len(reference)]
    yield from ((int(a), int(b)) for a, b in itertools.pairwise(edges) if b - a >= _MIN_HOLD)
