"""What the searches for gains share: cost and slope at a point, the count of rollouts, the points seen, and three ways to go on from one.

A point lies in the unit box: the gains' logarithms between their bounds. Terms and limits (``objective``) make one number, whose gradient
by reverse mode costs as much whatever the number of gains. Several plants (draws of a fit's posterior, ambients, loads) or draws of the
noise are rolled out as one batch and count alike; a search may ask one of these members only.
"""

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.control import objective, trust_region
from smajax.control.objective import LIMITS, TERMS, Wanted
from smajax.control.trust_region import Place
from smajax.control.tuning import Tuning, look
from smajax.errors import NumericsError

BATCH = 8  # points looked at together
LOOSE = 1e-3  # a violation that counts as none
_REVERSE = 3  # rollouts that a gradient by reverse mode counts
_STEEPEST = 100.0  # a slope at most, costs being near 1: steeper ones are of loops that swing themselves up, and would end a line search
_WILD, _WILDS = 1e6, 3  # a slope that tells nothing, and how many of them end a search
_UNUSABLE = 1e30
_MOVE, _WIDE = 0.01, 1e6  # of the command's range, a move that counts as one; a range that is none
_RTOL = 1e-4
_BROKEN = 10.0  # a violation at most, lest a cliff bend the quadratic
_ABOVE = 100.0  # times the first cost: one that is higher counts as this, lest a cliff bend the quadratic


class _Aim(NamedTuple):
    """What a search takes beside the point; arrays, so that none of it asks for another program."""

    tuning: Tuning
    wanted: Wanted
    scale: jax.Array
    multipliers: jax.Array
    mu: jax.Array


@eqx.filter_jit
def _slope(point: jax.Array, aim: _Aim) -> tuple[jax.Array, jax.Array]:
    """The sum of squares and its gradient."""

    def cost(point: jax.Array) -> jax.Array:
        found = aim.tuning.parts(point, aim.wanted)
        each = jax.vmap(lambda f, m: objective.residual(f, aim.scale, aim.wanted, m, aim.mu))(found, aim.multipliers)
        return jnp.sum(each**2) / each.shape[0]

    return jax.value_and_grad(cost)(point)


@eqx.filter_jit
def violations(tuning: Tuning, point: jax.Array, wanted: Wanted) -> jax.Array:
    """What each limit is passed by at a point, by all members."""
    return tuning.parts(point, wanted).violated


class _Wild(Exception):
    """The slope tells nothing here."""


class Candidate(NamedTuple):
    """A point with its largest violation (0: none), its weighted terms, and what it violates of each limit where that was looked at."""

    worst: float
    cost: float
    point: np.ndarray
    violated: np.ndarray = np.zeros(len(LIMITS))


def order(candidate: Candidate) -> tuple[float, float]:
    """What candidates are compared by: violations first, then terms."""
    return candidate.worst, candidate.cost


def worst_of(violated: np.ndarray) -> float:
    """How far limits are broken together, so that one which no gains keep does not hide the others; 0 if all are kept."""
    return 0.0 if np.max(violated) <= LOOSE else float(np.sum(np.maximum(violated, 0.0)))


class Tuner:
    """Counts rollouts and keeps the points that all members were looked at, the start first."""

    def __init__(self, tuning: Tuning, wanted: Wanted, progress: Callable[[int, float], None], settle: bool = False) -> None:
        self.tuning, self.wanted, self.progress = tuning, wanted, progress
        self.rollouts, self.history = 0, []
        self.seen: list[Candidate] = []
        terms, violated = self.look(tuning.start[None])
        usable = np.isfinite(terms[0]) & (terms[0] > 0.0)
        self.scale = np.where(usable, terms[0], 1.0)
        pid = tuning.loop.controller.inner
        reach = float(pid.upper) - float(pid.lower)
        if reach < _WIDE:
            self.scale[TERMS.index("effort")] = len(tuning.task.reference) * (_MOVE * reach) ** 2
        n = tuning.task.reference.shape[0]
        self.plain = not (settle or np.any(np.isfinite(np.asarray(wanted.limits))))  # the terms are all there is
        self.none = jnp.zeros((tuning.count, len(LIMITS), n))
        self.unlimited = eqx.tree_at(lambda w: w.limits, wanted, jnp.full_like(wanted.limits, jnp.inf))
        self.keep(self._candidate(tuning.start, terms[0], violated[0]))

    def look(self, points: np.ndarray, tuning: Tuning | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Terms and largest violations of each limit at points, by all members or by those in ``tuning``."""
        tuning = tuning or self.tuning
        self.rollouts += len(points) * tuning.count
        terms, violated = look(tuning, jnp.asarray(points), self.wanted)
        return np.asarray(terms), np.nan_to_num(np.asarray(violated), nan=np.inf)

    def candidates(self, points: np.ndarray, tuning: Tuning | None = None) -> list[Candidate]:
        """Looks at points by all members, which keeps them, or by those in ``tuning``."""
        found = [self._candidate(*one) for one in zip(points, *self.look(points, tuning), strict=True)]
        if tuning is None or tuning.count == self.tuning.count:
            for one in found:
                self.keep(one)
        return found

    def _candidate(self, point: np.ndarray, terms: np.ndarray, violated: np.ndarray) -> Candidate:
        cost = float(np.nan_to_num(terms @ (np.asarray(self.wanted.weights) / self.scale), nan=np.inf))
        return Candidate(worst_of(violated), cost, point, violated)

    def keep(self, one: Candidate) -> None:
        """Keeps what all members were looked at; the history tells where nothing limits."""
        if self.plain and one.cost < min((c.cost for c in self.seen), default=math.inf):
            self.history.append((self.rollouts, one.cost))
        self.seen.append(one)

    def follow(self, place: Place, tuning: Tuning, least: float, steps: int) -> Place:
        """The best place found by gradients of the cost's logarithm, of all members or of some in ``tuning``, where nothing limits."""
        aim = _Aim(tuning, self.unlimited, jnp.asarray(self.scale), self.none[: tuning.count], jnp.asarray(1.0))
        free = np.asarray(self.tuning.upper > self.tuning.lower)

        def slope(point: np.ndarray) -> tuple[float, np.ndarray]:
            value, by = _slope(jnp.asarray(point), aim)
            self.rollouts += _REVERSE * tuning.count
            cost, by = float(value), np.where(free, np.asarray(by), 0.0)
            if not (0.0 < cost < math.inf and np.all(np.isfinite(by))):
                return math.inf, np.zeros_like(point)
            if tuning.count == self.tuning.count:
                self.keep(Candidate(0.0, cost, point))
            self.progress(self.rollouts, cost)
            return math.log(cost), by / cost

        return trust_region.descend(slope, place, least, steps)

    def descend(
        self, start: np.ndarray, wanted: Wanted, multipliers: jax.Array, mu: float, steps: int, scale: float, reach: float = 1.0
    ) -> Candidate:
        """The best point found by so many steps of a quasi-Newton search, whose first step has a length of at most one over ``scale``.

        It goes no further than ``reach`` from the start in any gain.
        ``worst`` of the result is not told (0), its cost that of terms and limits together; infinite if no point gave numbers.
        """
        aim = _Aim(self.tuning, wanted, jnp.asarray(self.scale), multipliers, jnp.asarray(mu))
        best = Candidate(0.0, math.inf, start)
        free, wild = np.asarray(self.tuning.upper > self.tuning.lower), 0

        def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal best, wild
            value, slope = _slope(jnp.asarray(x / scale), aim)
            self.rollouts += _REVERSE * self.tuning.count
            found, by = float(value), np.where(free, np.asarray(slope), 0.0) / scale
            if not (math.isfinite(found) and np.all(np.isfinite(by))):
                return _UNUSABLE, np.zeros_like(x)
            point = Candidate(0.0, found, x / scale)
            if found < best.cost:
                best = point
                self.progress(self.rollouts, found)
            wild += scale * float(np.max(np.abs(by))) > _WILD
            if wild == _WILDS:
                raise _Wild
            return found, by * min(1.0, _STEEPEST / max(1e-300, scale * float(np.max(np.abs(by)))))

        low, high = np.maximum(0.0, start - reach) * scale, np.minimum(1.0, start + reach) * scale
        options = {"maxiter": steps, "maxfun": 2 * steps, "ftol": _RTOL}
        with contextlib.suppress(_Wild):
            scipy.optimize.minimize(
                cost, start * scale, jac=True, method="L-BFGS-B", bounds=list(zip(low, high, strict=True)), options=options
            )
        return best

    def quadratics(self, start: np.ndarray, tuning: Tuning, radius: float, least: float, looks: int) -> Candidate:
        """The best that SciPy's COBYQA finds from a point, within the limits if there are any, with looks by the members in ``tuning``."""
        free = np.asarray(tuning.upper > tuning.lower)
        limited = np.isfinite(np.asarray(self.wanted.limits))
        best = self.candidates(start[None], tuning)[0]
        most = _ABOVE * min(best.cost, _UNUSABLE)
        looked = {start[free].tobytes(): best}  # COBYQA asks for terms and limits one after the other

        def at(packed: bytes) -> Candidate:
            nonlocal best
            if packed in looked:
                return looked[packed]
            point = start.copy()
            point[free] = np.clip(np.frombuffer(packed), 0.0, 1.0)
            now = looked[packed] = self.candidates(point[None], tuning)[0]
            if order(now) < order(best):
                best = now
                if now.worst == 0.0 and not self.plain and tuning.count == self.tuning.count:
                    self.history.append((self.rollouts, now.cost))
            self.progress(self.rollouts, best.cost)
            return now

        within = scipy.optimize.NonlinearConstraint(lambda moved: np.minimum(at(moved.tobytes()).violated[limited], _BROKEN), -np.inf, 0.0)
        scipy.optimize.minimize(
            lambda moved: math.log(max(min(at(moved.tobytes()).cost, most), 1e-300)),
            start[free],
            method="COBYQA",
            bounds=[(0.0, 1.0)] * int(np.sum(free)),
            constraints=[within] if np.any(limited) else (),
            options={"initial_tr_radius": radius, "final_tr_radius": least, "maxfev": looks},
        )
        return best

    def known(self) -> Candidate:
        """The best of all that all members were looked at."""
        return self.usable(min(self.seen, key=order))

    def usable(self, found: Candidate) -> Candidate:
        """A candidate with a cost. Raises ``NumericsError`` if it has none."""
        if not math.isfinite(found.cost):
            raise NumericsError(
                "the closed loop does not give numbers from the start gains, nor from any that was drawn: start from smaller gains",
                {name: float(v) for name, v in self.tuning.gains(found.point).items()},
            )
        return found
