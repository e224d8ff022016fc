"""Parameters that a bound holds, judged by the gradient of the cost and by the scale of the parameter."""

import numpy as np

# Largest distance from a bound, as a share of the parameter's scale, at which a parameter may be at that bound: steps
# towards a bound grow ever shorter. Chosen by trial, tests/unit/fitting/test_fit.py holds it.
_BOUND_MARGIN = 1e-6


def parameters_at_bounds(
    vector: np.ndarray,
    lower: np.ndarray,
    upper: np.ndarray,
    residual: np.ndarray,
    jacobian: np.ndarray,
    scales: np.ndarray | float = 1.0,
) -> np.ndarray:
    """Find the parameters that a bound holds: the minimum of the cost along each lies at the bound or beyond it.

    Along parameter i alone the minimum is at the distance |g_i| / H_ii in the direction of the falling cost, with the
    gradient g = J' e and H = J' J. A parameter is held by a bound in that direction that is not farther away than this,
    and not farther than a millionth of the parameter's scale. The other bound, and so the width of the bounds, does
    not matter.

    Args:
        vector: Parameters, shape ``(p,)``, in any unit.
        lower: Lower bounds, shape ``(p,)``.
        upper: Upper bounds, shape ``(p,)``.
        residual: Residual e, shape ``(m,)``.
        jacobian: Jacobian J of the residual, shape ``(m, p)``.
        scales: Scales of the parameters in the unit of the vector, shape ``(p,)``.

    Returns:
        Whether each parameter is held, shape ``(p,)``.
    """
    gradient, curvature = jacobian.T @ residual, np.sum(jacobian**2, axis=0)
    to_minimum = np.abs(gradient) / np.where(curvature > 0, curvature, 1.0)
    reach = np.minimum(to_minimum, _BOUND_MARGIN * np.asarray(scales))
    return ((vector - lower <= reach) & (gradient >= 0)) | ((upper - vector <= reach) & (gradient <= 0))


def parameters_near_bounds(
    vector: np.ndarray, lower: np.ndarray, upper: np.ndarray, scales: np.ndarray | float = 1.0
) -> np.ndarray:
    """Find the parameters that are not farther from a bound than a millionth of their scale.

    Args:
        vector: Parameters, shape ``(p,)``, in any unit.
        lower: Lower bounds, shape ``(p,)``.
        upper: Upper bounds, shape ``(p,)``.
        scales: Scales of the parameters in the unit of the vector, shape ``(p,)``.

    Returns:
        Whether each parameter is that near, shape ``(p,)``.
    """
    return np.minimum(vector - lower, upper - vector) <= _BOUND_MARGIN * np.asarray(scales)
