"""Differential evolution over the unit box from a given population, with the cost of a whole population at a time.

Source: storn1997, by SciPy.
"""

from collections.abc import Callable

import numpy as np
import scipy.optimize
from jaxtyping import Float


def evolve_in_unit_box(
    cost: Callable[[np.ndarray], np.ndarray], first: Float[np.ndarray, "points p"], generations: int, seed: int
) -> tuple[Float[np.ndarray, " p"], float]:
    """Minimise a cost over points of the unit box.

    Args:
        cost: Costs of points, from shape ``(p, points)`` to ``(points,)``.
        first: First population, shape ``(points, p)``.
        generations: Number of generations; the search has no other end.
        seed: Seed of the random numbers.

    Returns:
        The best point, shape ``(p,)``, and its cost.
    """
    result = scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * first.shape[1],
        init=first,  # pyright: ignore[reportArgumentType]
        maxiter=generations,
        tol=0.0,
        polish=False,
        rng=np.random.default_rng(seed),
        vectorized=True,
        updating="deferred",
    )
    return result.x, float(result.fun)
