"""Which designs are best: the feasible ones that no other one dominates."""

from collections.abc import Mapping

import numpy as np

from smajax.recordings.recording import Floats

# Violation that stands for a metric that is NaN or infinitely far from its bound.
_INFINITE_VIOLATION = 1e6


def feasible(columns: Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]) -> np.ndarray:
    """Return which designs keep all constraints, shape ``(m,)``.

    Args:
        columns: Columns of a sweep's table, ``code`` among them, shape ``(m,)`` each.
        constraints: Lower and upper bound by metric. A design whose metric is NaN does not keep them.
    """
    keeps = np.asarray(columns["code"]) == "done"
    for name, (lower, upper) in constraints.items():
        keeps &= (columns[name] >= lower) & (columns[name] <= upper)
    return keeps


def constraint_violation(
    values: Mapping[str, float] | Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]
) -> np.ndarray:
    """Return the summed violation of constraints, each relative to the violated bound; 0 if all are kept.

    A metric that is NaN, or infinitely far from its bound, counts as 1e6.
    """
    total = np.zeros(())
    for name, (lower, upper) in constraints.items():
        size = max(abs(bound) for bound in (lower, upper) if np.isfinite(bound)) or 1.0
        excess = np.maximum(np.maximum(lower - values[name], values[name] - upper), 0.0) / size
        total = total + np.where(np.isfinite(excess), excess, _INFINITE_VIOLATION)
    return total


def pareto_front(costs: Floats) -> np.ndarray:
    """Return the rows of costs ``(m, k)``, smaller being better, that no other row dominates, in ascending order.

    Infinite costs are compared like others; rows with a NaN are never in the front.
    """
    candidates = np.flatnonzero(~np.any(np.isnan(costs), axis=1))
    candidates = candidates[np.lexsort(costs[candidates].T[::-1])]
    nondominated = []
    while len(candidates):
        # In lexical order the first candidate is dominated by none of the others.
        first, others = candidates[0], candidates[1:]
        nondominated.append(first)
        candidates = others[
            np.any(costs[others] < costs[first], axis=1) | np.all(costs[others] == costs[first], axis=1)
        ]
    return np.sort(np.asarray(nondominated, int))


def thin_front(costs: Floats, most: int) -> np.ndarray:
    """Return about ``most`` rows of a front's costs ``(m, k)``, evenly taken, and the best in each column."""
    even = np.arange(0, len(costs), max(1, -(-len(costs) // most)))
    return np.union1d(even, np.argmin(costs, axis=0)) if len(costs) else even


def objective_costs(columns: Mapping[str, np.ndarray], objectives: Mapping[str, str]) -> Floats:
    """Return the costs ``(m, k)``, smaller being better, of objectives that are ``max`` or ``min`` by metric."""
    return np.column_stack([columns[n] * (-1.0 if goal == "max" else 1.0) for n, goal in objectives.items()])
