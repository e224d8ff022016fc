"""The shortest settling time by sequential linear programming in a trust region.

The settling time is discontinuous: where an overshoot leaves the band, the loop settles one swing later. Two quantities
are continuous: when the error first enters the band, and by how much each later swing leaves it. Both are linearised in
the gains, and a linear program gives the best change within a trust region: enter as early as possible while no later
sample leaves the band and no limit is violated.

    minimise  latest + price * slack     over the change d, the latest entry and the slack
    such that entry_i + entry_slope_i d <= latest,   rows d <= room + slack,   |d| <= region,   0 <= point + d <= 1

What cannot be kept yet is paid for by the slack. A step that does not improve latest + price * violation is taken back,
and the region shrinks.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.control.analysis.step_response import Jumps
from smajax.control.tuning.objective import LIMITS, Objective

# All constants were chosen by experiments/papers/hip/hip_gains.py; tests/unit/control/test_tuning.py holds settling
# time and rollouts.

# First, largest and smallest radius of the trust region: changes of the gains' logarithms.
_FIRST_RADIUS = 0.25
_MAX_RADIUS = 0.6
_MIN_RADIUS = 1e-3
# Factors of the radius: after a program without a useful step, after a good step, and after one that is taken back.
_SHRINK_IDLE = 0.3
_GROW = 1.6
_SHRINK = 0.35
# A step below this share of the smallest radius is none.
_MIN_STEP = 0.1
# Price of the slack, in horizons: a violation of order one costs more than any settling time within the horizon.
_PRICE = 2.0
# Improvement, in horizons, that is rounding.
_ROUNDING = 1e-6
# Relative improvement of the settling time that ends the search.
_MIN_IMPROVEMENT = 1e-3
# Largest number of rows of a program: those nearest to their bounds.
_MAX_ROWS = 3000
# Share of the band and of the overshoot that a program asks for: gains on the very edge would lose it to rounding.
_BAND_SHARE = 0.98
# Rate of the error below which its entry into the band cannot be moved, 1/s.
_MIN_RATE = 1e-12


class LinearisedResponse(NamedTuple):
    """Response at a point, and its derivatives with respect to the point.

    Args:
        share: Error over the jump, shape ``(m, n)``.
        violations: Violations of the limits, shape ``(m, 5, n)``.
        share_slope: Derivatives of ``share``, shape ``(m, n, p)``.
        violations_slope: Derivatives of ``violations``, shape ``(m, 5, n, p)``.
    """

    share: np.ndarray
    violations: np.ndarray
    share_slope: np.ndarray
    violations_slope: np.ndarray


class _Program(NamedTuple):
    """The linear program at a point, and the point's merit.

    ``rows`` times a change of the point is at most ``room`` plus the slack; ``latest`` is the latest entry into the
    band in s.
    """

    entries: np.ndarray
    entry_slopes: np.ndarray
    rows: np.ndarray
    room: np.ndarray
    latest: float
    violation: float


def settling_slp(
    linearised_at: Callable[[np.ndarray], LinearisedResponse],
    start: np.ndarray,
    span: np.ndarray,
    jumps: Jumps,
    objective: Objective,
    period: float,
    report: Callable[[np.ndarray, float, float], None],
    *,
    evaluations: int,
) -> np.ndarray:
    """Minimise the latest entry into the settling band.

    Args:
        linearised_at: Maps a point to the linearised response.
        start: Start in the unit box, shape ``(p,)``.
        span: Logarithms of upper over lower bound of the gains, shape ``(p,)``.
        jumps: Jumps of the reference.
        objective: Band and limits.
        period: Time between samples, s.
        report: Called with each improved point, its latest entry (s) and its violation.
        evaluations: Largest number of evaluations.

    Returns:
        The best point, shape ``(p,)``.
    """
    horizon = float(np.max(jumps.since_jump))
    point, radius, price = start, _FIRST_RADIUS, _PRICE * horizon
    program = _build_program(linearised_at(point), jumps, objective, period)
    report(point, program.latest, program.violation)
    for _ in range(evaluations - 1):
        change = _solve(program, point, span, radius, price)
        if change is None or np.max(np.abs(change * span)) < _MIN_STEP * _MIN_RADIUS:
            radius *= _SHRINK_IDLE
            if radius < _MIN_RADIUS:
                break
            continue
        new_point = np.clip(point + change, 0.0, 1.0)
        new = _build_program(linearised_at(new_point), jumps, objective, period)
        merit, new_merit = (p.latest + price * p.violation for p in (program, new))
        if new_merit < merit - _ROUNDING * horizon:
            improvement = program.latest + price * program.violation - new.latest - price * new.violation
            point, program = new_point, new
            report(point, program.latest, program.violation)
            radius = min(_GROW * radius, _MAX_RADIUS)
            if program.violation == 0.0 and improvement < _MIN_IMPROVEMENT * program.latest:
                break
        else:
            radius *= _SHRINK
            if radius < _MIN_RADIUS:
                break
    return point


def _build_program(response: LinearisedResponse, jumps: Jumps, objective: Objective, period: float) -> _Program:
    band = objective.band
    overshoot = float(objective.limits[LIMITS.index("overshoot")])
    entries, entry_slopes, rows, room = [], [], [], []
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
            # From the first turn in the band on it must not leave it; a tighter limit on overshoot holds from the jump
            # on.
            violation = max(violation, _excess(np.abs(piece[turn:]), band, band))
            for sign in (1.0, -1.0):
                rows.append(sign * slope[turn:] / band)
                room.append((_BAND_SHARE * band - sign * piece[turn:]) / band)
            if math.isfinite(overshoot):
                violation = max(violation, _excess(piece, overshoot, band))
                rows.append(slope / band)
                room.append((overshoot - (1.0 - _BAND_SHARE) * band - piece) / band)
    others = [i for i, name in enumerate(LIMITS) if name not in ("overshoot", "settling")]
    limits = np.nan_to_num(response.violations[:, others], posinf=1e9).reshape(-1)
    violation = max(violation, float(np.max(limits, initial=0.0)))
    rows.append(np.nan_to_num(response.violations_slope[:, others]).reshape(len(limits), -1))
    room.append(-limits)
    all_rows, all_room = np.concatenate(rows), np.concatenate(room)
    nearest = np.argsort(all_room)[:_MAX_ROWS]
    return _Program(
        np.array(entries), np.array(entry_slopes), all_rows[nearest], all_room[nearest], max(entries), violation
    )


def _entry_time(share: np.ndarray, slope: np.ndarray, k: int, band: float, period: float) -> tuple[float, np.ndarray]:
    """Time of the first entry into the band, at row ``k``, by linear interpolation, and its derivatives."""
    rate = (share[k] - share[k - 1]) / period if k else 1.0
    edge = math.copysign(band, share[k - 1]) if k else 0.0
    part = (edge - share[k - 1]) / (share[k] - share[k - 1]) if k else 0.0
    time = (k - 1 + part) * period if k else 0.0
    return time, -slope[k] / rate if abs(rate) > _MIN_RATE else np.zeros(slope.shape[1])


def _excess(values: np.ndarray, limit: float, band: float) -> float:
    return max(float(np.max(values, initial=-math.inf)) - limit, 0.0) / band


def _entry_row(share: np.ndarray, band: float) -> int:
    """The first row within the band; the last row if there is none."""
    inside = np.flatnonzero(np.abs(share) <= band)
    return int(inside[0]) if len(inside) else len(share) - 1


def _first_turn(share: np.ndarray, entry: int) -> int:
    """The row at which the error, on its way into the band at ``entry``, first turns back."""
    direction = np.sign(share[entry] - share[entry - 1]) if entry else 1.0
    back = np.flatnonzero(np.diff(share[entry:]) * direction < 0.0)
    return entry + int(back[0]) if len(back) else len(share) - 1


def _solve(program: _Program, point: np.ndarray, span: np.ndarray, radius: float, price: float) -> np.ndarray | None:
    """The best change of the point; the unknowns are the change, the latest entry and the slack."""
    size, entries, rows = len(point), len(program.entries), len(program.rows)
    entry_rows = np.column_stack([program.entry_slopes, -np.ones(entries), np.zeros(entries)])
    limit_rows = np.column_stack([program.rows, np.zeros(rows), -np.ones(rows)])
    radii = radius / np.maximum(span, 1e-12)
    bounds = [
        (max(-r, -x), min(r, 1.0 - x)) if s > 0.0 else (0.0, 0.0) for r, x, s in zip(radii, point, span, strict=True)
    ]
    result = scipy.optimize.linprog(
        np.r_[np.zeros(size), 1.0, price],
        A_ub=np.concatenate([entry_rows, limit_rows]),
        b_ub=np.concatenate([-program.entries, program.room]),
        bounds=[*bounds, (0.0, None), (0.0, None)],
        method="highs",
    )
    return result.x[:size] if result.success else None


@eqx.filter_jit
def _values_and_slopes(response: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: jax.Array) -> tuple:
    """Values and derivatives of ``response`` in the order of ``LinearisedResponse``."""

    def evaluate_twice(point: jax.Array) -> tuple:
        values = response(point)
        return values, values

    slopes, values = jax.jacfwd(evaluate_twice, has_aux=True)(point)
    return (*values, *slopes)


def linearise(response: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: np.ndarray) -> LinearisedResponse:
    """Return the linearised response at a point, shape ``(p,)``.

    Args:
        response: Maps a point to the error over the jump and the violations; a pytree, so that it is compiled once.
        point: The point.
    """
    return LinearisedResponse(*(np.asarray(leaf) for leaf in _values_and_slopes(response, jnp.asarray(point))))
