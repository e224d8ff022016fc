"""Instants of effects that set in at some moment: where they leave least, and how far a recording leaves them open."""

import math
from collections.abc import Sequence

import numpy as np

from smajax.diagnose.bench import Bench, in_pairs
from smajax.diagnose.hypothesis import Hypothesis, Refit

# Of the recording's length, how far apart instants are looked at, and how many at most; up to which share more than is left counts as flat;
# and how much less, in sums of squares over the noise, is worth another search.
_CLOSE, _PLACES, _FLAT, _FAINT = 1200, 60, 1.1, 4.0
_FAR = 100.0  # mean square over the noise, beyond which it is not an instant that is a little off
_ALLOWED = 9.0  # sums of squares more than the least: what noise may do to an instant


def better(bench: Bench, refit: Refit, parts: Sequence[int]) -> Hypothesis | None:
    """The hypothesis with an instant at which less is left of these parts; ``None`` if its own are as good as any near them."""
    found = None
    for name in _named(bench, refit) if bench.fitness(refit.residual, 0) < _FAR else ():
        times, costs = _around(bench, refit, found or refit.hypothesis, name, parts)
        if np.min(costs) < costs[0] - _FAINT:
            found = (found or refit.hypothesis).at({name: float(times[np.argmin(costs)])})
    return found


def left_open(bench: Bench, refit: Refit, k: int, fitted: Sequence[int] = (0,)) -> float:
    """Mean square over the noise that an instant makes of a prediction of part ``k``, being anywhere where ``fitted`` parts allow."""
    total = 0.0
    predicted = bench.predict(refit.hypothesis, refit.base, k)
    for name in _named(bench, refit):
        times, costs = _around(bench, refit, refit.hypothesis, name, fitted)
        alike = times[costs < np.min(costs) + _ALLOWED]
        others = in_pairs(lambda t: bench.predict(refit.hypothesis.at({name: t}), refit.base, k), list(alike))  # noqa: B023
        total += float(np.mean([np.mean(bench.flat(other - predicted, k) ** 2) for other in others]))
    return total


def _named(bench: Bench, refit: Refit) -> list[str]:
    return [n for n in bench.moved(refit.hypothesis) if n.endswith(".instant")]


def _around(bench: Bench, refit: Refit, hypothesis: Hypothesis, name: str, parts: Sequence[int]) -> tuple[np.ndarray, np.ndarray]:
    """An instant's own value and others near it, and the sum of squares that each leaves of these parts.

    While the wire is cold, say, it hardly matters when a draught sets in: the cost is all but flat there, its slope tells a search
    nothing, and the instant itself is where it dips a little. All that lies between here and where the cost rises is looked at.
    """
    now, ends = refit.values[name], []

    def left(instant: float) -> float:
        at = hypothesis.at({name: instant})
        cost = sum(float(np.sum(bench.flat(bench.predict(at, refit.base, k), k) ** 2)) for k in parts)
        return cost if math.isfinite(cost) else math.inf

    here, apart = left(now), bench.duration / _CLOSE
    for way in (-1.0, 1.0):
        reach = apart
        while 0.0 < now + way * reach < bench.duration and left(now + way * reach) < _FLAT * here:
            reach *= 2.0
        ends.append(float(np.clip(now + way * reach, 0.0, bench.duration)))
    times = np.linspace(ends[0], ends[1], min(int((ends[1] - ends[0]) / apart) + 2, _PLACES))
    return np.append(now, times), np.array([here, *in_pairs(left, list(times))])
