"""What a rig does not measure, from what it does: an ensemble Kalman filter on the plant.

``members`` plants, which differ in what is not known of the rig (its convection, its ambient), are carried along under the same commands.
At each sample what they would show is compared with what is measured, and each state is moved along the ensemble's covariances (square
root filter, one measurement after another: Whitaker, Hamill, Mon. Weather Rev. 130 (2002) 1913). In a hysteresis the next kelvin may do
nothing and the fifth all; members on both sides of it see both. ``extended`` linearises the plant at one state, and has to be told by a
walk of the fractions that it may be on the wrong side.

The drive's own channels are measurements: under a current, the voltage tells the resistance, and that the phases. A thermocouple follows
its wire with a first-order lag, which is part of what is estimated. What is not known wanders within its spread: of the ambient, that is
noise of the heat balance. Relaxation to the spread before a measurement (Whitaker, Hamill, Mon. Weather Rev. 140 (2012) 3078) keeps the
ensemble from trusting itself too much: it has fewer members than there are ways to be wrong.
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.control.driven import DrivenPlant
from smajax.control.meters import probed
from smajax.control.observers import AbstractFilter, Estimate
from smajax.kinks import within
from smajax.parameters import parameter
from smajax.plant.material.base import Fractions
from smajax.plant.step import push
from smajax.units import numbered


class Ensemble(NamedTuple):
    """The members' ``states`` of the plant, their thermocouples, shape ``(m, wires)``, and their unknown parameters, ``(m, p)``; the
    command that acts since the last sample, ``(wires,)``, and how many samples there have been.
    """

    states: Any
    probes: jax.Array
    unknown: jax.Array
    command: jax.Array
    count: jax.Array


class EnsembleFilter(AbstractFilter):
    """The filter of the module's text, sampled at the period of ``driven``, which is the plant as far as it is known.

    ``noise`` are standard deviations of the measured channels by name (infinite: not measured), ``temperature`` being that of the
    thermocouple, which follows with ``lag``. ``unknown`` are standard deviations of named parameters about the plant's.
    """

    driven: DrivenPlant
    noise: dict[str, jax.Array]
    unknown: dict[str, jax.Array]
    lag: jax.Array = parameter("s", "time constant of the thermocouple", 0.0, default=0.0)
    memory: jax.Array = parameter("s", "time after which what is unknown is another", 0.0, default=30.0)
    relaxation: jax.Array = parameter("1", "share of the spread that a measurement takes and that is given back", 0.0, 1.0, 0.5)
    trust: jax.Array = parameter("1", "standard deviations by which a measurement may surprise; more counts as so many", 0.0, default=2.0)
    members: int = eqx.field(static=True, default=32)
    seed: int = eqx.field(static=True, default=0)

    def reset(self) -> Ensemble:
        """At rest without any command."""
        drawn = jax.random.normal(jax.random.key(self.seed), (self.members, len(self.unknown)))
        unknown = jax.vmap(lambda draw: self._possible(self._middle() + self._deviations() * draw))(drawn)
        states = jax.vmap(lambda values: self._as(values).start())(unknown)
        return Ensemble(states, states[0].temperature, unknown, jnp.zeros(self.driven.wires), jnp.asarray(0))

    def step(self, ensemble: Ensemble, measured: Mapping[str, jax.Array]) -> Ensemble:
        """The ensemble a period on under its command, once the channels of ``noise`` are measured there (scalars; NaN: not this time)."""
        later = self._carry(ensemble)
        shown = jax.vmap(self._shown, in_axes=(0, 0, 0, None))(later.states, later.probes, later.unknown, later.command)
        pieces = (later.states[0].temperature, *later.states[0].fractions, later.probes, later.unknown)
        seen = [n for name in sorted(self.noise) for n in self._names(name)]
        members = jnp.concatenate([*pieces, jnp.stack([shown[n] for n in seen], axis=1)], axis=1)
        mean = jnp.mean(members, axis=0)
        away = members - mean[None]
        before = _deviation(away)
        for k, name in enumerate(seen):
            at = members.shape[1] - len(seen) + k
            own, noise = jnp.mean(away[:, at] ** 2) * self.members / (self.members - 1), self.noise[_base(name, self.noise)] ** 2
            known = jnp.isfinite(measured[name])
            slope = jnp.where(known, away[:, at] @ away / (self.members - 1) / (own + noise), 0.0)
            far = self.trust * jnp.sqrt(own + noise)
            mean = mean + slope * within(jnp.where(known, measured[name], mean[at]) - mean[at], -far, far)
            away = away - jnp.outer(away[:, at], slope) / (1.0 + jnp.sqrt(1.0 / (1.0 + own / noise)))
        after = _deviation(away)
        widened = 1.0 + self.relaxation * (before / jnp.where(after > 0.0, after, 1.0) - 1.0) * (after > 0.0)
        return self._taken(later, mean[None] + away * widened[None])

    def estimate(self, ensemble: Ensemble) -> Estimate:
        """What the members say at their sample, and how far they differ."""

        def single(state: Any, values: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
            return self._as(values).read(state, ensemble.command), state[0].fractions.martensite

        channels, martensite = jax.vmap(single)(ensemble.states, ensemble.unknown)
        mean, spread = ({n: f(v, axis=0) for n, v in channels.items()} for f in (jnp.mean, _spread))
        return Estimate(mean, spread, jnp.mean(martensite, axis=0), _spread(martensite, axis=0))

    def begin(self, heard: dict[str, jax.Array]) -> Ensemble:
        """See ``AbstractThermometer``."""
        return self.reset()

    def watch(self, state: Ensemble, heard: dict[str, jax.Array]) -> tuple[Ensemble, jax.Array]:
        """See ``AbstractThermometer``."""
        ensemble = self.step(state, heard)
        return ensemble, jnp.mean(ensemble.states[0].temperature, axis=0)

    def under(self, state: Ensemble, command: jax.Array) -> Ensemble:
        """See ``AbstractThermometer``."""
        return state._replace(command=command)

    def believed(self, state: Ensemble, channel: str) -> jax.Array:
        """See ``AbstractFilter``: the members' mean."""
        each = jax.vmap(lambda one, values: self._as(values).read(one, state.command)[channel])
        return jnp.mean(each(state.states, state.unknown))

    @property
    def _unknown(self) -> list[str]:
        return sorted(self.unknown)  # the order in which a compiled function sees a dictionary

    def _middle(self) -> jax.Array:
        return jnp.stack([parameters.get(self.driven.plant, n) for n in self._unknown])

    def _deviations(self) -> jax.Array:
        return jnp.stack([self.unknown[n] for n in self._unknown])

    def _possible(self, values: jax.Array) -> jax.Array:
        """A member's parameters where the equations hold, shape ``(p,)``."""
        ends = [parameters.declaration(self.driven.plant, n) for n in self._unknown]
        return within(values, jnp.asarray([e.lower for e in ends]), jnp.asarray([e.upper for e in ends]))

    def _as(self, values: jax.Array) -> DrivenPlant:
        return _as(self.driven, tuple(self._unknown), values)

    def _names(self, channel: str) -> tuple[str, ...]:
        plant = self.driven.plant
        return (channel,) if channel == plant.mechanism.coordinate or channel == "torque" else numbered(channel, self.driven.wires)

    def _carry(self, ensemble: Ensemble) -> Ensemble:
        """A period on, before anything is measured."""
        stays, middle = jnp.exp(-self.driven.period / self.memory), self._middle()
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(self.seed), ensemble.count), 0)

        def wander(values: jax.Array, draw: jax.Array) -> jax.Array:
            return self._possible(middle + stays * (values - middle) + jnp.sqrt(1.0 - stays**2) * self._deviations() * draw)

        unknown = jax.vmap(wander)(ensemble.unknown, jax.random.normal(key, ensemble.unknown.shape))

        states = _moved(self.driven, tuple(self._unknown), ensemble.states, unknown, ensemble.command)
        probes = probed(ensemble.probes, states[0].temperature, self.lag, self.driven.period)
        return Ensemble(states, probes, unknown, ensemble.command, ensemble.count + 1)

    def _shown(self, state: Any, probe: jax.Array, values: jax.Array, command: jax.Array) -> dict[str, jax.Array]:
        """The channels of a member as its rig would measure them."""
        return self._as(values).read(state, command) | dict(zip(self._names("temperature"), probe, strict=True))

    def _taken(self, ensemble: Ensemble, members: jax.Array) -> Ensemble:
        """The ensemble with other temperatures, fractions, thermocouples and parameters; fractions stay within 0 and 1."""
        wires, (state, time) = self.driven.wires, ensemble.states
        temperature, detwinned, twinned, probes = (members[:, i * wires : (i + 1) * wires] for i in range(4))
        detwinned = within(detwinned, 0.0, 1.0)
        fractions = Fractions(detwinned, within(twinned, 0.0, 1.0 - detwinned))
        unknown = jax.vmap(self._possible)(members[:, 4 * wires : 4 * wires + len(self.unknown)])
        state = state._replace(temperature=temperature, fractions=fractions)
        return ensemble._replace(states=(state, time), probes=probes, unknown=unknown)


def _as(driven: DrivenPlant, names: tuple[str, ...], values: jax.Array) -> DrivenPlant:
    return driven.changed({n: values[i] for i, n in enumerate(names)})


@eqx.filter_custom_jvp
def _moved(driven: DrivenPlant, names: tuple[str, ...], states: Any, unknown: jax.Array, command: jax.Array) -> Any:
    """The members' states a period on; differentiable, as a rollout is, with the ends of all steps known."""
    return jax.vmap(lambda state, values: _as(driven, names, values).advance(state, command)[0])(states, unknown)


@_moved.def_jvp
def _moved_jvp(primals: tuple, tangents: tuple) -> tuple:
    (driven, names, states, unknown, command), (drivens, _, *along) = primals, tangents
    along = jax.tree.map(lambda v, t: jnp.zeros_like(v) if t is None else t, (states, unknown, command), tuple(along), is_leaf=_none)

    def single(state: Any, values: jax.Array, moved: Any, shifts: jax.Array) -> tuple[Any, Any]:
        now, way, _ = _as(driven, names, values).advance(state, command)

        def landed(driven: DrivenPlant, state: Any, values: jax.Array, command: jax.Array) -> Any:
            return _as(driven, names, values).land(state, command, way)

        return now, push(landed, (driven, state, values, command), (drivens, moved, shifts, along[2]))

    return jax.vmap(single)(states, unknown, *along[:2])


def _none(leaf: Any) -> bool:
    return leaf is None


def _base(name: str, known: Mapping[str, Any]) -> str:
    return name if name in known else name.rpartition("_")[0]


def _deviation(away: jax.Array) -> jax.Array:
    """Standard deviations; of what the members agree on 0, whose derivative is 0 too."""
    squares = jnp.sum(away**2, axis=0) / (away.shape[0] - 1)
    return jnp.where(squares > 0.0, jnp.sqrt(jnp.where(squares > 0.0, squares, 1.0)), 0.0)


def _spread(values: jax.Array, axis: int) -> jax.Array:
    return jnp.std(values, axis=axis, ddof=1)
