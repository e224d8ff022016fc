"""Generalised Prandtl-Ishlinskii operator by its definition: each play for a rising or falling input.

    rising    F_r = max(g_l(v) - r, F_r)        falling    F_r = min(g_r(v) + r, F_r)        y = p_0 g_l(v) + sum p F_r

(Al Janaideh, Rakheja, Su 2009; envelopes g = height tanh(slope v + shift) + middle with g_l <= g_r.)
"""

import math
from typing import NamedTuple


class Envelope(NamedTuple):
    """height tanh(slope v + shift) + middle."""

    height: float
    slope: float
    shift: float
    middle: float

    def at(self, v: float) -> float:
        """Return the envelope at an input."""
        return self.height * math.tanh(self.slope * v + self.shift) + self.middle


def plays(thresholds: list[float], loading: Envelope, unloading: Envelope, values: list[float]) -> list[list[float]]:
    """Return the plays at each row, starting from 0."""
    rows: list[list[float]] = []
    for k, v in enumerate(values):
        upper, lower = loading.at(v), unloading.at(v)
        if k == 0:
            now = [min(max(0.0, upper - r), lower + r) for r in thresholds]
        elif v > values[k - 1]:
            now = [max(upper - r, f) for r, f in zip(thresholds, rows[-1], strict=True)]
        else:
            now = [min(lower + r, f) for r, f in zip(thresholds, rows[-1], strict=True)]
        rows.append(now)
    return rows


def respond(
    direct: float,
    thresholds: list[float],
    densities: list[float],
    loading: Envelope,
    unloading: Envelope,
    values: list[float],
) -> list[float]:
    """Return the output at each row."""
    states = plays(thresholds, loading, unloading, values)
    return [
        direct * loading.at(v) + sum(p * f for p, f in zip(densities, now, strict=True))
        for v, now in zip(values, states, strict=True)
    ]


def essential(values: list[float]) -> list[float]:
    """Return a history without its inner loops, which are removed four points at a time."""
    history: list[float] = []
    for v in values:
        history.append(v)
        while len(history) >= 4:
            a, b, c, d = history[-4:]
            if min(a, d) <= min(b, c) and max(b, c) <= max(a, d):
                del history[-3:-1]
            else:
                break
    return history
