"""Sobol indices: how much of a metric's variance over the space each parameter makes, alone and with the others.

First order by Saltelli's estimator, total by Jansen's (Saltelli et al., Computer Physics Communications 181 (2010) 259, table 2).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smajax.recording import Floats

_RESAMPLES = 500


class Index(NamedTuple):
    """A parameter's first-order and total index, each with a 95 % interval by the bootstrap."""

    first: float
    first95: tuple[float, float]
    total: float
    total95: tuple[float, float]


def indices(values: Floats, names: Sequence[str], seed: int) -> Mapping[str, Index]:
    """Indices of a metric by parameter, from its values, shape ``((axes + 2) * base,)``, at the designs of ``space.pick_and_freeze``.

    None at all if a value is missing or the metric does not vary: then nothing can be said.
    """
    if not np.all(np.isfinite(values)) or np.ptp(values) <= 1e-12 * np.max(np.abs(values)):
        return {}
    table = (values - values.mean()).reshape(len(names) + 2, -1)
    base = table.shape[1]
    drawn = np.random.default_rng(seed).integers(0, base, (_RESAMPLES, base))
    told, spread = _estimates(table), np.array([_estimates(table[:, rows]) for rows in drawn])
    low, high = np.quantile(spread, [0.025, 0.975], axis=0)

    def ends(kind: int, k: int) -> tuple[float, float]:
        return float(low[kind, k]), float(high[kind, k])

    return {n: Index(float(told[0, k]), ends(0, k), float(told[1, k]), ends(1, k)) for k, n in enumerate(names)}


def _estimates(table: Floats) -> Floats:
    """First-order and total indices, shape ``(2, axes)``, from the values at A, at B, and at each A with a column of B."""
    one, other, mixed = table[0], table[1], table[2:]
    variance = np.var(table[:2])
    first = np.mean(other * (mixed - one), axis=1)
    total = 0.5 * np.mean((one - mixed) ** 2, axis=1)
    return np.array([first, total]) / variance
