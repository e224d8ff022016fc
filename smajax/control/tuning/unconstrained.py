"""Gains without limits: by gradients, and from several starts by quadratic models afterwards.

Gradients are followed with one member first, since all members agree far from the minimum, and then with all of them.
They fail where a wire's loop is rough: some gains let it oscillate through small hysteresis loops or chatter between
the command's limits, and the local slope then says nothing about larger changes. If more than one start is asked for,
quadratic models through points that are further apart, on which roughness has little influence, continue from there:
SciPy's COBYQA, with one member and then with all. Where the gains of one member fit its own noise only, a few members
are used in between.
"""

import math

import numpy as np

from smajax.control.tuning.search import GainSearch, rank
from smajax.control.tuning.trust_region import SearchState

# All radii are in sizes of the box; all constants were chosen by experiments/control/wire_position.py and
# experiments/papers/rotary/rotary_tracking.py, and tests/unit/control/test_tuning.py holds the number of rollouts.

# First radius of the trust region, and that of all members after a search with one.
_RADIUS = 0.1
_RADIUS_AFTER_SINGLE = 0.03
# Largest numbers of steps: of one member, of all from the start, and of all after a search with one.
_STEPS_SINGLE = 20
_STEPS_ALL = 30
_STEPS_AFTER_SINGLE = 12
# Radius that ends a search of one member, and of all.
_COARSE = 0.01
_FINE = 1e-3
# First radius, last radius and evaluations of COBYQA with one member, with some, and with all.
_COBYQA_SINGLE = (0.15, 0.01, 80)
_COBYQA_SOME = (0.08, 0.008, 30)
COBYQA_ALL_MEMBERS = (0.04, 0.004, 40)
# Number of members that are some.
_SOME = 3
# Cost of all members, over that of the single one, above which its gains fit its own noise only.
_OVERFITTED = 1.5


def unconstrained(search: GainSearch, points: np.ndarray) -> np.ndarray:
    """Minimise the terms without limits.

    Args:
        search: The search.
        points: Starts, shape ``(k, p)``, the search's own start first.

    Returns:
        The best point that all members evaluated, shape ``(p,)``.
    """
    problem = search.problem
    single, is_single = problem.single_member(), problem.count == 1
    if len(points) == 1:
        state, steps = SearchState(search.best().point, math.inf, None, _RADIUS), _STEPS_ALL
        if not is_single:
            state = search.descend_in_trust_region(state, single, _COARSE, _STEPS_SINGLE)
            state, steps = state._replace(radius=max(state.radius, _RADIUS_AFTER_SINGLE)), _STEPS_AFTER_SINGLE
        search.descend_in_trust_region(state, problem, _FINE, steps)
        return search.best().point
    ends = []
    end_radius, steps = (_FINE, _STEPS_ALL) if is_single else (_COARSE, _STEPS_SINGLE)
    for point in points:
        state = SearchState(point, math.inf, None, _RADIUS)
        state = search.descend_in_trust_region(state, single, end_radius, steps)
        ends.append(search.search_by_cobyqa(state.point, single, *_COBYQA_SINGLE))
    best = min(ends, key=rank)
    if problem.count > _SOME and search.candidates(best.point[None])[0].cost > _OVERFITTED * best.cost:
        best = search.search_by_cobyqa(best.point, problem.first_members(_SOME), *_COBYQA_SOME)
    search.search_by_cobyqa(best.point, problem, *COBYQA_ALL_MEMBERS)
    if is_single:
        state = SearchState(search.best().point, math.inf, None, _RADIUS_AFTER_SINGLE)
        search.descend_in_trust_region(state, single, _FINE, _STEPS_ALL)
    return search.best().point
