"""The least cost in the unit box by gradients, in steps no longer than a trust region.

A closed loop punishes a leap: a line search that tries gains far away ends among those with which the loop swings itself up, whose slopes
are huge and tell nothing. Here each step minimises a quadratic within the box and within the region, which shrinks after a step that
disappoints and grows after one that does not. The quadratic's curvature is built up from slopes by Powell's damped BFGS formula.

Sources: Nocedal and Wright, Numerical Optimization (2006), algorithm 4.1 and procedure 18.2.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.optimize

_WIDEST = 0.15  # of the box
_POOR, _GOOD = 0.1, 0.6  # gain over the expected one from which on a step disappoints, or does not
_SHRUNK, _GROWN = 0.35, 2.0
_DAMPED = 0.2
_SLIGHT = 1e-4  # an expected gain that ends the search
_STEEPEST = 1e140  # a slope at most: what is steeper tells nothing, and its square would be no number

Slope = Callable[[np.ndarray], tuple[float, np.ndarray]]


class Place(NamedTuple):
    """Where a search stands: ``point``, shape ``(p,)``, its ``cost``, the ``curvature``, shape ``(p, p)``, and the region's radius."""

    point: np.ndarray
    cost: float
    curvature: np.ndarray | None
    radius: float


def descend(slope: Slope, place: Place, least: float, steps: int) -> Place:
    """The best point that so many steps find from a place, whose cost need not be known.

    ``slope`` tells the cost and its gradient, a cost that is not finite where there is none. The search ends when the region is smaller
    than ``least``, or when little is to be gained.
    """
    point, radius = place.point, place.radius
    cost, by = _cut(slope, point)
    curvature = place.curvature
    if curvature is None:  # the first step then goes to the region's end where the slope is greatest
        curvature = np.eye(len(point)) * max(float(np.max(np.abs(by))), 1e-12) / radius
    if not np.isfinite(cost):
        return Place(point, cost, None, radius)
    for _ in range(steps):
        step, expected = _step(by, curvature, np.maximum(-radius, -point), np.minimum(radius, 1.0 - point))
        if expected < _SLIGHT:
            break
        then, slope_then = _cut(slope, point + step)
        reach = float(np.max(np.abs(step)))
        gained = (cost - then) / expected if np.isfinite(then) else -np.inf
        if np.isfinite(then):
            curvature = _updated(curvature, step, slope_then - by)
        if gained > 0.0:
            point, cost, by = np.clip(point + step, 0.0, 1.0), then, slope_then
        if gained < _POOR:
            radius = _SHRUNK * min(radius, reach)
        elif gained > _GOOD and reach > 0.8 * radius:
            radius = min(_GROWN * radius, _WIDEST)
        if radius < least:
            break
    return Place(point, cost, curvature, radius)


def _cut(slope: Slope, point: np.ndarray) -> tuple[float, np.ndarray]:
    cost, by = slope(point)
    return cost, by * min(1.0, _STEEPEST / max(float(np.max(np.abs(by))), 1e-300))


def _step(by: np.ndarray, curvature: np.ndarray, low: np.ndarray, high: np.ndarray) -> tuple[np.ndarray, float]:
    """The step between two ends that makes the quadratic least, and what it gains."""

    def quadratic(step: np.ndarray) -> tuple[float, np.ndarray]:
        bent = curvature @ step
        return float(by @ step + 0.5 * step @ bent), by + bent

    scale = max(float(np.max(np.abs(by))), 1e-12)
    first = np.clip(-0.5 * np.max(high - low) * by / scale, low, high) * 0.5
    found = scipy.optimize.minimize(quadratic, first, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)))
    return found.x, -float(found.fun)


def _updated(curvature: np.ndarray, step: np.ndarray, turned: np.ndarray) -> np.ndarray:
    bent = curvature @ step
    own, seen = float(step @ bent), float(step @ turned)
    share = 1.0 if seen >= _DAMPED * own else (1.0 - _DAMPED) * own / (own - seen)
    taken = share * turned + (1.0 - share) * bent
    return curvature - np.outer(bent, bent) / own + np.outer(taken, taken) / float(step @ taken)
