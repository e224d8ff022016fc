"""Gains within limits: quadratic models through evaluated points, from several starts.

Gradients do not help there. The largest temperature or overshoot of a rollout through a hysteresis has derivatives that
change their sign, or are huge, from one point to the next, and a search that uses them stops early:
experiments/control/search_methods.py compares SLSQP, trust-constr and an augmented Lagrangian. A loop that barely moves
keeps all limits, too, so that the best of points that cover the box is a start as well.
"""

import numpy as np
import scipy.stats
from jaxtyping import Float

from smajax.control.tuning.search import GainSearch, rank
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS

# All constants were chosen by experiments/control/search_methods.py.

# Number of points that cover the box evenly; the best one is a start.
_SCAN = 32
# First radius, last radius and largest number of evaluations of COBYQA from each start.
_COBYQA = (0.15, 0.01, 40)


def constrained(search: GainSearch, points: Float[np.ndarray, "starts gains"]) -> Float[np.ndarray, " gains"]:
    """Minimise the terms within the limits, with all members.

    Args:
        search: The search.
        points: Starts in the unit box, shape ``(k, p)``.

    Returns:
        The best point, shape ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
    """
    spread = scipy.stats.qmc.Sobol(points.shape[1], scramble=False).random(_SCAN) + 0.5 / _SCAN
    for start in (*points, min(search.candidates(spread), key=rank).point):
        search.search_by_cobyqa(start, search.problem, *_COBYQA)
    search.search_by_cobyqa(search.best().point, search.problem, *COBYQA_ALL_MEMBERS)
    return search.best().point
