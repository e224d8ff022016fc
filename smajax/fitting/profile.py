"""Profile likelihood of one parameter."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from statistics import NormalDist
from typing import Any, cast

import numpy as np

from smajax.errors import Cancelled, InputError, suggestion
from smajax.fitting.abstract_problem import residual
from smajax.fitting.intervals import unit_noise_variances
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartSolver
from smajax.fitting.result import FitResult
from smajax.fitting.unknowns import Settings

# 95 % quantile of the chi-squared distribution with one degree of freedom, 3.84.
CHI2_95 = NormalDist().inv_cdf(0.975) ** 2
# Ends of a search at which the cost is that of a minimum.
_ENDED = (SolverStatus.converged, SolverStatus.stalled)
# Values over the bounds of a parameter that is not determined; the factor by which the distance to an excluded value is
# divided, and the share of the bounds at which that is close enough; the most searches. Chosen by trial.
_VALUES = 16
_REFINEMENT = 3.0
_CLOSE = 1e-3
_MOST_VALUES = 100
# Relative tolerance of the searches along a profile: tighter than a fit's, since their costs are compared. Chosen by
# trial; the tests of profiles in tests/unit/fitting/test_fit.py hold it.
_RTOL = 1e-9


def profile_likelihood(
    result: FitResult,
    name: str,
    *,
    points: int = 9,
    width: float = 3.0,
    progress: Callable[[int, float], object] = lambda step, cost: None,
) -> dict[str, Any]:
    """Compute the best cost with one parameter held at several values.

    A parameter without a standard error is held at values over the whole of its bounds.

    Args:
        result: A fit.
        name: Label of a free parameter.
        points: Number of values, odd and at least 3: the one in the middle is the estimate.
        width: The values reach this number of standard errors to either side, above 0; or the bounds.
        progress: Called after each step of the searches with its number and the best cost so far; it may interrupt.

    Returns:
        ``values`` (points,) in the internal unit; ``rise`` (points,) of the cost, in units in which 3.84 bounds a 95 %
        interval, corrected for the noise's autocorrelation, NaN where the search at that value did not converge;
        ``lower95`` and ``upper95``, ``None`` where the rise does not reach 3.84 within the range, or before a value
        without a rise.

    Raises:
        InputError: The parameter is not free, is at its bound, or has neither error nor bounds; or a wrong range.
        Cancelled: The searches were interrupted.
    """
    _check_range(points, width)
    index, deviation = _index_and_deviation(result, name)
    if not math.isfinite(deviation):
        return _profile_over_bounds(result, index, progress)
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
    search = solver.advance(progress=progress).result()
    if SolverStatus.interrupted in search.statuses:
        raise Cancelled(f"the profile of {name} was cancelled before its searches had ended")
    middle = points // 2
    rise = (search.costs - result.cost) * _variance_ratio(result, search.jacobians[middle], index)
    rise[[status not in _ENDED for status in search.statuses]] = np.nan
    rise[middle] = 0.0
    return {
        "values": values,
        "rise": rise,
        "lower95": crossing(values[: middle + 1][::-1], rise[: middle + 1][::-1]),
        "upper95": crossing(values[middle:], rise[middle:]),
    }


def profile_labels(names: Sequence[str], settings: Settings, recordings: Sequence[str]) -> list[str]:
    """Return the labels of the parameters to profile; a parameter per recording has one for each recording.

    Args:
        names: Names or labels of free parameters.
        settings: The settings of the fit.
        recordings: Names of the training recordings.

    Raises:
        InputError: A parameter is not free.
    """
    own = dict.fromkeys([*settings.per_recording, *(f"initial.{state}" for state in settings.initial)])
    free = list(dict.fromkeys([*settings.free, *own]))
    labels_of = {name: [f"{name}@{r}" for r in recordings] if name in own else [name] for name in free}
    labels_of |= {label: [label] for labels in list(labels_of.values()) for label in labels}
    for name in names:
        if name not in labels_of:
            hint = suggestion(name, free)
            raise InputError(
                f"profile {name}: this parameter is not free{hint}: the free ones are {', '.join(free)}",
                code="profile-not-free",
                parameter=name,
            )
    return [label for name in names for label in labels_of[name]]


def _check_range(points: int, width: float) -> None:
    """Refuse a number of values without one in the middle, and a range without a length."""
    if points < 3 or points % 2 == 0:
        raise InputError(
            f"points: a profile has the estimate in the middle of its values, and {points} is not an odd number of at "
            "least 3: give one, such as 9"
        )
    if not 0.0 < width < math.inf:
        raise InputError(f"width: the values cannot reach {width:g} standard errors: give a number above 0, such as 3")


@dataclass
class _Side:
    """One side of a profile over bounds.

    Attributes:
        end: The bound.
        vector: Solution at the last value that is not excluded.
        value: That value.
        limit: Nearest value that is excluded; the bound while there is none.
        values: Values in the order outwards, without the estimate.
        rises: Their rises; NaN where the search did not converge.
        excluded: Rise at ``limit``; ``None`` while no value is excluded.
    """

    end: float
    vector: np.ndarray
    value: float
    limit: float
    values: list[float]
    rises: list[float]
    excluded: float | None = None

    def trial(self, step: float) -> float:
        """The next value: a step further, or closer to the last one where a value has been excluded."""
        if self.excluded is not None:
            return self.value + (self.limit - self.value) / _REFINEMENT
        remaining = self.end - self.value
        return self.value + math.copysign(min(step, abs(remaining)), remaining)

    def is_done(self, span: float) -> bool:
        """Whether the bound is reached, or an excluded value is close."""
        return abs(self.limit - self.value) <= (0.0 if self.excluded is None else _CLOSE * span)

    def add(self, value: float, rise: float, vector: np.ndarray) -> None:
        """Add the result at a value."""
        if rise <= CHI2_95:
            self.value, self.vector = value, vector
            self.values.append(value)
            self.rises.append(rise)
        else:
            self.limit, self.excluded = value, rise


def _profile_over_bounds(result: FitResult, index: int, progress: Callable[[int, float], object]) -> dict[str, Any]:
    """Profile of a parameter without a standard error: outwards from the estimate, each value from the last solution.

    The other parameters have to follow along a valley, which a search from the estimate may miss.
    """
    name, scale = result.estimates[index].name, result.problem.unknowns[index].scale
    bounds = [float(b[index]) * scale for b in result.problem.bounds]
    if not all(map(math.isfinite, bounds)):
        problem = f"the data do not determine '{name}', which has no bounds"
        raise InputError(f"{problem}: give it bounds under [fit] bounds, over which its profile is computed")
    estimate, span = result.estimates[index].estimate, bounds[1] - bounds[0]
    sides = [_Side(bound, np.array(result.vector), estimate, bound, [], []) for bound in bounds]
    lower, upper = (np.tile(b, (2, 1)) for b in result.problem.bounds)
    ratio = math.nan
    for step in range(_MOST_VALUES):
        trials = [side.value if step == 0 or side.is_done(span) else side.trial(span / _VALUES) for side in sides]
        lower[:, index] = upper[:, index] = np.array(trials) / scale
        starts = np.array([side.vector for side in sides])
        solver = MultiStartSolver(residual, result.problem, starts, lower, upper, size=result.problem.size, rtol=_RTOL)
        search = solver.advance(progress=progress).result()
        if SolverStatus.interrupted in search.statuses:
            raise Cancelled(f"the profile of {name} was cancelled before its searches had ended")
        if step == 0:
            ratio = _variance_ratio(result, search.jacobians[0], index)
            continue
        for k, side in enumerate(sides):
            if not side.is_done(span):
                ended = search.statuses[k] in _ENDED
                rise = (search.costs[k] - result.cost) * ratio if ended else math.nan
                side.add(trials[k], float(rise), np.asarray(search.points[k]))
        if all(side.is_done(span) for side in sides):
            break
    return _joined(estimate, sides)


def _joined(estimate: float, sides: Sequence[_Side]) -> dict[str, Any]:
    """The two sides of a profile as one, with its ends."""
    ends, parts = [], []
    for side in sides:
        limit = [] if side.excluded is None else [(side.limit, side.excluded)]
        pairs = [(estimate, 0.0), *zip(side.values, side.rises, strict=True), *limit]
        parts.append(pairs)
        ends.append(crossing(*np.array(pairs).T) if len(pairs) > 1 else None)
    values, rise = np.array([*parts[0][:0:-1], *parts[1]]).T
    return {"values": values, "rise": rise, "lower95": ends[0], "upper95": ends[1]}


def _variance_ratio(result: FitResult, jacobian: np.ndarray, index: int) -> float:
    """Variance by white noise of variance 1 over the variance of an estimate.

    Near the estimate the cost rises by the squared distance over the former. The product is the squared distance in
    standard errors, which take the noise and its autocorrelation into account. For a parameter without a variance it
    is the median of those of the others; without any, that of white noise.
    """
    variances = np.diag(result.covariance)
    free = np.isfinite(variances)
    scales = np.array([unknown.scale for unknown in result.problem.unknowns])
    ratios = unit_noise_variances(jacobian[:, free]) * scales[free] ** 2 / variances[free]
    if free[index]:
        return float(ratios[np.count_nonzero(free[:index])])
    usable = ratios[np.isfinite(ratios)]
    return float(np.median(usable)) if len(usable) else len(jacobian) / result.cost


def _index_and_deviation(result: FitResult, name: str) -> tuple[int, float]:
    """The parameter's place in the vector and its standard error, internal unit; infinite if not determined."""
    labels = [u.label for u in result.problem.unknowns]
    if name not in labels:
        raise InputError(f"'{name}' is not a free parameter of this fit; free are {', '.join(labels)}")
    index = labels.index(name)
    if result.estimates[index].at_bound:
        problem = f"'{name}' is at its bound in this fit, where no profile can be computed"
        raise InputError(f"{problem}: widen the bound under [fit] bounds")
    variance = result.covariance[index, index]
    return index, math.sqrt(variance) if np.isfinite(variance) else math.inf


def crossing(values: np.ndarray, rise: np.ndarray, level: float = CHI2_95) -> float | None:
    """Return the value at which a profile first exceeds a level.

    The square root of the rise, which is a straight line for a parabola, is interpolated by a monotone cubic.

    Args:
        values: Values (n,) of the parameter from its estimate outwards.
        rise: Rise (n,) of the cost at these values, from 0; NaN where its search did not converge.
        level: The level.

    Returns:
        The value; ``None`` if the rise does not reach the level before the end or before a value without a rise.
    """
    distance = np.abs(values - values[0])
    # Values that a bound has clipped repeat it.
    usable = np.isfinite(rise) & (np.diff(distance, prepend=-1.0) > 0.0)
    count = len(rise) if np.all(usable) else int(np.argmin(usable))
    root = np.sqrt(np.maximum(rise[:count], 0.0)) - math.sqrt(level)
    above = np.flatnonzero(root > 0.0)
    if not len(above) or above[0] == 0:
        return None
    from scipy.interpolate import PchipInterpolator  # slow to import, and seldom needed
    from scipy.optimize import brentq

    curve = PchipInterpolator(distance[:count], root)
    step = float(cast(Any, brentq(curve, distance[above[0] - 1], distance[above[0]])))
    return float(values[0] + math.copysign(step, values[count - 1] - values[0]))
