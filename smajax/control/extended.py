"""What a rig does not measure, from what it does: the extended Kalman filter on the plant.

One plant is carried along under the same commands as the rig, and with it a covariance P of what is not known of it. Over a period

    x' = f(x, command)      P' = F (P + Q) F^T       F = df/dx, by forward mode through the plant's own steps at their known ends

and each measurement y moves both along the line that P draws (one after another, their noise being independent), in Joseph's form, which
keeps P symmetric and free of negative variances whatever is rounded (Bucy, Joseph, Filtering for Stochastic Processes (1968)):

    K = P h / (h^T P h + r)     x += K (y - h^T x)     P = (1 - K h^T) P (1 - K h^T)^T + r K K^T

where r grows if the measurement is further off than ``trust`` says, so that no single one throws x on another branch (Huber's weight).
x holds the plant's integrator state (temperatures, fractions, stresses, unknowns and motion of the mechanism), what its thermocouples show,
the parameters that are not known, and what the meters see now and saw before, as far back as the slowest one is late. So a late
measurement corrects the state now by what it says of then, and h only picks a number. Steps of a meter count as noise, quantum^2 / 12.

What effects remember (marks where a branch began, how far friction is engaged, how long something has lasted) is carried by the mean and is
not in P: at a reversal it is set anew, so that its derivative jumps between 0 and 1 with the branch that the mean happens to be on, and a
correction along it could leave a mark on a side of the present state where no history leads. The phase fractions need no such marks (see
``plant.material.brinson``), so they are in P. But the mean is still on one branch: that the wire may be on another one, P knows only as far
as ``process`` lets the fraction walk. ``ensemble`` has members on both, at the price of as many plants.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from smajax import parameters
from smajax.control.driven import AbstractDriven, DrivenPlant
from smajax.control.meters import Meters, probed
from smajax.control.observers import AbstractFilter, Estimate
from smajax.kinks import larger, within
from smajax.parameters import parameter
from smajax.plant.material.base import Fractions
from smajax.units import channel_of


class Belief(NamedTuple):
    """The means: the plant's ``state``, the ``probes`` by channel (degC), the ``unknown`` parameters, shape ``(p,)``, and what the meters
    have ``shown``, newest first, shape ``(latest + 1, meters)``; the ``covariance`` of all that is estimated of them, in that order; and
    the command that acts since the last sample, shape ``(wires,)``.
    """

    state: Any
    probes: dict[str, jax.Array]
    unknown: jax.Array
    shown: jax.Array
    covariance: jax.Array
    command: jax.Array


class ExtendedFilter(AbstractFilter):
    """The filter of the module's text, sampled at the period of ``driven``, which is the plant as far as it is known.

    ``meters`` are what is measured, by kind of channel: noise, steps and delay of each, and the thermocouples' lag. ``unknown`` are
    standard deviations of named parameters about the plant's, within which they wander with the time constant ``memory``. ``spread`` and
    ``process`` have the structure of the plant's state: standard deviations of its numbers at the start, and of their random walk in one
    second, in their unit per root second. See ``of`` for those of a wire. All are leaves that derivatives may go by.
    """

    driven: AbstractDriven
    meters: Meters
    unknown: dict[str, jax.Array]
    spread: Any
    process: Any
    memory: jax.Array = parameter("s", "time after which what is unknown is another", 0.0, default=30.0)
    trust: jax.Array = parameter("1", "deviations by which a measurement may surprise; more is laid to its noise", 0.0, default=1.0)

    @classmethod
    def of(
        cls,
        driven: DrivenPlant,
        meters: Meters,
        unknown: Mapping[str, Any],
        *,
        start: Any = 0.0,
        drift: Any = 2.0,
        walk: Any = 0.1,
    ) -> "ExtendedFilter":
        """For wires whose temperatures are known to ``start`` K at the start, beside what is unknown of the surroundings.

        In one second a temperature walks at random by ``drift`` K, and a detwinned fraction by ``walk``: both stand for what the filter
        does not see on its one branch. With the defaults the intervals of wires in other air than thought hold; without a walk of the
        fraction the filter takes its branch for certain, and loses the wire (``tests/test_extended_filter.py`` has both).
        """
        nothing, time = jax.tree.map(jnp.zeros_like, driven.start())

        def each(value: Any) -> jax.Array:
            return jnp.broadcast_to(jnp.asarray(value, jnp.float64), (driven.wires,))

        process = nothing._replace(temperature=each(drift), fractions=nothing.fractions._replace(detwinned=each(walk)))
        known = {name: jnp.asarray(value, jnp.float64) for name, value in unknown.items()}
        return cls(driven, meters, known, (nothing._replace(temperature=each(start)), time), (process, time))

    def reset(self) -> Belief:
        """At rest without any command, as its meters have shown for as long as they are late."""
        middle, nothing = self._middle(), jnp.zeros(self.driven.wires)
        states, _ = self._numbers(self.spread)

        def first(away: jax.Array, unknown: jax.Array) -> tuple[jax.Array, Belief]:
            one = self._as(unknown)
            numbers, whole = self._numbers(one.start())
            state = whole(numbers + away)
            seen = one.read(state, nothing)
            probes = {n: seen[n] for n in self._names if channel_of(n) == "temperature"}
            shown = jnp.broadcast_to(self._shown(seen, probes), (self._rows, len(self._names)))
            belief = Belief(state, probes, unknown, shown, jnp.zeros(()), nothing)
            return jnp.concatenate([self._core(belief)[0], jnp.ravel(shown)]), belief

        slopes, belief = jax.jacfwd(first, argnums=(0, 1), has_aux=True)(jnp.zeros_like(states), middle)
        root = jnp.concatenate(slopes, axis=1) * jnp.concatenate([states, self._deviations()])[None]
        return belief._replace(covariance=root @ root.T)

    def step(self, belief: Belief, measured: Mapping[str, jax.Array]) -> Belief:
        """The belief a period on under its command, once the meters' channels are heard there (scalars; NaN: not this time)."""
        later = self._carry(belief)
        core, whole = self._core(later)
        mean, covariance = jnp.concatenate([core, jnp.ravel(later.shown)]), later.covariance
        for k, name in enumerate(self._names):
            meter = self.meters.each[str(channel_of(name))]
            at, noise = len(core) + meter.delay * len(self._names) + k, meter.noise**2 + meter.quantum**2 / 12.0
            own = covariance[at, at]
            heard = jnp.isfinite(measured[name]) & (own + noise > 0.0)
            surprise = jnp.where(heard, measured[name], mean[at]) - mean[at]
            # A surprise is laid to the measurement's noise as far as it is beyond what is trusted (Huber's weight).
            total = jnp.where(heard, own + noise, 1.0)
            total = total * larger(jnp.abs(surprise) / (self.trust * jnp.sqrt(total)), 1.0)
            gain = jnp.where(heard, covariance[at] / total, 0.0)
            mean = mean + gain * surprise
            left = covariance - jnp.outer(gain, covariance[at])
            covariance = left - jnp.outer(left[:, at], gain) + (total - own) * jnp.outer(gain, gain)
            covariance = 0.5 * (covariance + covariance.T)
        state, probes, unknown = whole(mean[: len(core)])
        state, unknown = self._possible(state, unknown)
        return Belief(state, probes, unknown, mean[len(core) :].reshape(later.shown.shape), covariance, later.command)

    def estimate(self, belief: Belief) -> Estimate:
        """What is believed at a sample, and how surely."""
        core, whole = self._core(belief)

        def told(core: jax.Array) -> tuple[jax.Array, tuple]:
            state, _, unknown = whole(core)
            martensite = state[0].fractions.martensite if isinstance(self.driven, DrivenPlant) else jnp.zeros(0)
            both = self._as(unknown).read(state, belief.command), martensite
            return ravel_pytree(both)[0], both

        slope, (mean, martensite) = jax.jacfwd(told, has_aux=True)(core)
        variance = jnp.sum((slope @ belief.covariance[: len(core), : len(core)]) * slope, axis=1)
        known = variance > 0.0
        spread, sure = ravel_pytree((mean, martensite))[1](jnp.where(known, jnp.sqrt(jnp.where(known, variance, 1.0)), 0.0))
        return Estimate(mean, spread, martensite, sure)

    def begin(self, heard: dict[str, jax.Array]) -> Belief:
        """See ``AbstractThermometer``."""
        return self.reset()

    def watch(self, state: Belief, heard: dict[str, jax.Array]) -> tuple[Belief, jax.Array]:
        """See ``AbstractThermometer``."""
        belief = self.step(state, heard)
        return belief, belief.state[0].temperature

    def under(self, state: Belief, command: jax.Array) -> Belief:
        """See ``AbstractThermometer``."""
        return state._replace(command=command)

    def believed(self, state: Belief, channel: str) -> jax.Array:
        """See ``AbstractFilter``: a channel of the mean."""
        return self._as(state.unknown).read(state.state, state.command)[channel]

    def linearised(self, belief: Belief) -> tuple[jax.Array, Belief]:
        """The Jacobian of a period by all that is estimated, shape as the covariance's, and the means then."""
        stays, middle = jnp.exp(-self.meters.period / self.memory), self._middle()
        core, whole = self._core(belief)

        def moved(core: jax.Array) -> tuple[jax.Array, Belief]:
            state, probes, unknown = whole(core)
            unknown = middle + stays * (unknown - middle)
            one = self._as(unknown)
            state = one.follow(state, belief.command, way)
            seen = one.read(state, belief.command)
            probes = {n: probed(p, seen[n], self.meters.lag, self.meters.period) for n, p in probes.items()}
            now = self._shown(seen, probes)
            later = belief._replace(state=state, probes=probes, unknown=unknown)
            later = later._replace(shown=jnp.concatenate([now[None], belief.shown[:-1]]))
            return jnp.concatenate([self._core(later)[0], now]), later

        # The ends of the steps are searched for once, by the mean; what they depend on is in ``follow``.
        held = jax.lax.stop_gradient((self._as(middle + stays * (belief.unknown - middle)), belief.state, belief.command))
        _, way, _ = held[0].advance(*held[1:])
        slope, later = jax.jacfwd(moved, has_aux=True)(core)
        n, size = len(core), len(belief.covariance)
        # What was shown moves up by one sample; the oldest is forgotten.
        whole_slope = jnp.zeros((size, size)).at[: len(slope), :n].set(slope)
        return whole_slope.at[len(slope) :, n : size - len(self._names)].set(jnp.eye(size - len(slope))), later

    def _carry(self, belief: Belief) -> Belief:
        """A period on, before anything is heard. What wanders does so at its beginning."""
        slope, later = self.linearised(belief)
        walk, back = self._numbers(self.process)[0], jnp.expm1(2.0 * self.meters.period / self.memory)
        known = jnp.zeros(len(slope) - len(walk) - len(self.unknown))
        probes = len(later.probes)
        wander = jnp.concatenate([self.meters.period * walk**2, known[:probes], back * self._deviations() ** 2, known[probes:]])
        return later._replace(covariance=slope @ (belief.covariance + jnp.diag(wander)) @ slope.T)

    def _numbers(self, state: Any) -> tuple[jax.Array, Any]:
        """The numbers of a state that are estimated, shape ``(k,)``, and what makes a state of others with the rest of this one."""
        estimated = jax.tree.map(eqx.is_inexact_array, state)
        if isinstance(self.driven, DrivenPlant):
            remembered = jax.tree.map(lambda _: False, state[0].memory)
            estimated = estimated[0]._replace(memory=remembered), False
        some, rest = eqx.partition(state, estimated)
        flat, unflatten = ravel_pytree(some)
        return flat, lambda flat: eqx.combine(unflatten(flat), rest)

    def _core(self, belief: Belief) -> tuple[jax.Array, Any]:
        """All numbers that are estimated but for what the meters show, and what makes state, probes and unknown parameters of them."""
        numbers, state = self._numbers(belief.state)
        flat, unflatten = ravel_pytree((numbers, belief.probes, belief.unknown))

        def whole(flat: jax.Array) -> tuple[Any, dict[str, jax.Array], jax.Array]:
            numbers, probes, unknown = unflatten(flat)
            return state(numbers), probes, unknown

        return flat, whole

    def _shown(self, seen: dict[str, jax.Array], probes: dict[str, jax.Array]) -> jax.Array:
        """What the meters see, shape ``(meters,)``."""
        return jnp.stack([probes.get(n, seen[n]) for n in self._names])

    @property
    def _names(self) -> list[str]:
        """The channels that have a meter."""
        channels = jax.eval_shape(lambda: self.driven.read(self.driven.start(), jnp.zeros(self.driven.wires)))
        return sorted(n for n in channels if channel_of(n) in self.meters.each)

    @property
    def _rows(self) -> int:
        return 1 + max(meter.delay for meter in self.meters.each.values())

    @property
    def _unknown(self) -> list[str]:
        return sorted(self.unknown)  # the order in which a compiled function sees a dictionary

    def _middle(self) -> jax.Array:
        plant = self.driven.plant if isinstance(self.driven, DrivenPlant) else None
        return jnp.asarray([parameters.get(plant, n) for n in self._unknown], jnp.float64)

    def _deviations(self) -> jax.Array:
        return jnp.asarray([self.unknown[n] for n in self._unknown], jnp.float64)

    def _as(self, values: jax.Array) -> AbstractDriven:
        return self.driven.changed({n: values[i] for i, n in enumerate(self._unknown)})

    def _possible(self, state: Any, unknown: jax.Array) -> tuple[Any, jax.Array]:
        """A mean where the equations hold: fractions within 0 and 1, parameters within their bounds."""
        if not isinstance(self.driven, DrivenPlant):
            return state, unknown
        ends = [parameters.declaration(self.driven.plant, n) for n in self._unknown]
        detwinned = within(state[0].fractions.detwinned, 0.0, 1.0)
        fractions = Fractions(detwinned, within(state[0].fractions.twinned, 0.0, 1.0 - detwinned))
        lower, upper = (jnp.asarray([getattr(e, side) for e in ends], jnp.float64) for side in ("lower", "upper"))
        return (state[0]._replace(fractions=fractions), state[1]), within(unknown, lower, upper)
