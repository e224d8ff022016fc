"""The generalised Prandtl-Ishlinskii operator as its definition says it: play by play, by whether the input rises or falls.

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
        """The envelope at an input."""
        return self.height * math.tanh(self.slope * v + self.shift) + self.middle


def plays(thresholds: list[float], loading: Envelope, unloading: Envelope, values: list[float]) -> list[list[float]]:
    """The plays at each row, from 0."""
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
    """The output at each row."""
    states = plays(thresholds, loading, unloading, values)
    return [
        direct * loading.at(v) + sum(p * f for p, f in zip(densities, now, strict=True))
        for v, now in zip(values, states, strict=True)
    ]


def essential(values: list[float]) -> list[float]:
    """What a history leaves behind: inner loops, between turns that lie around them, taken out (four points at a time)."""
    kept: list[float] = []
    for v in values:
        kept.append(v)
        while len(kept) >= 4:
            a, b, c, d = kept[-4:]
            if min(a, d) <= min(b, c) and max(b, c) <= max(a, d):
                del kept[-3:-1]
            else:
                break
    return kept
