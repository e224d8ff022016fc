"""Feasible designs, and the Pareto front of those that no other design dominates."""

from collections.abc import Mapping

import numpy as np
from jaxtyping import Bool, Float, Int

# Violation of a metric that is NaN or infinitely far from its bound; far above any finite one in practice.
_INFINITE_VIOLATION = 1e6


def feasible_mask(
    columns: Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]
) -> Bool[np.ndarray, " designs"]:
    """Return a mask of the designs that satisfy all constraints.

    Args:
        columns: Columns of a sweep's table by name, with ``code``, shape ``(designs,)`` each.
        constraints: Lower and upper bound by metric, in internal units.

    Returns:
        The mask, shape ``(designs,)``; false for a design that failed or whose metric is NaN.
    """
    mask = np.asarray(columns["code"]) == "done"
    for name, (lower, upper) in constraints.items():
        mask &= (columns[name] >= lower) & (columns[name] <= upper)
    return mask


def constraint_violation(
    values: Mapping[str, float] | Mapping[str, np.ndarray], constraints: Mapping[str, tuple[float, float]]
) -> np.ndarray:
    """Return the sum of the violations of constraints, each relative to the larger of its finite bounds.

    A metric that is NaN, or infinitely far from its bound, adds 1e6.

    Args:
        values: Metrics by name in internal units, scalars or arrays of one shape.
        constraints: Lower and upper bound by metric.

    Returns:
        The sum, in the shape of the metrics; 0 if all constraints are satisfied.
    """
    total = np.zeros(())
    for name, (lower, upper) in constraints.items():
        size = max((abs(bound) for bound in (lower, upper) if np.isfinite(bound)), default=1.0) or 1.0
        value = np.asarray(values[name])
        # An infinite metric is within an infinite bound, although their difference is NaN.
        below, above = (lower - value if np.isfinite(lower) else 0.0, value - upper if np.isfinite(upper) else 0.0)
        excess = np.where(np.isnan(value), np.nan, np.maximum(np.maximum(below, above), 0.0) / size)
        total = total + np.where(np.isfinite(excess), excess, _INFINITE_VIOLATION)
    return np.asarray(total)


def pareto_front(costs: Float[np.ndarray, "designs objectives"]) -> Int[np.ndarray, " front"]:
    """Return the designs that no other design dominates.

    Infinite costs are compared like others; a design with a NaN is never in the front.

    Args:
        costs: Costs to be minimised, shape ``(designs, objectives)``.

    Returns:
        Rows of the front, in ascending order, shape ``(front,)``.
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


def thin_front(costs: Float[np.ndarray, "front objectives"], max_rows: int) -> Int[np.ndarray, " rows"]:
    """Choose designs of a front: evenly spaced rows, and the best design in each objective.

    Args:
        costs: Costs of the front, shape ``(front, objectives)``.
        max_rows: Largest number of evenly spaced rows.

    Returns:
        Rows of ``costs``, in ascending order.
    """
    even = np.arange(0, len(costs), max(1, -(-len(costs) // max_rows)))
    return np.union1d(even, np.argmin(costs, axis=0)) if len(costs) else even


def objective_costs(
    columns: Mapping[str, np.ndarray], objectives: Mapping[str, str]
) -> Float[np.ndarray, "designs objectives"]:
    """Return the costs of objectives: the metric for ``min``, its negative for ``max``.

    Args:
        columns: Columns of a sweep's table by name, shape ``(designs,)`` each.
        objectives: ``max`` or ``min`` by metric.

    Returns:
        Costs to be minimised, shape ``(designs, objectives)``.
    """
    return np.column_stack([columns[n] * (-1.0 if goal == "max" else 1.0) for n, goal in objectives.items()])
