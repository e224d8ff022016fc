"""Sobol indices: the share of a metric's variance over the space that each parameter causes, alone and in interactions.

Source: saltelli2010, table 2: Saltelli's estimator of the first-order indices and Jansen's estimator of the total
    indices (jansen1999).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from smajax.recordings.recording import Floats

# Resamples of the bootstrap that gives the intervals: enough for the 2.5 and 97.5 % quantiles; chosen by trial.
_RESAMPLES = 500
# With fewer rows the intervals are as wide as the indices; chosen by trial.
_MIN_ROWS = 32
# Range of a metric, relative to its size, that is rounding.
_CONSTANT = 1e-12


class SobolIndex(NamedTuple):
    """First-order and total index of a parameter, each with a 95 % interval by the bootstrap."""

    first: float
    first95: tuple[float, float]
    total: float
    total95: tuple[float, float]


def sobol_indices(values: Floats, names: Sequence[str], seed: int) -> Mapping[str, SobolIndex]:
    """Estimate the indices of a metric.

    Args:
        values: The metric at the designs of ``space.pick_and_freeze``, shape ``((axes + 2) * base,)``. Rows with a NaN
            are left out.
        names: Names of the axes.
        seed: Seed of the bootstrap.

    Returns:
        The index of each axis; nothing where ``missing_reason`` gives a reason.
    """
    if missing_reason(values, len(names)):
        return {}
    table = values.reshape(len(names) + 2, -1)[:, complete_rows(values, len(names))]
    table = table - table.mean()
    base = table.shape[1]
    drawn = np.random.default_rng(seed).integers(0, base, (_RESAMPLES, base))
    estimates, resampled = _estimates(table), np.array([_estimates(table[:, rows]) for rows in drawn])
    low, high = np.quantile(resampled, [0.025, 0.975], axis=0)

    def interval(kind: int, k: int) -> tuple[float, float]:
        return float(low[kind, k]), float(high[kind, k])

    return {
        n: SobolIndex(float(estimates[0, k]), interval(0, k), float(estimates[1, k]), interval(1, k))
        for k, n in enumerate(names)
    }


def complete_rows(values: Floats, axes: int) -> np.ndarray:
    """Return which rows, shape ``(base,)``, have a value at A, at B and at each mixture of the two."""
    return np.asarray(~np.isnan(values.reshape(axes + 2, -1)).any(axis=0))


def missing_reason(values: Floats, axes: int) -> str:
    """Return why a metric's values, as for ``sobol_indices``, give no indices; empty if they do."""
    table = values.reshape(axes + 2, -1)[:, complete_rows(values, axes)]
    if np.isinf(table).any():
        return "it is infinite at some designs"
    if table.size and np.ptp(table) <= _CONSTANT * np.max(np.abs(table)):
        return "it does not vary"
    if table.shape[1] < _MIN_ROWS:
        return f"it has a value in all designs of {table.shape[1]} rows only, of {_MIN_ROWS} needed"
    return ""


def _estimates(table: Floats) -> Floats:
    """First-order and total indices, shape ``(2, axes)``, from values at A, at B, and at each A with a column of B."""
    at_a, at_b, mixed = table[0], table[1], table[2:]
    variance = np.var(table[:2])
    first = np.mean(at_b * (mixed - at_a), axis=1)
    total = 0.5 * np.mean((at_a - mixed) ** 2, axis=1)
    return np.array([first, total]) / variance
