"""Sobol indices: the share of a metric's variance over the space that each parameter causes, alone and in interactions.

Source: saltelli2010, table 2: Saltelli's estimator of the first-order indices, and Jansen's estimator of the total
indices (jansen1999).
"""

from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np
from jaxtyping import Bool, Float

# Number of bootstrap resamples for the intervals: enough for the 2.5 and 97.5 % quantiles; chosen by trial.
_RESAMPLES = 500
# Smallest number of rows: with fewer the intervals are as wide as the indices; chosen by trial.
_MIN_ROWS = 32
# Range of a metric, relative to its size, that counts as rounding error: some thousand units in the last place.
_CONSTANT = 1e-12
# Distance outside of 0 to 1 that is shown as 0.00 or 1.00 by two decimals.
_ROUNDING = 0.005


class SobolIndex(NamedTuple):
    """First-order and total Sobol index of a parameter, with 95 % bootstrap intervals.

    Attributes:
        first: First-order index.
        first95: Its interval.
        total: Total index.
        total95: Its interval.
    """

    first: float
    first95: tuple[float, float]
    total: float
    total95: tuple[float, float]


def sobol_indices(values: Float[np.ndarray, " rows"], names: Sequence[str], seed: int) -> Mapping[str, SobolIndex]:
    """Estimate the Sobol indices of a metric.

    Args:
        values: The metric at the designs of ``space.pick_and_freeze``, shape ``((axes + 2) * base,)``. Rows with a NaN
            are left out.
        names: Names of the axes.
        seed: Seed of the bootstrap.

    Returns:
        The indices by axis; empty if ``missing_reason`` gives a reason.
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


def is_resolved(value: float | None) -> bool:
    """Return whether an estimate of an index is one that an index can have, from 0 to 1.

    Args:
        value: The estimate; ``None`` for none.
    """
    return value is not None and -_ROUNDING <= value <= 1.0 + _ROUNDING


def unresolved_indices(indices: Mapping[str, SobolIndex]) -> list[str]:
    """Return the indices whose estimates lie outside of 0 to 1, in words.

    Args:
        indices: Indices by axis.
    """
    return [
        f"the {kind} index of {name} ({value:.2f})"
        for name, index in indices.items()
        for kind, value in (("first-order", index.first), ("total", index.total))
        if not is_resolved(value)
    ]


def complete_rows(values: Float[np.ndarray, " rows"], axes: int) -> Bool[np.ndarray, " base"]:
    """Return a mask of the rows that have a value at A, at B and at each mixture of the two.

    Args:
        values: The metric, as for ``sobol_indices``.
        axes: Number of axes.

    Returns:
        The mask, shape ``(base,)``.
    """
    return np.asarray(~np.isnan(values.reshape(axes + 2, -1)).any(axis=0))


def missing_reason(values: Float[np.ndarray, " rows"], axes: int) -> str:
    """Return the reason why a metric has no Sobol indices; empty if it has.

    Args:
        values: The metric, as for ``sobol_indices``.
        axes: Number of axes.
    """
    table = values.reshape(axes + 2, -1)[:, complete_rows(values, axes)]
    if np.isinf(table).any():
        return "it is infinite at some designs"
    if table.size and np.ptp(table) <= _CONSTANT * np.max(np.abs(table)):
        return "it does not vary"
    if table.shape[1] < _MIN_ROWS:
        return f"only {table.shape[1]} rows have a value in all their designs, and {_MIN_ROWS} are needed"
    return ""


def _estimates(table: Float[np.ndarray, "designs base"]) -> Float[np.ndarray, "2 axes"]:
    """First-order and total indices, shape ``(2, axes)``, from values at A, at B, and at each A with a column of B."""
    at_a, at_b, mixed = table[0], table[1], table[2:]
    variance = np.var(table[:2])
    first = np.mean(at_b * (mixed - at_a), axis=1)
    total = 0.5 * np.mean((at_a - mixed) ** 2, axis=1)
    return np.array([first, total]) / variance
