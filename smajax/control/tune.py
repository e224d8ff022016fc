"""Gains by gradients through the rollout, from one start or several, within limits or without.

What a search asks for decides who looks for it: ``unlimited`` where nothing limits the loop, ``limited`` where something does, and
``soonest`` where it is to settle as soon as it can, or soon enough.
"""

import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np

from smajax.control import metrics
from smajax.control.limited import limited
from smajax.control.objective import LIMITS, TERMS, wanted_of
from smajax.control.soonest import SETTLING, longest_settling, near, soon_enough, soonest
from smajax.control.tuner import BATCH, LOOSE, Tuner, order
from smajax.control.tuning import Tuning
from smajax.control.unlimited import unlimited
from smajax.errors import InputError

_SCREENED = 16


class Tuned(NamedTuple):
    """The best gains found: ``point`` in the unit box, ``gains`` in internal units, ``terms`` over those at the start, the largest
    violation of each limit (at most 0 where it is kept), whether all are kept, the settling time that is kept, and the rollouts spent.

    ``history`` has a row (rollouts, settling time or sum of the weighted terms) for each improvement that keeps all limits.
    """

    point: np.ndarray
    gains: dict[str, float]
    terms: dict[str, float]
    violated: dict[str, float]
    feasible: bool
    settling: float
    rollouts: int
    history: tuple[tuple[int, float], ...]


def least_broken(one: Tuned) -> tuple[bool, float, float]:
    """What results are compared by: limits broken, settling, of which the violation tells little, by its time and after the others."""
    others = sum(v for name, v in one.violated.items() if name != "settling" and v > LOOSE)
    return not one.feasible, others, one.settling if "settling" in one.violated else 0.0


def objective_of(tuning: Tuning, weights: Mapping[str, float]) -> Callable[[np.ndarray], float]:
    """The weighted terms that ``tune`` makes small, as a number at a point of the unit box: for other searches to be compared with."""
    tuner = Tuner(tuning, wanted_of(weights, {}), lambda steps, cost: None)
    return lambda point: tuner.candidates(np.asarray(point)[None])[0].cost


def tune(
    tuning: Tuning,
    weights: Mapping[str, float],
    limits: Mapping[str, float],
    *,
    settle: bool = False,
    starts: int = 1,
    seed: int = 0,
    band: float = metrics.BAND,
    progress: Callable[[int, float], None] = lambda steps, cost: None,
) -> Tuned:
    """Tunes from the loop's own gains and, with ``starts`` above 1, from drawn ones that look better.

    Gradients are followed from the own gains and the ``starts - 1`` best of those drawn. Where nothing limits, quadratics lead on from each
    of several starts by one member, and from the best of these by all.

    ``weights`` are of ``objective.TERMS``, ``limits`` of ``objective.LIMITS``; ``settle`` makes the settling time as small as it goes
    within the other limits, from where the terms are small. Raises ``InputError`` if nothing is wanted, ``NumericsError`` if no point can
    be rolled out.
    """
    if not weights and not settle:
        raise InputError(f"nothing is wanted of the loop: give a weight to one of {', '.join(TERMS)}, or ask for the fastest settling")
    if settle and not np.any(np.asarray(tuning.task.size)):
        raise InputError("the reference never jumps and holds, so nothing settles: ask for tracking instead")
    wanted = wanted_of(weights or SETTLING, limits, band)
    tuner = Tuner(tuning, wanted, progress, settle)
    points = _starts(tuner, starts, seed)
    if settle:
        found = soonest(tuner, near(tuner, points))
    elif tuner.plain:
        found = unlimited(tuner, points)
    else:
        found = limited(tuner, points)
        if limits.get("settling", math.inf) < math.inf:
            found = soon_enough(tuner, found, points)
    terms, violated = tuner.look(found[None])
    kept = float(np.max(violated[0])) <= LOOSE
    value = {name: float(v) for name, v in tuning.gains(found).items()}
    return Tuned(
        point=found,
        gains=value,
        terms={t: float(v) for t, v in zip(TERMS, terms[0] / tuner.scale, strict=True)},
        violated={k: float(v) for k, v in zip(LIMITS, violated[0], strict=True) if k in limits},
        feasible=kept,
        settling=longest_settling(tuning, found, band),
        rollouts=tuner.rollouts,
        history=tuple(tuner.history),
    )


def _starts(tuner: Tuner, starts: int, seed: int) -> np.ndarray:
    """The loop's own gains, and the best of many drawn ones: by violations first, then by terms."""
    own = tuner.tuning.start[None]
    if starts <= 1:
        return own
    drawn = np.random.default_rng(seed).uniform(size=(max(_SCREENED, BATCH * -(-starts // 2)), own.shape[1]))
    members = tuner.tuning.alone() if tuner.plain else tuner.tuning
    found = [one for k in range(0, len(drawn), BATCH) for one in tuner.candidates(drawn[k : k + BATCH], members)]
    return np.vstack([own, *(one.point for one in sorted(found, key=order)[: starts - 1])])
