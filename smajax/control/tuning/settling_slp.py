"""The shortest settling time by sequential linear programming in a trust region.

The settling time is discontinuous: if an overshoot leaves the band, the loop settles one swing later. Two quantities
are continuous: the time at which the error first enters the band, and the distance by which later samples leave it.
Both are linearised in the gains, and a linear program gives the best change within a trust region: the earliest entry
for which no later sample leaves the band and no limit is violated.

    minimise  latest + penalty * slack   over the change d, the latest entry and the slack
    such that entry_i + entry_slope_i d <= latest,   rows d <= margins + slack,   |d| <= radius,   0 <= point + d <= 1

The slack makes the program feasible where not all constraints can be kept yet. A step that does not decrease the merit
latest + penalty * violation is rejected, and the trust region shrinks.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float

from smajax.control.analysis.step_response import Jumps
from smajax.control.tuning.objective import LIMITS, Objective
from smajax.numerics.loop_kernels import jit_with_kernels

# All constants were chosen by experiments/papers/hip/hip_gains.py; tests/unit/control/test_tuning.py holds settling
# time and rollouts.

# First, largest and smallest radius of the trust region, as changes of the gains' logarithms. Chosen by trial.
_FIRST_RADIUS = 0.25
_MAX_RADIUS = 0.6
_MIN_RADIUS = 1e-3
# Factors of the radius after a program without a useful step, after an accepted step, and after a rejected one.
# Chosen by trial.
_SHRINK_IDLE = 0.3
_GROW = 1.6
_SHRINK = 0.35
# A step below this share of the smallest radius counts as none.
_MIN_STEP = 0.1
# Penalty of the slack, in horizons (longest time after a jump): a violation of order one costs more than any settling
# time within the horizon.
_PENALTY = 2.0
# Decrease of the merit, in horizons, up to which it counts as a rounding error.
_ROUNDING = 1e-6
# Relative decrease of the settling time that ends the search.
_MIN_IMPROVEMENT = 1e-3
# Largest number of constraint rows of a program: those with the smallest margins are used.
_MAX_ROWS = 3000
# Share of the band that a program allows: a response that touches the edge could leave it by a rounding error.
_BAND_SHARE = 0.98
# Rate of the error in 1/s below which the time of its entry into the band has no useful derivative.
_MIN_RATE = 1e-12


class LinearisedResponse(NamedTuple):
    """Response at a point, and its derivatives with respect to the point.

    Attributes:
        share: Error over the jump, dimensionless, shape ``(m, n)``.
        violations: Violations of the limits, dimensionless, shape ``(m, 5, n)``.
        share_slope: Derivatives of ``share``, shape ``(m, n, p)``.
        violations_slope: Derivatives of ``violations``, shape ``(m, 5, n, p)``.
    """

    share: np.ndarray
    violations: np.ndarray
    share_slope: np.ndarray
    violations_slope: np.ndarray


class _Program(NamedTuple):
    """Linear program at a point, and the parts of the point's merit.

    Attributes:
        entries: Times of the first entry into the band in s, one for each member and jump.
        entry_slopes: Their derivatives with respect to the point, shape ``(entries, p)``.
        rows: Derivatives of the constraints, shape ``(rows, p)``: ``rows`` times a change of the point is at most
            ``margins`` plus the slack.
        margins: Distances of the constraints from their bounds, dimensionless, shape ``(rows,)``.
        latest: Latest entry, s.
        violation: Largest violation of band and limits, dimensionless.
    """

    entries: np.ndarray
    entry_slopes: np.ndarray
    rows: np.ndarray
    margins: np.ndarray
    latest: float
    violation: float

    def merit(self, penalty: float) -> float:
        """Latest entry plus the penalty of the violation, s."""
        return self.latest + penalty * self.violation


def settling_slp(
    linearised_at: Callable[[np.ndarray], LinearisedResponse],
    start: Float[np.ndarray, " gains"],
    span: Float[np.ndarray, " gains"],
    jumps: Jumps,
    objective: Objective,
    period: float,
    report: Callable[[np.ndarray, float, float], None],
    *,
    evaluations: int,
) -> Float[np.ndarray, " gains"]:
    """Minimise the latest entry into the settling band.

    Args:
        linearised_at: Function that linearises the response at a point.
        start: Start in the unit box, shape ``(p,)``.
        span: Logarithms of the ratio of upper to lower bound of the gains, shape ``(p,)``.
        jumps: Jumps of the reference.
        objective: Band and limits.
        period: Time between samples, s.
        report: Called with the start and each improved point, its latest entry (s) and its violation.
        evaluations: Largest number of linearised responses.

    Returns:
        The best point, shape ``(p,)``.
    """
    horizon = float(np.max(jumps.since_jump))
    point, radius, penalty = start, _FIRST_RADIUS, _PENALTY * horizon
    program = _build_program(linearised_at(point), jumps, objective, period)
    report(point, program.latest, program.violation)
    for _ in range(evaluations - 1):
        change = _solve(program, point, span, radius, penalty)
        if change is None or np.max(np.abs(change * span)) < _MIN_STEP * _MIN_RADIUS:
            radius *= _SHRINK_IDLE
            if radius < _MIN_RADIUS:
                break
            continue
        new_point = np.clip(point + change, 0.0, 1.0)
        new = _build_program(linearised_at(new_point), jumps, objective, period)
        merit, new_merit = program.merit(penalty), new.merit(penalty)
        if new_merit < merit - _ROUNDING * horizon:
            point, program = new_point, new
            report(point, program.latest, program.violation)
            radius = min(_GROW * radius, _MAX_RADIUS)
            if program.violation == 0.0 and merit - new_merit < _MIN_IMPROVEMENT * program.latest:
                break
        else:
            radius *= _SHRINK
            if radius < _MIN_RADIUS:
                break
    return point


def _build_program(response: LinearisedResponse, jumps: Jumps, objective: Objective, period: float) -> _Program:
    """The linear program at a point from its linearised response."""
    band = objective.band
    overshoot = float(objective.limits[LIMITS.index("overshoot")])
    entries, entry_slopes, rows, margins = [], [], [], []
    finite = np.all(np.isfinite(response.share)) and np.all(np.isfinite(response.violations))
    violation = 0.0 if finite else math.inf
    members = zip(np.nan_to_num(response.share), np.nan_to_num(response.share_slope), strict=True)
    for share, share_slope in members:
        for first, end in jumps.segments():
            piece, slope = share[first:end], share_slope[first:end]
            k = _entry_row(piece, band)
            entry, entry_slope = _entry_time(piece, slope, k, band, period)
            entries.append(entry)
            entry_slopes.append(entry_slope)
            turn = _first_turn(piece, k)
            # The error must stay in the band from its first turning point there; a limit on overshoot holds from the
            # jump on.
            violation = max(violation, _excess(np.abs(piece[turn:]), band, band))
            for sign in (1.0, -1.0):
                rows.append(sign * slope[turn:] / band)
                margins.append((_BAND_SHARE * band - sign * piece[turn:]) / band)
            if math.isfinite(overshoot):
                violation = max(violation, _excess(piece, overshoot, band))
                rows.append(slope / band)
                margins.append((overshoot - (1.0 - _BAND_SHARE) * band - piece) / band)
    others = [i for i, name in enumerate(LIMITS) if name not in ("overshoot", "settling")]
    limits = np.nan_to_num(response.violations[:, others], posinf=1e9).reshape(-1)
    violation = max(violation, float(np.max(limits, initial=0.0)))
    rows.append(np.nan_to_num(response.violations_slope[:, others]).reshape(len(limits), -1))
    margins.append(-limits)
    all_rows, all_margins = np.concatenate(rows), np.concatenate(margins)
    nearest = np.argsort(all_margins)[:_MAX_ROWS]
    return _Program(
        np.array(entries), np.array(entry_slopes), all_rows[nearest], all_margins[nearest], max(entries), violation
    )


def _entry_time(share: np.ndarray, slope: np.ndarray, k: int, band: float, period: float) -> tuple[float, np.ndarray]:
    """Time of the first entry into the band, at row ``k``, by linear interpolation, and its derivatives."""
    rate = (share[k] - share[k - 1]) / period if k else 1.0
    edge = math.copysign(band, share[k - 1]) if k else 0.0
    part = (edge - share[k - 1]) / (share[k] - share[k - 1]) if k else 0.0
    time = (k - 1 + part) * period if k else 0.0
    return time, -slope[k] / rate if abs(rate) > _MIN_RATE else np.zeros(slope.shape[1])


def _excess(values: np.ndarray, limit: float, band: float) -> float:
    """Largest excess of values over a limit, over the band; 0 if there is none."""
    return max(float(np.max(values, initial=-math.inf)) - limit, 0.0) / band


def _entry_row(share: np.ndarray, band: float) -> int:
    """The first row within the band; the last row if there is none."""
    inside = np.flatnonzero(np.abs(share) <= band)
    return int(inside[0]) if len(inside) else len(share) - 1


def _first_turn(share: np.ndarray, entry: int) -> int:
    """The row of the error's first turning point after its entry into the band; the last row if there is none."""
    direction = np.sign(share[entry] - share[entry - 1]) if entry else 1.0
    back = np.flatnonzero(np.diff(share[entry:]) * direction < 0.0)
    return entry + int(back[0]) if len(back) else len(share) - 1


def _solve(program: _Program, point: np.ndarray, span: np.ndarray, radius: float, penalty: float) -> np.ndarray | None:
    """The best change of the point, or ``None``; unknowns of the program: change, latest entry and slack."""
    size, entries, rows = len(point), len(program.entries), len(program.rows)
    entry_rows = np.column_stack([program.entry_slopes, -np.ones(entries), np.zeros(entries)])
    limit_rows = np.column_stack([program.rows, np.zeros(rows), -np.ones(rows)])
    radii = radius / np.maximum(span, 1e-12)
    bounds = [
        (max(-r, -x), min(r, 1.0 - x)) if s > 0.0 else (0.0, 0.0) for r, x, s in zip(radii, point, span, strict=True)
    ]
    result = scipy.optimize.linprog(
        np.r_[np.zeros(size), 1.0, penalty],
        A_ub=np.concatenate([entry_rows, limit_rows]),
        b_ub=np.concatenate([-program.entries, program.margins]),
        bounds=[*bounds, (0.0, None), (0.0, None)],
        method="highs",
    )
    return result.x[:size] if result.success else None


@jit_with_kernels
def _values_and_slopes(
    response: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: jax.Array
) -> tuple[Any, ...]:
    """Values and derivatives of ``response`` in the order of ``LinearisedResponse``."""

    def evaluate_twice(point: jax.Array) -> tuple[Any, ...]:
        values = response(point)
        return values, values

    slopes, values = jax.jacfwd(evaluate_twice, has_aux=True)(point)
    return (*values, *slopes)


def linearise(
    response: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: Float[np.ndarray, " gains"]
) -> LinearisedResponse:
    """Compute values and derivatives of a response at a point, by forward-mode differentiation.

    Args:
        response: Function of a point that returns the error over the jump, shape ``(m, n)``, and the violations, shape
            ``(m, 5, n)``; a pytree, so that it is compiled once.
        point: A point of the unit box, shape ``(p,)``.
    """
    return LinearisedResponse(*(np.asarray(leaf) for leaf in _values_and_slopes(response, jnp.asarray(point))))
