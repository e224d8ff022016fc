"""Ensemble Kalman filter on the plant: the state of a rig, and unknown parameters, from what it measures.

N plants, the members, differ in the unknown parameters of the rig (such as its convection and its ambient temperature)
and are simulated under the same commands. At each sample, the measurements correct the members one after another
(square-root filter). With the mean x of the members' numbers, their anomalies X (one row per member, column X_y for the
measured number) and the variance r of the measurement's noise,

    P_yy = X_y^T X_y / (N - 1)     K = X^T X_y / (N - 1) / (P_yy + r)
    x <- x + K (y - x_y)           X <- X - X_y K^T / (1 + sqrt(r / (P_yy + r)))

The innovation y - x_y is clipped to ``innovation_limit`` standard deviations. After all measurements, the anomalies are
inflated by 1 + a (s_prior / s - 1), with ``relaxation`` a and the standard deviations s_prior and s of the members
before and after the correction: relaxation to the prior spread keeps the ensemble from becoming overconfident, since it
has fewer members than there are sources of error.

At a knee of the hysteresis a small change of temperature transforms nothing or much, and members on both sides
represent both cases. ``ExtendedKalmanFilter`` linearises the plant at one state, and represents the other branch only
by a process noise of the fractions.

The channels of the drive are measurements, too: under a known current, the voltage gives the resistance, and the
resistance the phase fractions. A thermocouple follows its wire with a first-order lag, and its temperature is estimated
as well. The unknown parameters vary in time within their standard deviations.

Source: whitaker2002 (square-root filter); whitaker2012 (relaxation to the prior spread).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax import parameters
from smajax.channels import numbered
from smajax.control.estimators.base import AbstractFilter, Estimate, check_uniform_wire
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import thermocouple_reading
from smajax.numerics.implicit_differentiation import jvp
from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from smajax.plant.materials.base import Fractions

# Defaults, chosen by trial; tests/unit/control/test_ensemble_kalman_filter.py holds that the intervals have their
# coverage with them.
# Correlation time of the unknown parameters, s.
_CORRELATION_TIME = 30.0
# Relaxation of the spread towards that before the measurements.
_RELAXATION = 0.5
# Innovation in standard deviations at which it is clipped.
_INNOVATION_LIMIT = 2.0
# Number of members.
_MEMBERS = 32


class Ensemble(NamedTuple):
    """State of the filter.

    Attributes:
        states: States of the members' plants, leaves with a leading axis of members.
        thermocouples: Temperatures of the thermocouples, shape ``(members, wires)``, degC.
        parameters: Unknown parameters, shape ``(members, p)``, internal units.
        command: Commands since the last sample, shape ``(wires,)``.
        count: Number of samples so far.
    """

    states: Any
    thermocouples: jax.Array
    parameters: jax.Array
    command: jax.Array
    count: jax.Array


class EnsembleKalmanFilter(AbstractFilter):
    """Ensemble Kalman filter on the plant.

    Attributes:
        system: Nominal plant, sampled at the period of the filter.
        noise: Standard deviations of the measured channels by kind, scalars in internal units (infinite: not measured);
            ``temperature`` is that of the thermocouples.
        parameter_deviations: Standard deviations of the unknown parameters about those of ``system`` by name.
        lag: Time constant of the thermocouples, s.
        correlation_time: Correlation time of the unknown parameters, s.
        relaxation: Relaxation of the spread towards that before the measurements, 0 to 1.
        innovation_limit: Innovation in standard deviations at which it is clipped.
        members: Number N of members.
        seed: Seed of the random numbers.
    """

    system: SampledPlant
    noise: dict[str, jax.Array]
    parameter_deviations: dict[str, jax.Array]
    lag: jax.Array = parameter("s", "time constant of the thermocouple", 0.0, default=0.0)
    correlation_time: jax.Array = parameter(
        "s", "correlation time of the unknown parameters", 0.0, default=_CORRELATION_TIME
    )
    relaxation: jax.Array = parameter(
        "1", "relaxation of the spread towards that before a measurement", 0.0, 1.0, _RELAXATION
    )
    innovation_limit: jax.Array = parameter(
        "1", "innovation in standard deviations at which it is clipped", 0.0, default=_INNOVATION_LIMIT
    )
    members: int = eqx.field(static=True, default=_MEMBERS)
    seed: int = eqx.field(static=True, default=0)

    def __check_init__(self) -> None:
        check_uniform_wire(self.system)

    @property
    def period(self) -> float:
        """Period of the samples, s: that of the plant."""
        return self.system.period

    def reset(self) -> Ensemble:
        """Return the ensemble at rest without any command."""
        draws = jax.random.normal(jax.random.key(self.seed), (self.members, len(self.parameter_deviations)))
        values = jax.vmap(
            lambda draw: self._clip_parameters(self._nominal_parameters() + self._parameter_deviations() * draw)
        )(draws)
        states = jax.vmap(lambda values: self._with_parameters(values).start())(values)
        return Ensemble(states, states[0].temperature, values, jnp.zeros(self.system.wires), jnp.asarray(0))

    def step(self, ensemble: Ensemble, measured: Mapping[str, Float[Array, ""]]) -> Ensemble:
        """Predict over one period under the last commands, then correct by the measurements.

        Args:
            ensemble: State after the previous sample.
            measured: Channels of ``noise`` at this sample by name; NaN: not measured.

        Returns:
            The state at this sample.
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
            index = members.shape[1] - len(names) + k
            noise = self.noise[_kind(name, self.noise)] ** 2
            mean, anomalies = self._correct(mean, anomalies, index, noise, measured[name])
        posterior = _standard_deviation(anomalies)
        inflation = 1.0 + self.relaxation * (prior / jnp.where(posterior > 0.0, posterior, 1.0) - 1.0) * (
            posterior > 0.0
        )
        return self._with_numbers(predicted, mean[None] + anomalies * inflation[None])

    def _correct(
        self,
        mean: Float[Array, " n"],
        anomalies: Float[Array, "members n"],
        index: int,
        noise: Float[Array, ""],
        measured: Float[Array, ""],
    ) -> tuple[Float[Array, " n"], Float[Array, "members n"]]:
        """Correct by a measurement of the number at ``index`` with variance ``noise``."""
        measured_anomalies = anomalies[:, index]
        variance = jnp.mean(measured_anomalies**2) * self.members / (self.members - 1)
        valid = jnp.isfinite(measured)
        gain = jnp.where(valid, measured_anomalies @ anomalies / (self.members - 1) / (variance + noise), 0.0)
        limit = self.innovation_limit * jnp.sqrt(variance + noise)
        mean = mean + gain * clip(jnp.where(valid, measured, mean[index]) - mean[index], -limit, limit)
        # sqrt(r / (P_yy + r)), which is 1 for an infinite r.
        noise_share = jnp.sqrt(1.0 / (1.0 + variance / noise))
        return mean, anomalies - jnp.outer(measured_anomalies, gain) / (1.0 + noise_share)

    def estimate(self, ensemble: Ensemble) -> Estimate:
        """Return means and standard deviations of the channels and martensite fractions over the members."""

        def member(
            state: Any, values: Float[Array, " p"]
        ) -> tuple[dict[str, Float[Array, ""]], Float[Array, " wires"]]:
            return self._with_parameters(values).observe(state, ensemble.command), state[0].fractions.martensite

        channels, martensite = jax.vmap(member)(ensemble.states, ensemble.parameters)
        mean, deviation = ({n: f(v, axis=0) for n, v in channels.items()} for f in (jnp.mean, _sample_deviation))
        return Estimate(mean, deviation, jnp.mean(martensite, axis=0), _sample_deviation(martensite, axis=0))

    def init(self, measured: dict[str, Float[Array, ""]]) -> Ensemble:
        """Return the ensemble at rest; the first measurements are not used."""
        return self.reset()

    def update(self, state: Ensemble, measured: dict[str, Float[Array, ""]]) -> tuple[Ensemble, Float[Array, " wires"]]:
        """Predict and correct; return the ensemble and the mean temperatures of the wires in degC."""
        ensemble = self.step(state, measured)
        return ensemble, jnp.mean(ensemble.states[0].temperature, axis=0)

    def apply_command(self, state: Ensemble, command: Float[Array, " wires"]) -> Ensemble:
        """Return the ensemble with the commands until the next sample."""
        return state._replace(command=command)

    def estimated_channel(self, state: Ensemble, channel: str) -> Float[Array, ""]:
        """Return the mean of a channel over the members."""
        members = jax.vmap(lambda member, values: self._with_parameters(values).observe(member, state.command)[channel])
        return jnp.mean(members(state.states, state.parameters))

    @property
    def _parameter_names(self) -> list[str]:
        return sorted(self.parameter_deviations)  # the order in which a compiled function sees a dictionary

    def _nominal_parameters(self) -> Float[Array, " p"]:
        return jnp.stack([parameters.get(self.system.plant, n) for n in self._parameter_names])

    def _parameter_deviations(self) -> Float[Array, " p"]:
        return jnp.stack([self.parameter_deviations[n] for n in self._parameter_names])

    def _clip_parameters(self, values: Float[Array, " p"]) -> Float[Array, " p"]:
        """The parameters of a member within their bounds."""
        declared = [parameters.declaration(self.system.plant, n) for n in self._parameter_names]
        return clip(values, jnp.asarray([d.lower for d in declared]), jnp.asarray([d.upper for d in declared]))

    def _with_parameters(self, values: Float[Array, " p"]) -> SampledPlant:
        return _with_parameters(self.system, tuple(self._parameter_names), values)

    def _channel_names(self, channel: str) -> tuple[str, ...]:
        """The names of a channel: one, or one for each wire."""
        if channel == self.system.plant.mechanism.coordinate or channel == "torque":
            return (channel,)
        return numbered(channel, self.system.wires)

    def _predict(self, ensemble: Ensemble) -> Ensemble:
        """Prediction over one period; the parameters decay to the nominal ones and get noise."""
        decay, nominal = jnp.exp(-self.system.period / self.correlation_time), self._nominal_parameters()
        key = jax.random.fold_in(jax.random.fold_in(jax.random.key(self.seed), ensemble.count), 0)

        def next_parameters(values: Float[Array, " p"], draw: Float[Array, " p"]) -> Float[Array, " p"]:
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
        self,
        state: Any,
        thermocouples: Float[Array, " wires"],
        values: Float[Array, " p"],
        command: Float[Array, " wires"],
    ) -> dict[str, Float[Array, ""]]:
        """Readings of a member's instruments without noise, and its other channels."""
        readings = dict(zip(self._channel_names("temperature"), thermocouples, strict=True))
        return self._with_parameters(values).observe(state, command) | readings

    def _with_numbers(self, ensemble: Ensemble, members: Float[Array, "members n"]) -> Ensemble:
        """The ensemble with other temperatures, fractions (clipped to 0 .. 1), thermocouples and parameters."""
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
    """The members' states a period later; the derivative reuses the step solutions, as that of a rollout does."""
    return jax.vmap(lambda state, v: _with_parameters(system, names, v).step(state, command)[0])(states, values)


@_step_members.def_jvp
def _step_members_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
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


def _standard_deviation(anomalies: Float[Array, "members n"]) -> Float[Array, " n"]:
    """Standard deviations of the columns; where all members are equal, value and derivative are 0."""
    squares = jnp.sum(anomalies**2, axis=0) / (anomalies.shape[0] - 1)
    return jnp.where(squares > 0.0, jnp.sqrt(jnp.where(squares > 0.0, squares, 1.0)), 0.0)


def _sample_deviation(values: jax.Array, axis: int) -> jax.Array:
    return jnp.std(values, axis=axis, ddof=1)
