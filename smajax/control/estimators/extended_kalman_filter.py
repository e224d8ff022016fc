"""Extended Kalman filter on the plant: the state of a rig, and unknown parameters, from what its instruments measure.

One plant is simulated under the same commands as the rig, with a covariance P of its error. Over a period

    x' = f(x, command)      P' = F (P + Q) F^T       F = df/dx, by forward mode through the plant's steps at their
    solutions

and each measurement y corrects both (one after another, since their noises are independent), in Joseph's form, which
keeps P symmetric and positive semidefinite in spite of rounding:

    K = P h / (h^T P h + r)     x += K (y - h^T x)     P = (1 - K h^T) P (1 - K h^T)^T + r K K^T

r grows where the innovation exceeds ``huber_threshold`` standard deviations (Huber's weight), so that no single
measurement moves x to another branch. x holds the plant's integrator state (temperatures, fractions, stresses, unknowns
and motion of the mechanism), the temperatures of the thermocouples, the unknown parameters, and the exact readings of
the instruments now and at the last samples, as far back as the longest delay. So a delayed measurement corrects the
present state by its covariance with the reading then, and h picks one number. Quantisation counts as noise, quantum^2 /
12.

The memories of effects (the points at which a branch began, the presliding state of friction, durations) are carried by
the mean and are not in P: they are reset at a reversal, so that their derivative jumps between 0 and 1 with the branch
of the mean, and a correction along it could put such a point where no history leads. The phase fractions need no such
points (see ``smajax.plant.materials.brinson``) and are in P. But the mean is on one branch: that the wire may be on
another one enters P only by the process noise of the fraction. ``EnsembleKalmanFilter`` has members on both branches,
at the cost of as many plants.

Source: kalman1960; bucy1968 (Joseph's form); huber1964 (weight of outliers).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree

from smajax import parameters
from smajax.channels import channel_of
from smajax.control.estimators.base import AbstractFilter, Estimate
from smajax.control.sampled_plant import AbstractSampledSystem, SampledPlant
from smajax.control.sensors.instruments import Instruments, thermocouple_reading
from smajax.numerics.nonsmooth import clip, maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import Fractions


class KalmanState(NamedTuple):
    """State of the filter.

    Means: ``state`` of the plant, ``thermocouples`` by channel (degC), unknown ``parameters``, shape ``(p,)``, and
    exact ``readings`` of the instruments, newest first, shape ``(longest delay + 1, instruments)``. ``covariance`` is
    that of all these numbers in that order. ``command`` are the commands since the last sample, shape ``(wires,)``.
    """

    state: Any
    thermocouples: dict[str, jax.Array]
    parameters: jax.Array
    readings: jax.Array
    covariance: jax.Array
    command: jax.Array


class ExtendedKalmanFilter(AbstractFilter):
    """Extended Kalman filter, sampled at the period of ``system``, the nominal plant.

    ``instruments`` are the measurements by kind of channel: noise, quantisation and delay of each, and the lag of the
    thermocouples. ``parameter_deviations`` are standard deviations of named parameters about those of the plant, within
    which they vary with ``correlation_time``. ``initial_deviation`` and ``process_noise`` have the structure of the
    plant's state: standard deviations of its numbers at the start, and of their random walk in one second, in their
    unit per root second; see ``of``. All are differentiable leaves.
    """

    system: AbstractSampledSystem
    instruments: Instruments
    parameter_deviations: dict[str, jax.Array]
    initial_deviation: Any
    process_noise: Any
    correlation_time: jax.Array = parameter("s", "correlation time of the unknown parameters", 0.0, default=30.0)
    huber_threshold: jax.Array = parameter(
        "1", "innovation in standard deviations beyond which a measurement counts as noisier", 0.0, default=1.0
    )

    @classmethod
    def of(
        cls,
        system: SampledPlant,
        instruments: Instruments,
        parameter_deviations: Mapping[str, Any],
        *,
        initial_temperature_deviation: Any = 0.0,
        temperature_process_noise: Any = 2.0,
        fraction_process_noise: Any = 0.1,
    ) -> "ExtendedKalmanFilter":
        """Build the filter of a rig's wires.

        Both process noises stand for what the filter does not represent on its one branch. With the defaults the
        intervals hold for wires whose convection and ambient temperature differ from the plant's; without a process
        noise of the fraction the filter takes its branch for certain and diverges
        (``tests/unit/control/test_extended_kalman_filter.py`` has both).

        Args:
            system: The nominal plant.
            instruments: What is measured.
            parameter_deviations: Standard deviations of unknown parameters by name.
            initial_temperature_deviation: Standard deviation of the temperatures at the start, K, in addition to that
                of the surroundings; a scalar, or shape ``(wires,)``.
            temperature_process_noise: Standard deviation of the temperatures' random walk in one second, K.
            fraction_process_noise: Standard deviation of the random walk of the detwinned fractions in one second.
        """
        zeros, time = jax.tree.map(jnp.zeros_like, system.start())

        def wires(value: Any) -> jax.Array:
            return jnp.broadcast_to(jnp.asarray(value, jnp.float64), (system.wires,))

        process_noise = zeros._replace(
            temperature=wires(temperature_process_noise),
            fractions=zeros.fractions._replace(detwinned=wires(fraction_process_noise)),
        )
        initial = zeros._replace(temperature=wires(initial_temperature_deviation))
        deviations = {name: jnp.asarray(value, jnp.float64) for name, value in parameter_deviations.items()}
        return cls(system, instruments, deviations, (initial, time), (process_noise, time))

    def reset(self) -> KalmanState:
        """Return the state at rest without any command; the delayed readings are those at rest."""
        nominal, no_command = self._nominal_parameters(), jnp.zeros(self.system.wires)
        deviations, _ = self._estimated_numbers(self.initial_deviation)

        def initial_numbers(error: jax.Array, values: jax.Array) -> tuple[jax.Array, KalmanState]:
            system = self._with_parameters(values)
            numbers, to_state = self._estimated_numbers(system.start())
            state = to_state(numbers + error)
            channels = system.observe(state, no_command)
            thermocouples = {n: channels[n] for n in self._channels if channel_of(n) == "temperature"}
            row = self._exact_readings(channels, thermocouples)
            readings = jnp.broadcast_to(row, (self._reading_rows, len(self._channels)))
            first = KalmanState(state, thermocouples, values, readings, jnp.zeros(()), no_command)
            return jnp.concatenate([self._core(first)[0], jnp.ravel(readings)]), first

        slopes, first = jax.jacfwd(initial_numbers, argnums=(0, 1), has_aux=True)(jnp.zeros_like(deviations), nominal)
        root = jnp.concatenate(slopes, axis=1) * jnp.concatenate([deviations, self._parameter_deviations()])[None]
        return first._replace(covariance=root @ root.T)

    def step(self, filter_state: KalmanState, measured: Mapping[str, jax.Array]) -> KalmanState:
        """Predict over one period under the last commands, then correct by the measurements.

        Args:
            filter_state: State after the previous sample.
            measured: Channels of the instruments at this sample, scalars by name; NaN: not measured.
        """
        predicted = self._predict(filter_state)
        core, split = self._core(predicted)
        mean, covariance = jnp.concatenate([core, jnp.ravel(predicted.readings)]), predicted.covariance
        for k, name in enumerate(self._channels):
            sensor = self.instruments.sensors[str(channel_of(name))]
            at = len(core) + sensor.delay * len(self._channels) + k
            noise = sensor.noise**2 + sensor.quantum**2 / 12.0
            mean, covariance = self._correct(mean, covariance, at, noise, measured[name])
        state, thermocouples, values = split(mean[: len(core)])
        state, values = self._clipped(state, values)
        readings = mean[len(core) :].reshape(predicted.readings.shape)
        return KalmanState(state, thermocouples, values, readings, covariance, predicted.command)

    def _correct(
        self, mean: jax.Array, covariance: jax.Array, at: int, noise: jax.Array, measured: jax.Array
    ) -> tuple[jax.Array, jax.Array]:
        """Correct by a measurement of the number at ``at``, variance ``noise`` (Joseph's form, Huber's weight)."""
        variance = covariance[at, at]
        valid = jnp.isfinite(measured) & (variance + noise > 0.0)
        innovation = jnp.where(valid, measured, mean[at]) - mean[at]
        total = jnp.where(valid, variance + noise, 1.0)
        total = total * maximum(jnp.abs(innovation) / (self.huber_threshold * jnp.sqrt(total)), 1.0)
        gain = jnp.where(valid, covariance[at] / total, 0.0)
        mean = mean + gain * innovation
        reduced = covariance - jnp.outer(gain, covariance[at])
        covariance = reduced - jnp.outer(reduced[:, at], gain) + (total - variance) * jnp.outer(gain, gain)
        return mean, 0.5 * (covariance + covariance.T)

    def estimate(self, filter_state: KalmanState) -> Estimate:
        """Return means and standard deviations of all channels and of the martensite fractions at a sample."""
        core, split = self._core(filter_state)

        def estimated(core: jax.Array) -> tuple[jax.Array, tuple]:
            state, _, values = split(core)
            martensite = state[0].fractions.martensite if isinstance(self.system, SampledPlant) else jnp.zeros(0)
            both = self._with_parameters(values).observe(state, filter_state.command), martensite
            return ravel_pytree(both)[0], both

        slope, (mean, martensite) = jax.jacfwd(estimated, has_aux=True)(core)
        variance = jnp.sum((slope @ filter_state.covariance[: len(core), : len(core)]) * slope, axis=1)
        positive = variance > 0.0
        deviations = jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)
        mean_deviation, martensite_deviation = ravel_pytree((mean, martensite))[1](deviations)
        return Estimate(mean, mean_deviation, martensite, martensite_deviation)

    def init(self, measured: dict[str, jax.Array]) -> KalmanState:
        """Return the state at rest; the first measurements are not used."""
        return self.reset()

    def update(self, state: KalmanState, measured: dict[str, jax.Array]) -> tuple[KalmanState, jax.Array]:
        """Take one sample; returns the state and the estimated temperatures in degC, shape ``(wires,)``."""
        filter_state = self.step(state, measured)
        return filter_state, filter_state.state[0].temperature

    def apply_command(self, state: KalmanState, command: jax.Array) -> KalmanState:
        """Return the state with the commands until the next sample."""
        return state._replace(command=command)

    def estimated_channel(self, state: KalmanState, channel: str) -> jax.Array:
        """Return a channel of the mean, a scalar."""
        return self._with_parameters(state.parameters).observe(state.state, state.command)[channel]

    def linearise(self, filter_state: KalmanState) -> tuple[jax.Array, KalmanState]:
        """Linearise one period.

        Returns:
            The Jacobian of all estimated numbers after the period by those before it, shape as the covariance, and the
            means after it.
        """
        decay, nominal = jnp.exp(-self.instruments.period / self.correlation_time), self._nominal_parameters()
        core, split = self._core(filter_state)

        def after_period(core: jax.Array) -> tuple[jax.Array, KalmanState]:
            state, thermocouples, values = split(core)
            values = nominal + decay * (values - nominal)
            system = self._with_parameters(values)
            state = system.twice_differentiable_step(state, filter_state.command, step_solutions)
            channels = system.observe(state, filter_state.command)
            lag, period = self.instruments.lag, self.instruments.period
            thermocouples = {
                n: thermocouple_reading(reading, channels[n], lag, period) for n, reading in thermocouples.items()
            }
            row = self._exact_readings(channels, thermocouples)
            later = filter_state._replace(state=state, thermocouples=thermocouples, parameters=values)
            later = later._replace(readings=jnp.concatenate([row[None], filter_state.readings[:-1]]))
            return jnp.concatenate([self._core(later)[0], row]), later

        # The steps are solved once, for the mean; how their solutions depend on it is in ``twice_differentiable_step``.
        system, state, command = jax.lax.stop_gradient(
            (
                self._with_parameters(nominal + decay * (filter_state.parameters - nominal)),
                filter_state.state,
                filter_state.command,
            )
        )
        _, step_solutions, _ = system.step(state, command)
        slope, later = jax.jacfwd(after_period, has_aux=True)(core)
        n, size = len(core), len(filter_state.covariance)
        # The readings move by one row; the oldest is dropped.
        jacobian = jnp.zeros((size, size)).at[: len(slope), :n].set(slope)
        return jacobian.at[len(slope) :, n : size - len(self._channels)].set(jnp.eye(size - len(slope))), later

    def _predict(self, filter_state: KalmanState) -> KalmanState:
        """One period without measurements; the process noise acts at its beginning."""
        slope, later = self.linearise(filter_state)
        random_walk = self._estimated_numbers(self.process_noise)[0]
        # Variance that keeps the parameters' variance stationary after the decay: (1 - decay^2) / decay^2.
        regained = jnp.expm1(2.0 * self.instruments.period / self.correlation_time)
        exact = jnp.zeros(len(slope) - len(random_walk) - len(self.parameter_deviations))
        thermocouples = len(later.thermocouples)
        noise = jnp.concatenate(
            [
                self.instruments.period * random_walk**2,
                exact[:thermocouples],
                regained * self._parameter_deviations() ** 2,
                exact[thermocouples:],
            ]
        )
        return later._replace(covariance=slope @ (filter_state.covariance + jnp.diag(noise)) @ slope.T)

    def _estimated_numbers(self, state: Any) -> tuple[jax.Array, Any]:
        """The estimated numbers of a plant's state, shape ``(k,)``, and the function that makes a state of them."""
        numbers, rest = eqx.partition(state, self.system.estimated_leaves(state))
        flat, unflatten = ravel_pytree(numbers)
        return flat, lambda flat: eqx.combine(unflatten(flat), rest)

    def _core(self, filter_state: KalmanState) -> tuple[jax.Array, Any]:
        """All estimated numbers but the readings, and the function that splits them again."""
        numbers, to_state = self._estimated_numbers(filter_state.state)
        flat, unflatten = ravel_pytree((numbers, filter_state.thermocouples, filter_state.parameters))

        def split(flat: jax.Array) -> tuple[Any, dict[str, jax.Array], jax.Array]:
            numbers, thermocouples, values = unflatten(flat)
            return to_state(numbers), thermocouples, values

        return flat, split

    def _exact_readings(self, channels: dict[str, jax.Array], thermocouples: dict[str, jax.Array]) -> jax.Array:
        """Readings of the instruments without noise, shape ``(instruments,)``."""
        return jnp.stack([thermocouples.get(n, channels[n]) for n in self._channels])

    @property
    def _channels(self) -> list[str]:
        """The channels that have an instrument."""
        channels = jax.eval_shape(lambda: self.system.observe(self.system.start(), jnp.zeros(self.system.wires)))
        return sorted(n for n in channels if channel_of(n) in self.instruments.sensors)

    @property
    def _reading_rows(self) -> int:
        return 1 + max(sensor.delay for sensor in self.instruments.sensors.values())

    @property
    def _parameter_names(self) -> list[str]:
        return sorted(self.parameter_deviations)  # the order in which a compiled function sees a dictionary

    def _nominal_parameters(self) -> jax.Array:
        plant = self.system.plant if isinstance(self.system, SampledPlant) else None
        return jnp.asarray([parameters.get(plant, n) for n in self._parameter_names], jnp.float64)

    def _parameter_deviations(self) -> jax.Array:
        return jnp.asarray([self.parameter_deviations[n] for n in self._parameter_names], jnp.float64)

    def _with_parameters(self, values: jax.Array) -> AbstractSampledSystem:
        return self.system.with_parameters({n: values[i] for i, n in enumerate(self._parameter_names)})

    def _clipped(self, state: Any, values: jax.Array) -> tuple[Any, jax.Array]:
        """The mean where the equations hold: fractions between 0 and 1, parameters within their bounds."""
        if not isinstance(self.system, SampledPlant):
            return state, values
        declared = [parameters.declaration(self.system.plant, n) for n in self._parameter_names]
        detwinned = clip(state[0].fractions.detwinned, 0.0, 1.0)
        fractions = Fractions(detwinned, clip(state[0].fractions.twinned, 0.0, 1.0 - detwinned))
        lower, upper = (jnp.asarray([getattr(d, side) for d in declared], jnp.float64) for side in ("lower", "upper"))
        return (state[0]._replace(fractions=fractions), state[1]), clip(values, lower, upper)
