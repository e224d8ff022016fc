"""Constraints of a sweep in SciPy's form: distances of metrics from their bounds, with derivatives."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float

from smajax.sweeps.evaluation import DesignEvaluator

# Distance from a bound, relative to it, that a search keeps, so that its result does not violate the bound by rounding.
# Chosen by trial; tests/unit/sweeps/test_sweeps.py checks that refined designs satisfy their limits.
MARGIN = 1e-6
# Error of a metric by the time steps, relative to a bound, that a refined design has room for: several times the
# largest one that experiments/speed/design_tasks.py prints against the exact simulator.
STEP_ERROR = 5e-4
# Replaces an infinite distance or cost, which SLSQP cannot handle; scaled distances and costs are near 1.
INFINITE = 1e6
# Smallest scale of a bound, as a share of the metric's size at the start; for bounds near 0.
_MIN_SCALE = 1e-3


def safe_bounds(limits: Mapping[str, tuple[float, float]], share: float = STEP_ERROR) -> dict[str, tuple[float, float]]:
    """Return limits with a distance from them, by default for the error of the time steps of a refined design.

    Args:
        limits: Lower and upper bound by metric, in internal units; bounds too close for the distance stay.
        share: The distance, relative to each bound.
    """
    bounds = {}
    for name, (low, high) in limits.items():
        inner = tuple(
            end + sign * share * abs(end) if np.isfinite(end) else end for end, sign in ((low, 1.0), (high, -1.0))
        )
        bounds[name] = inner if inner[0] <= inner[1] else (low, high)
    return bounds


def as_constraints(
    evaluator: DesignEvaluator, limits: Mapping[str, tuple[float, float]], sizes: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Return SciPy's inequality constraints for the limits of a sweep.

    Args:
        evaluator: Metrics and derivatives of designs.
        limits: Lower and upper bound by metric, in internal units.
        sizes: Size of each metric, in internal units, which scales bounds that are nearly 0.

    Returns:
        One constraint with an entry for each finite bound, in order; an empty list without finite bounds. Its functions
        take shares of the free axes, shape ``(free,)``; they return the scaled distances, shape ``(bounds,)``, and
        their Jacobian, shape ``(bounds, free)``.
    """
    bounds = [
        (name, bound, sign)
        for name, pair in limits.items()
        for bound, sign in zip(pair, (1.0, -1.0), strict=True)
        if np.isfinite(bound)
    ]
    scales = [max(abs(bound), _MIN_SCALE * sizes[name]) for name, bound, _ in bounds]

    def distances(shares: Float[np.ndarray, " free"]) -> Float[np.ndarray, " bounds"]:
        values = evaluator.evaluate(shares)[0]
        scaled = [
            sign * (values[name] - bound) / scale - MARGIN
            for (name, bound, sign), scale in zip(bounds, scales, strict=True)
        ]
        return np.nan_to_num(np.array(scaled), nan=-INFINITE, posinf=INFINITE, neginf=-INFINITE)

    def jacobian(shares: Float[np.ndarray, " free"]) -> Float[np.ndarray, "bounds free"]:
        derivatives = evaluator.evaluate(shares)[1]
        rows = np.array(
            [sign * derivatives[name] / scale for (name, _, sign), scale in zip(bounds, scales, strict=True)]
        )
        return np.where(np.isfinite(rows), rows, 0.0)

    return [{"type": "ineq", "fun": distances, "jac": jacobian}] if bounds else []
