"""Gains by gradients through the rollout.

The gains are searched by their logarithms between bounds. Terms and limits (``objective``) make one number, whose gradient by reverse mode
costs as much whatever the number of gains, and which a quasi-Newton search in the box makes small. Several plants (draws of a fit's
posterior, ambients, loads) or draws of the noise are rolled out as one batch and count alike.

Gradients are followed by one member first, since all go the same way from afar, and by all of them then. They end where a wire's loop is
rough: some gains let it hunt through small loops of its hysteresis or chatter between its limits, and there what a change of the gains
does at once tells nothing of what it does in the end. If more than one start is asked for, quadratics through looks that lie a good way
apart, to which roughness is little, lead on from there: SciPy's COBYQA, by one member and then by all.

Settling, whose derivative jumps, has a search of its own: ``fastest``.
"""

import contextlib
import functools
import math
from collections.abc import Callable, Mapping
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
import scipy.stats

from smajax.control import metrics, objective, trust_region
from smajax.control.fastest import Shape, fastest, shape_at
from smajax.control.objective import LIMITS, TERMS, Wanted
from smajax.control.trust_region import Place
from smajax.control.tuning import Tuning, look, roll
from smajax.errors import InputError, NumericsError

SETTLING = {"itae": 1.0}  # what is made small before the shortest settling time is looked for
_LOOSE = 1e-3  # a violation that counts as none
_FIRST = 10  # steps of a search
_WIDE_STEP, _SMALL_STEP = 5.0, 20.0  # one over the length of its first step at most, the box being one wide
_REVERSE = 3  # rollouts that a gradient by reverse mode counts
_STEEPEST = 100.0  # a slope at most, costs being near 1: steeper ones are of loops that swing themselves up, and would end a line search
_WILD, _WILDS = 1e6, 3  # a slope that tells nothing, and how many of them end a search
_UNUSABLE = 1e30
_RAISES = 8
_REACH = 0.06  # of the box: how far gains go between two looks at what limits cost; else they flee to where nothing moves
_MOVE, _WIDE = 0.01, 1e6  # of the command's range, a move that counts as one; a range that is none
_GROSS = 1.0  # a violation from which a search is not begun
_EVALUATIONS = 32
_RTOL = 1e-4
_SCREENED = 16
_BATCH = 8  # points looked at together
_SPREAD = 64  # points looked at by one member, where limits keep the search from where the terms are small
_REGION, _CLOSE = 0.1, 0.03  # of the box: the trust region to begin with, and that of all members from where one has led
_ALONE, _ALL, _FEW = 20, 30, 12  # steps at most: of one member, of all from the start, and of all from there
_COARSE, _FINE = 0.01, 1e-3  # of the box, a region that ends a search: of one member, of all
# Of quadratics, of the box: how far looks lie apart at first and in the end, and how many there are at most.
_BY_ONE, _BY_ALL = (0.15, 0.01, 80), (0.04, 0.004, 40)
_LIMITED, _BROKEN = (0.15, 0.004, 80), 10.0  # the same within limits, and a violation at most, lest a cliff bend the quadratic
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
def _violations(tuning: Tuning, point: jax.Array, wanted: Wanted) -> jax.Array:
    return tuning.parts(point, wanted).violated


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
    others = sum(v for name, v in one.violated.items() if name != "settling" and v > _LOOSE)
    return not one.feasible, others, one.settling if "settling" in one.violated else 0.0


class _Wild(Exception):
    """The slope tells nothing here."""


class _Candidate(NamedTuple):
    """A point with its largest violation (0: none), its weighted terms, and what it violates of each limit where that was looked at."""

    worst: float
    cost: float
    point: np.ndarray
    violated: np.ndarray = np.zeros(len(LIMITS))


class _Tuner:
    """Counts rollouts and keeps the best point."""

    def __init__(self, tuning: Tuning, wanted: Wanted, progress: Callable[[int, float], None], settle: bool = False) -> None:
        self.tuning, self.wanted, self.progress = tuning, wanted, progress
        self.rollouts, self.history = 0, []
        self.seen: list[_Candidate] = []
        terms, _ = self.look(tuning.start[None])
        usable = np.isfinite(terms[0]) & (terms[0] > 0.0)
        self.scale = np.where(usable, terms[0], 1.0)
        pid = tuning.loop.controller.inner
        reach = float(pid.upper) - float(pid.lower)
        if reach < _WIDE:
            self.scale[TERMS.index("effort")] = len(tuning.task.reference) * (_MOVE * reach) ** 2
        n = tuning.task.reference.shape[0]
        self.plain = not (settle or np.any(np.isfinite(np.asarray(wanted.limits))))  # the terms are all there is
        self.none = jnp.zeros((tuning.count, len(LIMITS), n))
        self.unlimited = eqx.tree_at(lambda w: w.limits, wanted, jnp.full(len(LIMITS), jnp.inf))

    def look(self, points: np.ndarray, tuning: Tuning | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Terms and largest violations of each limit at points, by all members or by those in ``tuning``."""
        tuning = tuning or self.tuning
        self.rollouts += len(points) * tuning.count
        terms, violated = look(tuning, jnp.asarray(points), self.wanted)
        return np.asarray(terms), np.nan_to_num(np.asarray(violated), nan=np.inf)

    def candidates(self, points: np.ndarray, tuning: Tuning | None = None) -> list[_Candidate]:
        """Looks at points by all members, which keeps them, or by those in ``tuning``."""
        terms, violated = self.look(points, tuning)
        costs = np.nan_to_num(terms @ (np.asarray(self.wanted.weights) / self.scale), nan=np.inf)
        found = [_Candidate(_worst(v), float(c), p, v) for v, c, p in zip(violated, costs, points, strict=True)]
        if tuning is None or tuning.count == self.tuning.count:
            for one in found:
                self.keep(one)
        return found

    def keep(self, one: _Candidate) -> None:
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
                self.keep(_Candidate(0.0, cost, point))
            self.progress(self.rollouts, cost)
            return math.log(cost), by / cost

        return trust_region.descend(slope, place, least, steps)

    def descend(
        self, start: np.ndarray, wanted: Wanted, multipliers: jax.Array, mu: float, steps: int, scale: float, reach: float = 1.0
    ) -> _Candidate:
        """The best point found by so many steps of a quasi-Newton search, whose first step has a length of at most one over ``scale``.

        It goes no further than ``reach`` from the start in any gain.
        ``worst`` of the result is not told (0), its cost that of terms and limits together; infinite if no point gave numbers.
        """
        aim = _Aim(self.tuning, wanted, jnp.asarray(self.scale), multipliers, jnp.asarray(mu))
        best = _Candidate(0.0, math.inf, start)
        free, wild = np.asarray(self.tuning.upper > self.tuning.lower), 0

        def cost(x: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal best, wild
            value, slope = _slope(jnp.asarray(x / scale), aim)
            self.rollouts += _REVERSE * self.tuning.count
            found, by = float(value), np.where(free, np.asarray(slope), 0.0) / scale
            if not (math.isfinite(found) and np.all(np.isfinite(by))):
                return _UNUSABLE, np.zeros_like(x)
            point = _Candidate(0.0, found, x / scale)
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


def _worst(violated: np.ndarray) -> float:
    """How far limits are broken together, so that one which no gains keep does not hide the others; 0 if all are kept."""
    return 0.0 if np.max(violated) <= _LOOSE else float(np.sum(np.maximum(violated, 0.0)))


def wanted_of(weights: Mapping[str, float], limits: Mapping[str, float], band: float = metrics.BAND) -> Wanted:
    """What is wanted, from weights of ``objective.TERMS`` and limits of ``objective.LIMITS`` by name."""
    return Wanted(
        jnp.asarray([float(weights.get(t, 0.0)) for t in TERMS]), jnp.asarray([float(limits.get(k, math.inf)) for k in LIMITS]), band
    )


def objective_of(tuning: Tuning, weights: Mapping[str, float]) -> Callable[[np.ndarray], float]:
    """The weighted terms that ``tune`` makes small, as a number at a point of the unit box: for other searches to be compared with."""
    tuner = _Tuner(tuning, wanted_of(weights, {}), lambda steps, cost: None)
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
    tuner = _Tuner(tuning, wanted, progress, settle)
    points = _starts(tuner, starts, seed)
    found = _faster(tuner, _near(tuner, points)) if settle else _within(tuner, points)
    if not settle and limits.get("settling", math.inf) < math.inf:
        found = _soon_enough(tuner, found, points)
    terms, violated = tuner.look(found[None])
    kept = float(np.max(violated[0])) <= _LOOSE
    value = {name: float(v) for name, v in tuning.gains(found).items()}
    return Tuned(
        point=found,
        gains=value,
        terms={t: float(v) for t, v in zip(TERMS, terms[0] / tuner.scale, strict=True)},
        violated={k: float(v) for k, v in zip(LIMITS, violated[0], strict=True) if k in limits},
        feasible=kept,
        settling=_settling(tuning, found, band),
        rollouts=tuner.rollouts,
        history=tuple(tuner.history),
    )


def _starts(tuner: _Tuner, starts: int, seed: int) -> np.ndarray:
    """The loop's own gains, and the best of many drawn ones: by violations first, then by terms."""
    own = tuner.tuning.start[None]
    if starts <= 1:
        return own
    drawn = np.random.default_rng(seed).uniform(size=(max(_SCREENED, _BATCH * -(-starts // 2)), own.shape[1]))
    members = tuner.tuning.alone() if tuner.plain else tuner.tuning
    found = [one for k in range(0, len(drawn), _BATCH) for one in tuner.candidates(drawn[k : k + _BATCH], members)]
    return np.vstack([own, *(one.point for one in sorted(found, key=_order)[: starts - 1])])


def _near(tuner: _Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small without regard to limits: the best point."""
    found = min((tuner.descend(p, tuner.unlimited, tuner.none, 1.0, _FIRST, _WIDE_STEP) for p in points), key=lambda c: c.cost)
    return _usable(tuner, found).point


def _usable(tuner: _Tuner, found: _Candidate) -> _Candidate:
    if not math.isfinite(found.cost):
        raise NumericsError(
            "the closed loop does not give numbers from the start gains, nor from any that was drawn: start from smaller gains",
            {name: float(v) for name, v in tuner.tuning.gains(found.point).items()},
        )
    return found


def _within(tuner: _Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small within the limits, from where they are small without, to one member at least.

    If that breaks a limit, by an augmented Lagrangian, or from the best point known if it breaks it by far; then by quadratics of the terms
    and of the limits: a limit of a loop that turns unstable, or rests, near it has no slope that leads anywhere.
    """
    if tuner.plain:
        return _without(tuner, points)
    spent = tuner.rollouts
    free = _Tuner(tuner.tuning.alone(), tuner.unlimited, lambda count, cost: tuner.progress(spent + count, cost))
    point = _without(free, points)
    tuner.rollouts += free.rollouts
    tried = tuner.candidates(np.vstack([point, points]))
    best, multipliers, before, mu = min(tried, key=_order), tuner.none, math.inf, 1.0
    if tried[0].worst > _GROSS:
        point = best.point
    for turn in range(_RAISES):
        now = tuner.candidates(point[None])[0]
        if _order(now) < _order(best):
            best = now
            if now.worst == 0.0:
                tuner.history.append((tuner.rollouts, now.cost))
        if now.worst == 0.0 and (turn or tried[0].worst == 0.0) and not bool(jnp.any(multipliers > 0.0)):
            break
        if now.worst > 0.5 * before:
            mu *= 4.0
        before = now.worst
        multipliers = jnp.maximum(multipliers + mu * _violations(tuner.tuning, jnp.asarray(point), tuner.wanted), 0.0)
        tuner.rollouts += tuner.tuning.count
        point = tuner.descend(point, tuner.wanted, multipliers, mu, _FIRST, _SMALL_STEP, _REACH).point
    if tried[0].worst > 0.0:
        # From elsewhere, too: the best point within the limits may be a loop that does nothing, from which no way leads on.
        alone = tuner.tuning.alone()
        spread = scipy.stats.qmc.Sobol(len(point), scramble=False).random(_SPREAD) + 0.5 / _SPREAD  # amid cells, none on an edge
        seen = [one for k in range(0, _SPREAD, _BATCH) for one in tuner.candidates(spread[k : k + _BATCH], alone)]
        begun = {p.tobytes(): p for p in (best.point, tried[0].point, points[0], min(seen, key=_order).point)}.values()
        led = min((_by_quadratics(tuner, p, alone, *_LIMITED) for p in begun), key=_order)
        best = min(best, _by_quadratics(tuner, led.point, tuner.tuning, *_BY_ALL), key=_order)
    return best.point


def _without(tuner: _Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small where nothing limits them: by gradients, and by quadratics then if there are several starts."""
    tuner.candidates(points[:1])
    if len(points) == 1:
        place, steps = Place(_known(tuner).point, math.inf, None, _REGION), _ALL
        if tuner.tuning.count > 1:
            place = tuner.follow(place, tuner.tuning.alone(), _COARSE, _ALONE)
            place, steps = place._replace(radius=max(place.radius, _CLOSE)), _FEW
        tuner.follow(place, tuner.tuning, _FINE, steps)
        return _known(tuner).point
    alone, ended, single = tuner.tuning.alone(), [], tuner.tuning.count == 1
    for point in points:
        place = tuner.follow(Place(point, math.inf, None, _REGION), alone, *((_FINE, _ALL) if single else (_COARSE, _ALONE)))
        ended.append(_by_quadratics(tuner, place.point, alone, *_BY_ONE))
    _by_quadratics(tuner, min(ended, key=_order).point, tuner.tuning, *_BY_ALL)
    if single:
        tuner.follow(Place(_known(tuner).point, math.inf, None, _CLOSE), alone, _FINE, _ALL)
    return _known(tuner).point


def _known(tuner: _Tuner) -> _Candidate:
    """The best of all that all members were looked at."""
    return _usable(tuner, min(tuner.seen, key=_order))


def _by_quadratics(tuner: _Tuner, start: np.ndarray, tuning: Tuning, radius: float, least: float, looks: int) -> _Candidate:
    """The best that SciPy's COBYQA finds from a point, within the limits if there are any, with looks by the members in ``tuning``."""
    free = np.asarray(tuning.upper > tuning.lower)
    best = tuner.candidates(start[None], tuning)[0]
    most = _ABOVE * min(best.cost, _UNUSABLE)
    limited = np.isfinite(np.asarray(tuner.wanted.limits))

    @functools.cache  # COBYQA asks for terms and limits one after the other
    def at(packed: bytes) -> _Candidate:
        nonlocal best
        point = start.copy()
        point[free] = np.clip(np.frombuffer(packed), 0.0, 1.0)
        now = tuner.candidates(point[None], tuning)[0]
        if _order(now) < _order(best):
            best = now
            if now.worst == 0.0 and not tuner.plain and tuning.count == tuner.tuning.count:
                tuner.history.append((tuner.rollouts, now.cost))
        tuner.progress(tuner.rollouts, best.cost)
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


def _order(candidate: _Candidate) -> tuple[float, float]:
    return candidate.worst, candidate.cost


def _faster(tuner: _Tuner, start: np.ndarray) -> np.ndarray:
    """The point that settles first: see ``fastest``."""
    tuning = tuner.tuning
    found = tuning.jumps
    shaped = _Shaped(tuning, tuner.wanted)

    def shape(point: np.ndarray) -> Shape:
        tuner.rollouts += tuning.count * (1 + len(point))
        return shape_at(shaped, point)

    def note(point: np.ndarray, late: float, worst: float) -> None:
        tuner.progress(tuner.rollouts, late)
        if worst <= _LOOSE:
            tuner.history.append((tuner.rollouts, late))

    span = np.log(np.asarray(tuning.upper / tuning.lower))
    return fastest(shape, start, span, found, tuner.wanted, tuning.task.period, note, evaluations=_EVALUATIONS)


def _soon_enough(tuner: _Tuner, found: np.ndarray, points: np.ndarray) -> np.ndarray:
    """The point found if it settles in time; else one that does, with its terms made small from there, or the one that settles first.

    How late a loop is says little of how to make it sooner: that is searched for by itself, within the other limits.
    """
    place, spent = LIMITS.index("settling"), tuner.rollouts
    before = tuner.candidates(found[None])[0]
    if before.worst == 0.0:
        return found
    others = eqx.tree_at(
        lambda w: (w.weights, w.limits), tuner.wanted, (wanted_of(SETTLING, {}).weights, tuner.wanted.limits.at[place].set(jnp.inf))
    )
    free = _Tuner(tuner.tuning, others, lambda count, cost: tuner.progress(spent + count, cost), settle=True)
    sooner = _faster(free, _near(free, points))
    tuner.rollouts += free.rollouts
    after = tuner.candidates(sooner[None])[0]
    if after.worst == 0.0:
        return min(after, _by_quadratics(tuner, sooner, tuner.tuning, *_BY_ALL), key=_order).point

    def broken(one: _Candidate) -> tuple[float, float]:
        return _worst(np.delete(one.violated, place)), _settling(tuner.tuning, one.point, tuner.wanted.band)

    return min(before, after, key=broken).point


class _Shaped(eqx.Module):
    """Error over the jump, shape ``(m, n)``, and violations, ``(m, 5, n)``, of a point."""

    tuning: Tuning
    wanted: Wanted

    def __call__(self, point: jax.Array) -> tuple[jax.Array, jax.Array]:
        tuning, task = self.tuning, self.tuning.task
        done = tuning.roll(tuning.gains(point))._replace(ends=None)
        jumped = task.size != 0.0
        sizes = jnp.where(jumped, task.size, 1.0)
        share = jax.vmap(lambda values: jnp.where(jumped, (values - task.reference) / sizes, 0.0))(done.channels[task.channel])
        return share, jax.vmap(lambda one: objective.parts(one, task, self.wanted).violated)(done)


def _settling(tuning: Tuning, point: np.ndarray, band: float) -> float:
    """The longest settling time of all jumps and members at a point, s; 0 without any jump."""
    values = np.asarray(roll(tuning, tuning.gains(point)).channels[tuning.task.channel])
    reference = np.asarray(tuning.task.reference)
    times = [a.settling for v in values for a in metrics.answers(v, reference, tuning.jumps, tuning.task.period, band)]
    return max(times, default=0.0)
