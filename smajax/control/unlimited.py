"""Gains where nothing limits the loop: by gradients, and by quadratics then if there are several starts.

Gradients are followed by one member first, since all go the same way from afar, and by all of them then. They end where a wire's loop is
rough: some gains let it hunt through small loops of its hysteresis or chatter between its limits, and there what a change of the gains
does at once tells nothing of what it does in the end. If more than one start is asked for, quadratics through looks that lie a good way
apart, to which roughness is little, lead on from there: SciPy's COBYQA, by one member and then by all. Where one member's gains suit its
own noise only, a few members lead between these two.
"""

import math

import numpy as np

from smajax.control.trust_region import Place
from smajax.control.tuner import Tuner, order

_REGION, _CLOSE = 0.1, 0.03  # of the box: the trust region to begin with, and that of all members from where one has led
_ALONE, _ALL, _FEW = 20, 30, 12  # steps at most: of one member, of all from the start, and of all from there
_COARSE, _FINE = 0.01, 1e-3  # of the box, a region that ends a search: of one member, of all
# Of quadratics, of the box: how far looks lie apart at first and in the end, and how many there are at most.
_BY_ONE, _BY_SOME, BY_ALL = (0.15, 0.01, 80), (0.08, 0.008, 30), (0.04, 0.004, 40)
_SOME = 3  # members
_ASTRAY = 1.5  # times one member's cost: what all make of gains that one has led astray


def unlimited(tuner: Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small where nothing limits them: by gradients, and by quadratics then if there are several starts.

    The first of the ``points`` is the tuner's own start.
    """
    if len(points) == 1:
        place, steps = Place(tuner.known().point, math.inf, None, _REGION), _ALL
        if tuner.tuning.count > 1:
            place = tuner.follow(place, tuner.tuning.alone(), _COARSE, _ALONE)
            place, steps = place._replace(radius=max(place.radius, _CLOSE)), _FEW
        tuner.follow(place, tuner.tuning, _FINE, steps)
        return tuner.known().point
    alone, ended, single = tuner.tuning.alone(), [], tuner.tuning.count == 1
    for point in points:
        place = tuner.follow(Place(point, math.inf, None, _REGION), alone, *((_FINE, _ALL) if single else (_COARSE, _ALONE)))
        ended.append(tuner.quadratics(place.point, alone, *_BY_ONE))
    best = min(ended, key=order)
    if tuner.tuning.count > _SOME and tuner.candidates(best.point[None])[0].cost > _ASTRAY * best.cost:
        best = tuner.quadratics(best.point, tuner.tuning.first(_SOME), *_BY_SOME)
    tuner.quadratics(best.point, tuner.tuning, *BY_ALL)
    if single:
        tuner.follow(Place(tuner.known().point, math.inf, None, _CLOSE), alone, _FINE, _ALL)
    return tuner.known().point
