"""Which designs are best: the feasible ones that no other one beats in every objective."""

from collections.abc import Mapping

import numpy as np

from smajax.recording import Floats


def feasible(columns: Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]) -> np.ndarray:
    """Which designs keep all constraints (lower and upper end by metric), shape ``(m,)``; those without a number do not."""
    kept = np.asarray(columns["code"]) == "done"
    for name, (lower, upper) in constraints.items():
        kept &= (columns[name] >= lower) & (columns[name] <= upper)
    return kept


def beyond(values: Mapping[str, float] | Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]) -> np.ndarray:
    """How far metrics are beyond their constraints, summed over these in sizes of the end that is passed; 0 where all are kept.

    A metric without a number, or infinitely far, counts as a million.
    """
    total = np.zeros(())
    for name, (lower, upper) in constraints.items():
        size = max(abs(end) for end in (lower, upper) if np.isfinite(end)) or 1.0
        over = np.maximum(np.maximum(lower - values[name], values[name] - upper), 0.0) / size
        total = total + np.where(np.isfinite(over), over, 1e6)
    return total


def pareto(costs: Floats) -> np.ndarray:
    """Rows of costs ``(m, k)``, smaller being better, that no other row dominates, in order.

    Infinite costs have their order, too; rows with a NaN are never among them.
    """
    left = np.flatnonzero(~np.any(np.isnan(costs), axis=1))
    left = left[np.lexsort(costs[left].T[::-1])]
    found = []
    while len(left):
        # In lexical order the first one left is dominated by none of the rest.
        first, rest = left[0], left[1:]
        found.append(first)
        left = rest[np.any(costs[rest] < costs[first], axis=1) | np.all(costs[rest] == costs[first], axis=1)]
    return np.sort(np.asarray(found, int))


def thinned(costs: Floats, most: int) -> np.ndarray:
    """Rows of a front's costs ``(m, k)``: about ``most`` of them, evenly taken, and the best in each column always."""
    even = np.arange(0, len(costs), max(1, -(-len(costs) // most)))
    return np.union1d(even, np.argmin(costs, axis=0)) if len(costs) else even


def cheapest(columns: Mapping[str, np.ndarray], objectives: Mapping[str, str]) -> Floats:
    """The costs ``(m, k)`` of objectives that are ``max`` or ``min``."""
    return np.column_stack([columns[n] * (-1.0 if way == "max" else 1.0) for n, way in objectives.items()])
