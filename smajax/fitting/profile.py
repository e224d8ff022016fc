"""Profile likelihood of one parameter."""

import math
from typing import Any

import numpy as np

from smajax.errors import InputError
from smajax.fitting.abstract_problem import residual
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.result import FitResult

# 95 % quantile of the chi-squared distribution with one degree of freedom.
_CHI2_95 = 3.841
# Relative tolerance of the searches along a profile: tighter than a fit's, since their costs are compared. Chosen by
# trial; the tests of profiles in tests/unit/fitting/test_fit.py hold it.
_RTOL = 1e-9


def profile_likelihood(result: FitResult, name: str, *, points: int = 9, width: float = 3.0) -> dict[str, Any]:
    """Compute the best cost with one parameter held at several values.

    Args:
        result: A fit.
        name: Label of a free parameter.
        points: Number of values.
        width: The values reach this number of standard errors to either side.

    Returns:
        ``values`` (points,) in the internal unit; ``rise`` (points,) of the cost, in units in which 3.84 bounds a 95 %
        interval, corrected for the noise's autocorrelation; ``lower95`` and ``upper95``, ``None`` where the rise does
        not reach 3.84 within the range.

    Raises:
        InputError: The parameter is not free, is at its bound, or has no effect.
    """
    index, deviation = _index_and_deviation(result, name)
    estimate, scale = result.estimates[index], result.problem.unknowns[index].scale
    lower, upper = (np.tile(b, (points, 1)) for b in result.problem.bounds)
    values = np.clip(
        estimate.estimate + deviation * np.linspace(-width, width, points),
        lower[0, index] * scale,
        upper[0, index] * scale,
    )
    lower[:, index] = upper[:, index] = values / scale
    # The other parameters start at their conditional means given this one, by the covariance.
    starts = np.tile(result.vector, (points, 1))
    slope = result.covariance[:, index] / result.covariance[index, index]
    scales = np.array([u.scale for u in result.problem.unknowns])
    starts += np.outer(values - estimate.estimate, np.nan_to_num(slope)) / scales
    solver = MultiStartSolver(residual, result.problem, starts, lower, upper, size=result.problem.size, rtol=_RTOL)
    rise = solver.advance().result().costs - result.cost
    # Near the estimate the profile is a parabola; autocorrelated noise widens it by the same factor as the interval.
    curvature = np.sum(rise * (values - estimate.estimate) ** 2) / np.sum((values - estimate.estimate) ** 4)
    rise = rise / (curvature * deviation**2)
    middle = points // 2
    return {
        "values": values,
        "rise": rise,
        "lower95": _crossing(values[: middle + 1][::-1], rise[: middle + 1][::-1]),
        "upper95": _crossing(values[middle:], rise[middle:]),
    }


def _index_and_deviation(result: FitResult, name: str) -> tuple[int, float]:
    """The parameter's place in the vector and its standard error, internal unit."""
    labels = [u.label for u in result.problem.unknowns]
    if name not in labels:
        raise InputError(f"'{name}' is not a free parameter of this fit; free are {', '.join(labels)}")
    index = labels.index(name)
    variance = result.covariance[index, index]
    deviation = math.sqrt(variance) if np.isfinite(variance) else math.nan
    if not math.isfinite(deviation):
        raise InputError(
            f"'{name}' has no finite standard error in this fit (it is at its bound, or the data do not determine "
            "it): no profile can be computed"
        )
    return index, deviation


def _crossing(values: np.ndarray, rise: np.ndarray, level: float = _CHI2_95) -> float | None:
    """The value, linearly interpolated, at which a profile first exceeds a level; ``None`` if it does not."""
    above = np.flatnonzero(rise > level)
    if not len(above) or above[0] == 0:
        return None
    k = above[0]
    share = (level - rise[k - 1]) / (rise[k] - rise[k - 1])
    return float(values[k - 1] + share * (values[k] - values[k - 1]))
