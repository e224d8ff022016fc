"""How much room constraints leave, for a search: of each end that a metric has, its distance in sizes of that end, and its slopes."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from smajax.recording import Floats
from smajax.sweep.look import Look

# How far inside a search aims, so that what it ends at is inside.
INSIDE = 1e-6
# What stands for infinite room in a search.
FAR = 1e6


def as_constraints(look: Look, limits: Mapping[str, tuple[float, float]], sizes: Mapping[str, float]) -> list[dict[str, Any]]:
    """SciPy's constraints of ``limits`` (lower and upper end by metric); ``sizes`` of the metrics stand in where an end is nearly 0."""
    bounds = [(n, end, way) for n, ends in limits.items() for end, way in zip(ends, (1.0, -1.0), strict=True) if np.isfinite(end)]
    scales = [max(abs(end), 1e-3 * sizes[n]) for n, end, _ in bounds]

    def room(share: Floats) -> Floats:
        values = look.at(share)[0]
        left = np.array([way * (values[n] - end) / scale - INSIDE for (n, end, way), scale in zip(bounds, scales, strict=True)])
        return np.nan_to_num(left, nan=-FAR, posinf=FAR, neginf=-FAR)

    def slope(share: Floats) -> Floats:
        slopes = look.at(share)[1]
        rows = np.array([way * slopes[n] / scale for (n, _, way), scale in zip(bounds, scales, strict=True)])
        return np.where(np.isfinite(rows), rows, 0.0)

    return [{"type": "ineq", "fun": room, "jac": slope}] if bounds else []
