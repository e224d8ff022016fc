"""Constraints of a sweep as SciPy takes them: distances of metrics from their bounds, with derivatives."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from smajax.recordings.recording import Floats
from smajax.sweeps.evaluation import DesignEvaluator

# Distance from a bound, relative to it, at which a search aims, so that rounding does not put its end outside.
# Chosen by trial; tests/unit/sweeps/test_sweeps.py holds it.
MARGIN = 1e-6
# Stands for an infinite distance or cost, which SLSQP cannot take.
INFINITE = 1e6
# A bound near 0 is scaled by this share of the metric's size at the start instead.
_MIN_SCALE = 1e-3


def as_constraints(
    evaluator: DesignEvaluator, limits: Mapping[str, tuple[float, float]], sizes: Mapping[str, float]
) -> list[dict[str, Any]]:
    """Return SciPy's inequality constraints for the limits of a sweep.

    Args:
        evaluator: Metrics and derivatives of designs.
        limits: Lower and upper bound by metric.
        sizes: Size of each metric, which scales bounds that are nearly 0.

    Returns:
        One constraint whose values and rows belong to the finite bounds in order; none without finite bounds.
    """
    bounds = [
        (name, bound, sign)
        for name, pair in limits.items()
        for bound, sign in zip(pair, (1.0, -1.0), strict=True)
        if np.isfinite(bound)
    ]
    scales = [max(abs(bound), _MIN_SCALE * sizes[name]) for name, bound, _ in bounds]

    def distances(shares: Floats) -> Floats:
        values = evaluator.evaluate(shares)[0]
        scaled = [
            sign * (values[name] - bound) / scale - MARGIN
            for (name, bound, sign), scale in zip(bounds, scales, strict=True)
        ]
        return np.nan_to_num(np.array(scaled), nan=-INFINITE, posinf=INFINITE, neginf=-INFINITE)

    def jacobian(shares: Floats) -> Floats:
        derivatives = evaluator.evaluate(shares)[1]
        rows = np.array(
            [sign * derivatives[name] / scale for (name, _, sign), scale in zip(bounds, scales, strict=True)]
        )
        return np.where(np.isfinite(rows), rows, 0.0)

    return [{"type": "ineq", "fun": distances, "jac": jacobian}] if bounds else []
