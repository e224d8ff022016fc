"""Gains within limits, by an augmented Lagrangian, by quadratics and, where many members have to keep them, by a population."""

import math

import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.stats

from smajax.control.tuner import BATCH, Candidate, Tuner, order, violations
from smajax.control.unlimited import BY_ALL, unlimited

_GROSS = 1.0  # a violation from which a search is not begun
_RAISES = 8
_STEPS, _SMALL_STEP = 10, 20.0  # steps of a search; one over the length of its first step at most, the box being one wide
_REACH = 0.06  # of the box: how far gains go between two looks at what limits cost; else they flee to where nothing moves
_SPREAD = 64  # points looked at by one member, where limits keep the search from where the terms are small
_POPULATION, _GENERATIONS = 32, 15
_NEAR = 0.15  # of the box
_PROMISES = 1.5  # times the best terms: a place elsewhere from which it is worth going on
_FAR, _OUTSIDE = 1e6, 1e3  # a cost at most; what any broken limit costs, in logarithms
_LIMITED = (0.15, 0.004, 80)  # of quadratics by one member: see ``unlimited``


def limited(tuner: Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small within the limits, from where they are small without, to one member at least.

    If that breaks a limit, by an augmented Lagrangian, or from the best point known if it breaks it by far; then by quadratics of the terms
    and of the limits: a limit of a loop that turns unstable, or rests, near it has no slope that leads anywhere. Several members that do
    not go the same way at a limit are led by a population, too. If that breaks none, several starts go on all the same where another place
    of the box promises more.
    """
    spent = tuner.rollouts
    free = Tuner(tuner.tuning.alone(), tuner.unlimited, lambda count, cost: tuner.progress(spent + count, cost))
    point = unlimited(free, points)
    tuner.rollouts += free.rollouts
    tried = tuner.candidates(np.vstack([point, points]))
    best, multipliers, before, mu = min(tried, key=order), tuner.none, math.inf, 1.0
    if tried[0].worst > _GROSS:
        point = best.point
    for turn in range(_RAISES):
        now = tuner.candidates(point[None])[0]
        if order(now) < order(best):
            best = now
            if now.worst == 0.0:
                tuner.history.append((tuner.rollouts, now.cost))
        if now.worst == 0.0 and (turn or tried[0].worst == 0.0) and not bool(jnp.any(multipliers > 0.0)):
            break
        if now.worst > 0.5 * before:
            mu *= 4.0
        before = now.worst
        multipliers = jnp.maximum(multipliers + mu * violations(tuner.tuning, jnp.asarray(point), tuner.wanted), 0.0)
        tuner.rollouts += tuner.tuning.count
        point = tuner.descend(point, tuner.wanted, multipliers, mu, _STEPS, _SMALL_STEP, _REACH).point
    kept = tried[0].worst == 0.0  # where the terms are small without limits
    if kept and len(points) == 1:
        return best.point
    # From elsewhere, too: the best point within the limits may be a loop that does nothing, from which no way leads on.
    alone = tuner.tuning.alone(_hardest(tuner, points[0]))
    spread = scipy.stats.qmc.Sobol(len(point), scramble=False).random(_SPREAD) + 0.5 / _SPREAD  # amid cells, none on an edge
    seen = [one for k in range(0, _SPREAD, BATCH) for one in tuner.candidates(spread[k : k + BATCH], alone)]
    other = min(seen, key=order)
    if not kept or order(other) < (0.0, _PROMISES * best.cost):
        begun = {p.tobytes(): p for p in (best.point, tried[0].point, points[0], other.point)}.values()
        led = min((tuner.quadratics(p, alone, *_LIMITED) for p in begun), key=order)
        best = min(best, tuner.quadratics(led.point, tuner.tuning, *BY_ALL), key=order)
        if tuner.tuning.count > 1:
            best = min(best, tuner.quadratics(_evolved(tuner, led.point).point, tuner.tuning, *BY_ALL), key=order)
    return best.point


def _evolved(tuner: Tuner, point: np.ndarray) -> Candidate:
    """The best of a population that differential evolution leads on, by all members, from the best points known and others.

    Gains that suit one member break limits of another, and what keeps them all may lie in places too small for slopes and quadratics.
    """
    known = [one.point for one in sorted(tuner.seen, key=order)[: _POPULATION // 4]]
    wide = scipy.stats.qmc.Sobol(len(point), rng=0).random(_POPULATION)
    near = point + _NEAR * (2.0 * wide[::2] - 1.0)
    first = np.clip(np.vstack([point, *known, near, wide])[:_POPULATION], 0.0, 1.0)

    def cost(points: np.ndarray) -> np.ndarray:
        found = [one for k in range(0, points.shape[1], BATCH) for one in tuner.candidates(points.T[k : k + BATCH])]
        return np.array(
            [math.log(min(max(one.cost, 1e-300), _FAR)) + (_OUTSIDE * (1.0 + one.worst) if one.worst else 0.0) for one in found]
        )

    scipy.optimize.differential_evolution(
        cost,
        [(0.0, 1.0)] * len(point),
        init=first,  # pyright: ignore[reportArgumentType]
        maxiter=_GENERATIONS,
        tol=0.0,
        polish=False,
        rng=0,
        vectorized=True,
        updating="deferred",
    )
    return min(tuner.seen, key=order)


def _hardest(tuner: Tuner, point: np.ndarray) -> int:
    """The member that breaks the limits most at a point, or comes nearest to that: gains that suit it suit most of the others."""
    if tuner.tuning.count == 1:
        return 0
    tuner.rollouts += tuner.tuning.count
    each = np.max(np.asarray(violations(tuner.tuning, jnp.asarray(point), tuner.wanted)), axis=(1, 2))
    return int(np.argmax(np.nan_to_num(each, nan=np.inf)))
