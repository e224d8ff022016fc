"""Gains without limits: by gradients, and from several starts by quadratic models afterwards.

The gradient search uses one member first, since all members agree far from the minimum, and then all of them. Gradients
fail where the cost is rough: some gains let a wire's loop oscillate through small hysteresis loops or chatter between
the limits of the command, and the local gradient then does not predict the cost of larger changes. With more than one
start, the search continues with quadratic models through points that are further apart, on which roughness has little
influence: SciPy's COBYQA, with one member and then with all. If the gains of the single member overfit its own noise, a
few members are used in between.
"""

import math

import numpy as np
from jaxtyping import Float

from smajax.control.tuning.search import GainSearch, rank
from smajax.control.tuning.trust_region import SearchState

# All radii are in sizes of the box; all constants were chosen by experiments/control/wire_position.py and
# experiments/papers/rotary/rotary_tracking.py, and tests/unit/control/test_tuning.py holds the number of rollouts.

# First radius of the trust region, and that with all members after a search with one. Chosen by trial.
_RADIUS = 0.1
_RADIUS_AFTER_SINGLE = 0.03
# Largest number of steps: with one member, with all from the start, and with all after a search with one.
_STEPS_SINGLE = 20
_STEPS_ALL = 30
_STEPS_AFTER_SINGLE = 12
# Radius that ends a search with one member, and with all.
_COARSE = 0.01
_FINE = 1e-3
# First radius, last radius and largest number of evaluations of COBYQA with one member, with a few, and with all.
_COBYQA_SINGLE = (0.15, 0.01, 80)
_COBYQA_FEW = (0.08, 0.008, 30)
COBYQA_ALL_MEMBERS = (0.04, 0.004, 40)
# Number of members that are a few.
_FEW = 3
# Ratio of the cost of all members to that of the single one above which its gains overfit its own noise.
_OVERFITTED = 1.5


def unconstrained(search: GainSearch, points: Float[np.ndarray, "starts gains"]) -> Float[np.ndarray, " gains"]:
    """Minimise the terms without limits.

    Args:
        search: The search.
        points: Starts in the unit box, shape ``(k, p)``, the search's own start first.

    Returns:
        The best point that all members evaluated, shape ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
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
    if problem.count > _FEW and search.candidates(best.point[None])[0].cost > _OVERFITTED * best.cost:
        best = search.search_by_cobyqa(best.point, problem.first_members(_FEW), *_COBYQA_FEW)
    search.search_by_cobyqa(best.point, problem, *COBYQA_ALL_MEMBERS)
    if is_single:
        state = SearchState(search.best().point, math.inf, None, _RADIUS_AFTER_SINGLE)
        search.descend_in_trust_region(state, single, _FINE, _STEPS_ALL)
    return search.best().point
