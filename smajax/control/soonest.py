"""Gains that settle soonest, or soon enough: settling, whose derivative jumps, has a search of its own (``fastest``)."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control import metrics, objective
from smajax.control.fastest import Shape, fastest, shape_at
from smajax.control.objective import LIMITS, Wanted, wanted_of
from smajax.control.tuner import LOOSE, Candidate, Tuner, order, worst_of
from smajax.control.tuning import Tuning, roll
from smajax.control.unlimited import BY_ALL

SETTLING = {"itae": 1.0}  # what is made small before the shortest settling time is looked for
_STEPS, _WIDE_STEP = 10, 5.0  # steps of a search; one over the length of its first step at most, the box being one wide
_EVALUATIONS = 32


def near(tuner: Tuner, points: np.ndarray) -> np.ndarray:
    """The terms made small without regard to limits: the best point."""
    found = min((tuner.descend(p, tuner.unlimited, tuner.none, 1.0, _STEPS, _WIDE_STEP) for p in points), key=lambda c: c.cost)
    return tuner.usable(found).point


def soonest(tuner: Tuner, start: np.ndarray) -> np.ndarray:
    """The point that settles first: see ``fastest``."""
    tuning = tuner.tuning
    found = tuning.jumps
    shaped = _Shaped(tuning, tuner.wanted)

    def shape(point: np.ndarray) -> Shape:
        tuner.rollouts += tuning.count * (1 + len(point))
        return shape_at(shaped, point)

    def note(point: np.ndarray, late: float, worst: float) -> None:
        tuner.progress(tuner.rollouts, late)
        if worst <= LOOSE:
            tuner.history.append((tuner.rollouts, late))

    span = np.log(np.asarray(tuning.upper / tuning.lower))
    return fastest(shape, start, span, found, tuner.wanted, tuning.task.period, note, evaluations=_EVALUATIONS)


def soon_enough(tuner: Tuner, found: np.ndarray, points: np.ndarray) -> np.ndarray:
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
    free = Tuner(tuner.tuning, others, lambda count, cost: tuner.progress(spent + count, cost), settle=True)
    sooner = soonest(free, near(free, points))
    tuner.rollouts += free.rollouts
    after = tuner.candidates(sooner[None])[0]
    if after.worst == 0.0:
        return min(after, tuner.quadratics(sooner, tuner.tuning, *BY_ALL), key=order).point

    def broken(one: Candidate) -> tuple[float, float]:
        return worst_of(np.delete(one.violated, place)), longest_settling(tuner.tuning, one.point, tuner.wanted.band)

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


def longest_settling(tuning: Tuning, point: np.ndarray, band: float) -> float:
    """The longest settling time of all jumps and members at a point, s; 0 without any jump."""
    values = np.asarray(roll(tuning, tuning.gains(point)).channels[tuning.task.channel])
    reference = np.asarray(tuning.task.reference)
    times = [a.settling for v in values for a in metrics.answers(v, reference, tuning.jumps, tuning.task.period, band)]
    return max(times, default=0.0)
