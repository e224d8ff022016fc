"""Sobol indices: how much of a metric's variance over the space each parameter makes, alone and with the others.

First order by Saltelli's estimator, total by Jansen's (Saltelli et al., Computer Physics Communications 181 (2010) 259, table 2).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smajax.recording import Floats

_RESAMPLES = 500
# With fewer rows the intervals say nothing.
_LEAST = 32


class Index(NamedTuple):
    """A parameter's first-order and total index, each with a 95 % interval by the bootstrap."""

    first: float
    first95: tuple[float, float]
    total: float
    total95: tuple[float, float]


def indices(values: Floats, names: Sequence[str], seed: int) -> Mapping[str, Index]:
    """Indices of a metric by parameter, from its values, shape ``((axes + 2) * base,)``, at the designs of ``space.pick_and_freeze``.

    Rows in which a value is missing (NaN) are left out. None at all where ``why_not`` gives a reason.
    """
    if why_not(values, len(names)):
        return {}
    table = values.reshape(len(names) + 2, -1)[:, whole_rows(values, len(names))]
    table = table - table.mean()
    base = table.shape[1]
    drawn = np.random.default_rng(seed).integers(0, base, (_RESAMPLES, base))
    told, spread = _estimates(table), np.array([_estimates(table[:, rows]) for rows in drawn])
    low, high = np.quantile(spread, [0.025, 0.975], axis=0)

    def ends(kind: int, k: int) -> tuple[float, float]:
        return float(low[kind, k]), float(high[kind, k])

    return {n: Index(float(told[0, k]), ends(0, k), float(told[1, k]), ends(1, k)) for k, n in enumerate(names)}


def whole_rows(values: Floats, axes: int) -> np.ndarray:
    """Which of the ``base`` rows, shape ``(base,)``, have a value at A, at B and at each mixture of the two."""
    return np.asarray(~np.isnan(values.reshape(axes + 2, -1)).any(axis=0))


def why_not(values: Floats, axes: int) -> str:
    """Why a metric's values, as for ``indices``, give none; empty if they do."""
    table = values.reshape(axes + 2, -1)[:, whole_rows(values, axes)]
    if np.isinf(table).any():
        return "it is infinite at some designs"
    if table.size and np.ptp(table) <= 1e-12 * np.max(np.abs(table)):
        return "it does not vary"
    return f"it has a value in all designs of {table.shape[1]} rows alone, of {_LEAST} needed" if table.shape[1] < _LEAST else ""


def _estimates(table: Floats) -> Floats:
    """First-order and total indices, shape ``(2, axes)``, from the values at A, at B, and at each A with a column of B."""
    one, other, mixed = table[0], table[1], table[2:]
    variance = np.var(table[:2])
    first = np.mean(other * (mixed - one), axis=1)
    total = 0.5 * np.mean((one - mixed) ** 2, axis=1)
    return np.array([first, total]) / variance
