"""The shortest settling time, by linear programs in a trust region.

Settling jumps: when an overshoot leaves the band, the loop settles a swing later. What does not jump is when the error first enters the
band, and how far each later swing leaves it. Both are linear in small changes of the gains, so that a linear program gives the best change
within a trust region: enter as early as possible, and let no later sample leave the band, nor any limit be passed. What cannot be kept yet
is paid for by a slack. A step that does not help is taken back, and the region shrunk.
"""

import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.control import metrics
from smajax.control.objective import LIMITS, Wanted

_FIRST, _WIDEST, _NARROWEST = 0.25, 0.6, 1e-3  # of a trust region: changes of the gains' logarithms
_SMALL = 1e-3  # of the settling time: a gain that ends the search
_ROWS = 3000  # of a linear program
_SHARE = 0.98  # of the band and of overshoot that a program asks for: gains on their very edge would be lost by the next rounding


class Shape(NamedTuple):
    """At a point: error over the jump, shape ``(m, n)``, violations of the limits, ``(m, 5, n)``, and their derivatives, ``(..., p)``."""

    share: np.ndarray
    violated: np.ndarray
    share_by: np.ndarray
    violated_by: np.ndarray


class _Standing(NamedTuple):
    """Where the loop stands: first entries into the band with their derivatives, rows of constraints, and the merit.

    ``rows`` times a change of the gains is at most ``room`` plus the slack.
    """

    entries: np.ndarray
    entries_by: np.ndarray
    rows: np.ndarray
    room: np.ndarray
    late: float
    worst: float


def fastest(
    shape: Callable[[np.ndarray], Shape],
    start: np.ndarray,
    span: np.ndarray,
    found: metrics.Jumps,
    wanted: Wanted,
    period: float,
    note: Callable[[np.ndarray, float, float], None],
    *,
    evaluations: int,
) -> np.ndarray:
    """The best point of the unit box from ``start``; ``span``, shape ``(p,)``, are the logarithms of upper over lower bound.

    ``note`` is told each point that is better than those before, its latest entry into the band (s) and what it violates.
    """
    horizon = float(np.max(found.since))
    point, region = start, _FIRST
    at = _stand(shape(point), found, wanted, period)
    price = 2.0 * horizon
    note(point, at.late, at.worst)
    for _ in range(evaluations - 1):
        change = _program(at, point, span, region, price)
        if change is None or np.max(np.abs(change * span)) < 0.1 * _NARROWEST:
            region *= 0.3
            if region < _NARROWEST:
                break
            continue
        tried = np.clip(point + change, 0.0, 1.0)
        then = _stand(shape(tried), found, wanted, period)
        if then.late + price * then.worst < at.late + price * at.worst - 1e-6 * horizon:
            gained = at.late + price * at.worst - then.late - price * then.worst
            point, at = tried, then
            note(point, at.late, at.worst)
            region = min(1.6 * region, _WIDEST)
            if at.worst == 0.0 and gained < _SMALL * at.late:
                break
        else:
            region *= 0.35
            if region < _NARROWEST:
                break
    return point


def _stand(shape: Shape, found: metrics.Jumps, wanted: Wanted, period: float) -> _Standing:
    band, over = wanted.band, float(wanted.limits[LIMITS.index("overshoot")])
    entries, entries_by, rows, room = [], [], [], []
    finite = np.all(np.isfinite(shape.share)) and np.all(np.isfinite(shape.violated))
    worst = 0.0 if finite else math.inf
    for share, by in zip(np.nan_to_num(shape.share), np.nan_to_num(shape.share_by), strict=True):
        for first, end in found.ends():
            piece, slope = share[first:end], by[first:end]
            k = _entry(piece, band)
            rate = (piece[k] - piece[k - 1]) / period if k else 1.0
            edge = math.copysign(band, piece[k - 1]) if k else 0.0
            part = (edge - piece[k - 1]) / (piece[k] - piece[k - 1]) if k else 0.0
            entries.append((k - 1 + part) * period if k else 0.0)
            entries_by.append(-slope[k] / rate if abs(rate) > 1e-12 else np.zeros(slope.shape[1]))
            swing = _swing(piece, k)
            # Once in the band it stays there; where a limit on overshoot is tighter, that holds from the jump on.
            worst = max(worst, _excess(np.abs(piece[swing:]), band, band))
            for sign in (1.0, -1.0):
                rows.append(sign * slope[swing:] / band)
                room.append((_SHARE * band - sign * piece[swing:]) / band)
            if math.isfinite(over):
                worst = max(worst, _excess(piece, over, band))
                rows.append(slope / band)
                room.append((over - (1.0 - _SHARE) * band - piece) / band)
    others = [i for i, name in enumerate(LIMITS) if name not in ("overshoot", "settling")]
    limits = np.nan_to_num(shape.violated[:, others], posinf=1e9).reshape(-1)
    worst = max(worst, float(np.max(limits, initial=0.0)))
    rows.append(np.nan_to_num(shape.violated_by[:, others]).reshape(len(limits), -1))
    room.append(-limits)
    all_rows, all_room = np.concatenate(rows), np.concatenate(room)
    near = np.argsort(all_room)[:_ROWS]
    return _Standing(np.array(entries), np.array(entries_by), all_rows[near], all_room[near], max(entries), worst)


def _excess(values: np.ndarray, limit: float, band: float) -> float:
    return max(float(np.max(values, initial=-math.inf)) - limit, 0.0) / band


def _entry(share: np.ndarray, band: float) -> int:
    """The first row within the band; the last row if there is none."""
    inside = np.flatnonzero(np.abs(share) <= band)
    return int(inside[0]) if len(inside) else len(share) - 1


def _swing(share: np.ndarray, entry: int) -> int:
    """The row at which the error, on its way into the band at ``entry``, first turns back."""
    going = np.sign(share[entry] - share[entry - 1]) if entry else 1.0
    back = np.flatnonzero(np.diff(share[entry:]) * going < 0.0)
    return entry + int(back[0]) if len(back) else len(share) - 1


def _program(at: _Standing, point: np.ndarray, span: np.ndarray, region: float, price: float) -> np.ndarray | None:
    """The best change of the point: unknowns are the change, the latest entry and the slack."""
    size = len(point)
    first = np.column_stack([at.entries_by, -np.ones(len(at.entries)), np.zeros(len(at.entries))])
    second = np.column_stack([at.rows, np.zeros(len(at.rows)), -np.ones(len(at.rows))])
    reach = region / np.maximum(span, 1e-12)
    bounds = [(max(-r, -x), min(r, 1.0 - x)) if s > 0.0 else (0.0, 0.0) for r, x, s in zip(reach, point, span, strict=True)]
    solved = scipy.optimize.linprog(
        np.r_[np.zeros(size), 1.0, price],
        A_ub=np.concatenate([first, second]),
        b_ub=np.concatenate([-at.entries, at.room]),
        bounds=[*bounds, (0.0, None), (0.0, None)],
        method="highs",
    )
    return solved.x[:size] if solved.success else None


@eqx.filter_jit
def shapes(parts: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: jax.Array) -> tuple:
    """Values and derivatives of ``parts``, as a ``Shape`` has them."""

    def both(point: jax.Array) -> tuple:
        found = parts(point)
        return found, found

    by, values = jax.jacfwd(both, has_aux=True)(point)
    return (*values, *by)


def shape_at(parts: Callable[[jax.Array], tuple[jax.Array, jax.Array]], point: np.ndarray) -> Shape:
    """The shape at a point."""
    return Shape(*(np.asarray(leaf) for leaf in shapes(parts, jnp.asarray(point))))
