"""Gains within limits, by an augmented Lagrangian and by quadratics."""

import math

import jax.numpy as jnp
import numpy as np
import scipy.stats

from smajax.control.tuner import BATCH, Tuner, order, violations
from smajax.control.unlimited import BY_ALL, unlimited

_GROSS = 1.0  # a violation from which a search is not begun
_RAISES = 8
_STEPS, _SMALL_STEP = 10, 20.0  # steps of a search; one over the length of its first step at most, the box being one wide
_REACH = 0.06  # of the box: how far gains go between two looks at what limits cost; else they flee to where nothing moves
_SPREAD = 64  # points looked at by one member, where limits keep the search from where the terms are small
_LIMITED = (0.15, 0.004, 80)  # of quadratics by one member: see ``unlimited``


def limited(tuner: Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small within the limits, from where they are small without, to one member at least.

    If that breaks a limit, by an augmented Lagrangian, or from the best point known if it breaks it by far; then by quadratics of the terms
    and of the limits: a limit of a loop that turns unstable, or rests, near it has no slope that leads anywhere.
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
    if tried[0].worst > 0.0:
        # From elsewhere, too: the best point within the limits may be a loop that does nothing, from which no way leads on.
        alone = tuner.tuning.alone()
        spread = scipy.stats.qmc.Sobol(len(point), scramble=False).random(_SPREAD) + 0.5 / _SPREAD  # amid cells, none on an edge
        seen = [one for k in range(0, _SPREAD, BATCH) for one in tuner.candidates(spread[k : k + BATCH], alone)]
        begun = {p.tobytes(): p for p in (best.point, tried[0].point, points[0], min(seen, key=order).point)}.values()
        led = min((tuner.quadratics(p, alone, *_LIMITED) for p in begun), key=order)
        best = min(best, tuner.quadratics(led.point, tuner.tuning, *BY_ALL), key=order)
    return best.point
