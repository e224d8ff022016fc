"""Minimisation in the unit box by gradients: a quasi-Newton method in a trust region.

A line search is not suitable for closed loops: it tries distant gains whose loop is unstable, where gradients are huge
and meaningless. Here each step minimises a quadratic model within the box and within the trust region, which shrinks
after a step whose decrease is much smaller than the model's and grows after a good step. The model's Hessian is updated
from gradients by Powell's damped BFGS formula.

Source: nocedal2006, algorithm 4.1 (trust region) and procedure 18.2 (damped BFGS).
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import scipy.optimize

# Largest radius of the trust region, in sizes of the box. Chosen by experiments/control/wire_position.py.
_MAX_RADIUS = 0.15
# Ratio of actual to predicted decrease below which a step is poor, and above which it is good. Chosen by trial;
# tests/unit/control/test_trust_region.py holds them.
_POOR = 0.1
_GOOD = 0.6
# Factors of the radius after a poor and after a good step.
_SHRINK = 0.35
_GROW = 2.0
# Share of the radius that a good step has to reach for the region to grow.
_NEAR_EDGE = 0.8
# Powell's constant in damped BFGS: nocedal2006, procedure 18.2.
_DAMPING = 0.2
# Predicted decrease that ends the search: 0.01 % of the cost where the cost is a logarithm.
_MIN_DECREASE = 1e-4
# Components of a gradient are scaled down to this size: the squares of larger ones would overflow.
_MAX_GRADIENT = 1e140

CostAndGradient = Callable[[np.ndarray], tuple[float, np.ndarray]]


class SearchState(NamedTuple):
    """State of a search.

    Attributes:
        point: The best point of the unit box, shape ``(p,)``.
        cost: Its cost; infinite if it has not been evaluated.
        hessian: Hessian of the model, shape ``(p, p)``; ``None`` if there is none yet.
        radius: Radius of the trust region (largest change of a coordinate), in sizes of the box.
    """

    point: np.ndarray
    cost: float
    hessian: np.ndarray | None
    radius: float


def descend(cost_and_gradient: CostAndGradient, state: SearchState, min_radius: float, steps: int) -> SearchState:
    """Minimise a cost in the unit box.

    Args:
        cost_and_gradient: Function of a point, shape ``(p,)``, that returns the cost and its gradient, shape ``(p,)``;
            the cost is infinite or NaN where the point cannot be evaluated.
        state: Start of the search; its cost is not used.
        min_radius: Radius of the trust region below which the search ends.
        steps: Largest number of steps; the search ends earlier if the predicted decrease is small.

    Returns:
        The state at the end, with the best point; without a Hessian if the start has no finite cost.
    """
    point, radius = state.point, state.radius
    cost, gradient = _bounded(cost_and_gradient, point)
    hessian = state.hessian
    if hessian is None:  # the first step then reaches the region's edge in the coordinate with the largest derivative
        hessian = np.eye(len(point)) * max(float(np.max(np.abs(gradient))), 1e-12) / radius
    if not np.isfinite(cost):
        return SearchState(point, cost, None, radius)
    for _ in range(steps):
        low, high = np.maximum(-radius, -point), np.minimum(radius, 1.0 - point)
        step, predicted = _model_step(gradient, hessian, low, high)
        if predicted < _MIN_DECREASE:
            break
        new_cost, new_gradient = _bounded(cost_and_gradient, point + step)
        length = float(np.max(np.abs(step)))
        ratio = (cost - new_cost) / predicted if np.isfinite(new_cost) else -np.inf
        if np.isfinite(new_cost):
            hessian = _damped_bfgs(hessian, step, new_gradient - gradient)
        if ratio > 0.0:
            point, cost, gradient = np.clip(point + step, 0.0, 1.0), new_cost, new_gradient
        if ratio < _POOR:
            radius = _SHRINK * min(radius, length)
        elif ratio > _GOOD and length > _NEAR_EDGE * radius:
            radius = min(_GROW * radius, _MAX_RADIUS)
        if radius < min_radius:
            break
    return SearchState(point, cost, hessian, radius)


def _bounded(cost_and_gradient: CostAndGradient, point: np.ndarray) -> tuple[float, np.ndarray]:
    """Cost and gradient at a point; large gradients are scaled down."""
    cost, gradient = cost_and_gradient(point)
    return cost, gradient * min(1.0, _MAX_GRADIENT / max(float(np.max(np.abs(gradient))), 1e-300))


def _model_step(
    gradient: np.ndarray, hessian: np.ndarray, low: np.ndarray, high: np.ndarray
) -> tuple[np.ndarray, float]:
    """The step between bounds that minimises the model, and the decrease of the model."""

    def model(step: np.ndarray) -> tuple[float, np.ndarray]:
        product = hessian @ step
        return float(gradient @ step + 0.5 * step @ product), gradient + product

    scale = max(float(np.max(np.abs(gradient))), 1e-12)
    first = np.clip(-0.5 * np.max(high - low) * gradient / scale, low, high) * 0.5
    bounds = list(zip(low, high, strict=True))
    result = scipy.optimize.minimize(model, first, jac=True, method="L-BFGS-B", bounds=bounds)
    return result.x, -float(result.fun)


def _damped_bfgs(hessian: np.ndarray, step: np.ndarray, gradient_change: np.ndarray) -> np.ndarray:
    """Updated Hessian by damped BFGS: nocedal2006, procedure 18.2."""
    product = hessian @ step
    predicted, actual = float(step @ product), float(step @ gradient_change)
    theta = 1.0 if actual >= _DAMPING * predicted else (1.0 - _DAMPING) * predicted / (predicted - actual)
    damped = theta * gradient_change + (1.0 - theta) * product
    return hessian - np.outer(product, product) / predicted + np.outer(damped, damped) / float(step @ damped)
