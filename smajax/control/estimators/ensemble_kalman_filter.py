"""Ensemble Kalman filter on the plant: the state of a rig, and unknown parameters, from what it measures.

``members`` plants, which differ in the unknown parameters of the rig (its convection, its ambient temperature), are
simulated under the same commands. At each sample their readings are compared with the measurements, and each state is
corrected along the covariances of the ensemble (square-root filter, one measurement after another). In a hysteresis the
next kelvin may transform nothing and the fifth one everything; members on both sides represent both.
``ExtendedKalmanFilter`` linearises the plant at one state, and represents the other branch only by a process noise of
the fractions.

The channels of the drive are measurements, too: under a current, the voltage gives the resistance, and that the phase
fractions. A thermocouple follows its wire with a first-order lag, and its temperature is estimated with the rest.
Unknown parameters vary within their standard deviation: for the ambient temperature that is noise of the heat balance.
Relaxation to the prior spread keeps the ensemble from becoming overconfident, since it has fewer members than there are
sources of error.

Source: whitaker2002 (square-root filter); whitaker2012 (relaxation to the prior spread).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax import parameters
from smajax.channels import numbered
from smajax.control.estimators.base import AbstractFilter, Estimate
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import thermocouple_reading
from smajax.numerics.implicit_differentiation import jvp
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from smajax.plant.materials.base import Fractions


class Ensemble(NamedTuple):
    """State of the filter.

    ``states`` of the plant, ``thermocouples`` in degC, shape ``(members, wires)``, and unknown ``parameters``, shape
    ``(members, p)``, of the members; ``command`` since the last sample, shape ``(wires,)``, and the ``count`` of
    samples so far.
    """

    states: Any
    thermocouples: jax.Array
    parameters: jax.Array
    command: jax.Array
    count: jax.Array


class EnsembleKalmanFilter(AbstractFilter):
    """Ensemble Kalman filter, sampled at the period of ``system``, the nominal plant.

    ``noise`` are standard deviations of the measured channels by name (infinite: not measured); ``temperature`` is that
    of the thermocouple, which follows with ``lag``. ``parameter_deviations`` are standard deviations of named
    parameters about those of the plant.
    """

    system: SampledPlant
    noise: dict[str, jax.Array]
    parameter_deviations: dict[str, jax.Array]
    lag: jax.Array = parameter("s", "time constant of the thermocouple", 0.0, default=0.0)
    correlation_time: jax.Array = parameter("s", "correlation time of the unknown parameters", 0.0, default=30.0)
    relaxation: jax.Array = parameter("1", "relaxation of the spread towards that before a measurement", 0.0, 1.0, 0.5)
    innovation_limit: jax.Array = parameter(
        "1", "innovation in standard deviations at which it is clipped", 0.0, default=2.0
    )
    members: int = eqx.field(static=True, default=32)
    seed: int = eqx.field(static=True, default=0)

    def reset(self) -> Ensemble:
        """Return the ensemble at rest without any command."""
        draws = jax.random.normal(jax.random.key(self.seed), (self.members, len(self.parameter_deviations)))
        values = jax.vmap(
            lambda draw: self._clip_parameters(self._nominal_parameters() + self._parameter_deviations() * draw)
        )(draws)
        states = jax.vmap(lambda values: self._with_parameters(values).start())(values)
        return Ensemble(states, states[0].temperature, values, jnp.zeros(self.system.wires), jnp.asarray(0))

    def step(self, ensemble: Ensemble, measured: Mapping[str, jax.Array]) -> Ensemble:
        """Predict over one period under the last commands, then correct by the measurements.

        Args:
            ensemble: State after the previous sample.
            measured: Channels of ``noise`` at this sample, scalars by name; NaN: not measured.
        """
        predicted = self._predict(ensemble)
        readings = jax.vmap(self._exact_readings, in_axes=(0, 0, 0, None))(
            predicted.states, predicted.thermocouples, predicted.parameters, predicted.command
        )
        numbers = (
            predicted.states[0].temperature,
            *predicted.states[0].fractions,
            predicted.thermocouples,
            predicted.parameters,
        )
        names = [n for name in sorted(self.noise) for n in self._channel_names(name)]
        members = jnp.concatenate([*numbers, jnp.stack([readings[n] for n in names], axis=1)], axis=1)
        mean = jnp.mean(members, axis=0)
        anomalies = members - mean[None]
        prior = _standard_deviation(anomalies)
        for k, name in enumerate(names):
            at = members.shape[1] - len(names) + k
            noise = self.noise[_kind(name, self.noise)] ** 2
            mean, anomalies = self._correct(mean, anomalies, at, noise, measured[name])
        posterior = _standard_deviation(anomalies)
        inflation = 1.0 + self.relaxation * (prior / jnp.where(posterior > 0.0, posterior, 1.0) - 1.0) * (
            posterior > 0.0
        )
        return self._with_numbers(predicted, mean[None] + anomalies * inflation[None])

    def _correct(
        self, mean: jax.Array, anomalies: jax.Array, at: int, noise: jax.Array, measured: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Correct by a measurement of the number at place ``at``, with variance ``noise``."""
        variance = jnp.mean(anomalies[:, at] ** 2) * self.members / (self.members - 1)
        valid = jnp.isfinite(measured)
        gain = jnp.where(valid, anomalies[:, at] @ anomalies / (self.members - 1) / (variance + noise), 0.0)
        limit = self.innovation_limit * jnp.sqrt(variance + noise)
        mean = mean + gain * clip(jnp.where(valid, measured, mean[at]) - mean[at], -limit, limit)
        anomalies = anomalies - jnp.outer(anomalies[:, at], gain) / (1.0 + jnp.sqrt(1.0 / (1.0 + variance / noise)))
        return mean, anomalies

    def estimate(self, ensemble: Ensemble) -> Estimate:
        """Return means and standard deviations of the channels and martensite fractions over the members."""

        def member(state: Any, values: jax.Array) -> tuple[dict[str, jax.Array], jax.Array]:
            return self._with_parameters(values).observe(state, ensemble.command), state[0].fractions.martensite

        channels, martensite = jax.vmap(member)(ensemble.states, ensemble.parameters)
        mean, deviation = ({n: f(v, axis=0) for n, v in channels.items()} for f in (jnp.mean, _sample_deviation))
        return Estimate(mean, deviation, jnp.mean(martensite, axis=0), _sample_deviation(martensite, axis=0))

    def init(self, measured: dict[str, jax.Array]) -> Ensemble:
        """Return the ensemble at rest; the first measurements are not used."""
        return self.reset()

    def update(self, state: Ensemble, measured: dict[str, jax.Array]) -> tuple[Ensemble, jax.Array]:
        """Take one sample; returns the ensemble and the mean temperatures in degC, shape ``(wires,)``."""
        ensemble = self.step(state, measured)
        return ensemble, jnp.mean(ensemble.states[0].temperature, axis=0)

    def apply_command(self, state: Ensemble, command: jax.Array) -> Ensemble:
        """Return the ensemble with the commands until the next sample."""
        return state._replace(command=command)

    def estimated_channel(self, state: Ensemble, channel: str) -> jax.Array:
        """Return the members' mean of a channel, a scalar."""
        members = jax.vmap(lambda member, values: self._with_parameters(values).observe(member, state.command)[channel])
        return jnp.mean(members(state.states, state.parameters))

    @property
    def _parameter_names(self) -> list[str]:
        return sorted(self.parameter_deviations)  # the order in which a compiled function sees a dictionary

    def _nominal_parameters(self) -> jax.Array:
        return jnp.stack([parameters.get(self.system.plant, n) for n in self._parameter_names])

    def _parameter_deviations(self) -> jax.Array:
        return jnp.stack([self.parameter_deviations[n] for n in self._parameter_names])

    def _clip_parameters(self, values: jax.Array) -> jax.Array:
        """A member's parameters within their bounds, shape ``(p,)``."""
        declared = [parameters.declaration(self.system.plant, n) for n in self._parameter_names]
        return clip(values, jnp.asarray([d.lower for d in declared]), jnp.asarray([d.upper for d in declared]))

    def _with_parameters(self, values: jax.Array) -> SampledPlant:
        return _with_parameters(self.system, tuple(self._parameter_names), values)

    def _channel_names(self, channel: str) -> tuple[str, ...]:
        """The names of a channel: one, or one for each wire."""
        if channel == self.system.plant.mechanism.coordinate or channel == "torque":
            return (channel,)
        return numbered(channel, self.system.wires)

    def _predict(self, ensemble: Ensemble) -> Ensemble:
        """One period without measurements."""
        decay, nominal = jnp.exp(-self.system.period / self.correlation_time), self._nominal_parameters()
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(self.seed), ensemble.count), 0)

        def next_parameters(values: jax.Array, draw: jax.Array) -> jax.Array:
            return self._clip_parameters(
                nominal + decay * (values - nominal) + jnp.sqrt(1.0 - decay**2) * self._parameter_deviations() * draw
            )

        draws = jax.random.normal(key, ensemble.parameters.shape)
        values = jax.vmap(next_parameters)(ensemble.parameters, draws)
        states = _step_members(self.system, tuple(self._parameter_names), ensemble.states, values, ensemble.command)
        thermocouples = thermocouple_reading(
            ensemble.thermocouples, states[0].temperature, self.lag, self.system.period
        )
        return Ensemble(states, thermocouples, values, ensemble.command, ensemble.count + 1)

    def _exact_readings(
        self, state: Any, thermocouples: jax.Array, values: jax.Array, command: jax.Array
    ) -> dict[str, jax.Array]:
        """The channels of a member as its instruments would show them without noise."""
        readings = dict(zip(self._channel_names("temperature"), thermocouples, strict=True))
        return self._with_parameters(values).observe(state, command) | readings

    def _with_numbers(self, ensemble: Ensemble, members: jax.Array) -> Ensemble:
        """The ensemble with other temperatures, fractions (clipped to 0 and 1), thermocouples and parameters."""
        wires, (state, time) = self.system.wires, ensemble.states
        temperature, detwinned, twinned, thermocouples = (members[:, i * wires : (i + 1) * wires] for i in range(4))
        detwinned = clip(detwinned, 0.0, 1.0)
        fractions = Fractions(detwinned, clip(twinned, 0.0, 1.0 - detwinned))
        values = jax.vmap(self._clip_parameters)(members[:, 4 * wires : 4 * wires + len(self.parameter_deviations)])
        state = state._replace(temperature=temperature, fractions=fractions)
        return ensemble._replace(states=(state, time), thermocouples=thermocouples, parameters=values)


def _with_parameters(system: SampledPlant, names: tuple[str, ...], values: jax.Array) -> SampledPlant:
    return system.with_parameters({n: values[i] for i, n in enumerate(names)})


@eqx.filter_custom_jvp
def _step_members(
    system: SampledPlant, names: tuple[str, ...], states: Any, values: jax.Array, command: jax.Array
) -> Any:
    """The members' states a period later; its derivative reuses the step solutions, as that of a rollout does."""
    return jax.vmap(lambda state, v: _with_parameters(system, names, v).step(state, command)[0])(states, values)


@_step_members.def_jvp
def _step_members_jvp(primals: tuple, tangents: tuple) -> tuple:
    (system, names, states, values, command), (system_tangent, _, *other_tangents) = primals, tangents
    state_tangents, value_tangents, command_tangent = jax.tree.map(
        lambda v, t: jnp.zeros_like(v) if t is None else t,
        (states, values, command),
        tuple(other_tangents),
        is_leaf=_is_none,
    )

    def member(state: Any, values: jax.Array, state_tangent: Any, value_tangent: jax.Array) -> tuple[Any, Any]:
        later, step_solutions, _ = _with_parameters(system, names, values).step(state, command)

        def step(system: SampledPlant, state: Any, values: jax.Array, command: jax.Array) -> Any:
            return _with_parameters(system, names, values).differentiable_step(state, command, step_solutions)

        return later, jvp(
            step, (system, state, values, command), (system_tangent, state_tangent, value_tangent, command_tangent)
        )

    return jax.vmap(member)(states, values, state_tangents, value_tangents)


def _is_none(leaf: Any) -> bool:
    return leaf is None


def _kind(name: str, kinds: Mapping[str, Any]) -> str:
    """The kind of a channel: its name without the number of the wire."""
    return name if name in kinds else name.rpartition("_")[0]


def _standard_deviation(anomalies: jax.Array) -> jax.Array:
    """Standard deviations, shape ``(n,)``; where all members agree it is 0, with the derivative 0."""
    squares = jnp.sum(anomalies**2, axis=0) / (anomalies.shape[0] - 1)
    return jnp.where(squares > 0.0, jnp.sqrt(jnp.where(squares > 0.0, squares, 1.0)), 0.0)


def _sample_deviation(values: jax.Array, axis: int) -> jax.Array:
    return jnp.std(values, axis=axis, ddof=1)
