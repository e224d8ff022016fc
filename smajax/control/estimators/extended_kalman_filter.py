"""Extended Kalman filter on the plant: the state of a rig, and unknown parameters, from what its instruments measure.

One plant with the mean state x is simulated under the same commands as the rig, with a covariance P of the error of x.

Prediction over a period, with F by forward-mode differentiation through the plant's steps at their solutions:

    x- = f(x, command)     P- = F (P + Q) F^T     F = df/dx

Correction by each measurement y = h^T x + v with variance r of v, one after another, since their noises are
independent. Joseph's form keeps P symmetric and positive semidefinite in spite of rounding:

    K = P- h / (h^T P- h + r)     x = x- + K (y - h^T x-)     P = (1 - K h^T) P- (1 - K h^T)^T + r K K^T

Where the innovation y - h^T x- exceeds ``huber_threshold`` standard deviations, r is increased (Huber's weight), so
that no single measurement moves x to another branch of the hysteresis. Quantisation counts as noise with variance
quantum^2 / 12.

The vector x contains the plant's integrator state (temperatures, fractions, stresses, unknowns and motion of the
mechanism), the temperatures of the thermocouples, the unknown parameters, and the exact readings of the instruments at
this sample and at earlier ones, back to the longest delay. A delayed measurement thus corrects the present state by its
covariance with the earlier reading, and h is a unit vector.

The memories of effects (the points at which a branch began, the presliding state of friction, durations) are states of
the mean that are not in P. They are reset at a reversal, so that their derivative jumps between 0 and 1 with the branch
of the mean, and a correction could set such a point to a value that no history reaches. The phase fractions need no
such points (see ``smajax.plant.materials.brinson``) and are in P. The mean is on one branch of the hysteresis: that the
wire may be on another one is represented only by the process noise of the fraction. ``EnsembleKalmanFilter`` has
members on both branches, at the cost of as many simulations as members.

Source: kalman1960; bucy1968 (Joseph's form); huber1964 (weight of outliers).
"""

from collections.abc import Mapping
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

from smajax import parameters
from smajax.channels import channel_of
from smajax.control.estimators.base import AbstractFilter, Estimate, check_uniform_wire
from smajax.control.sampled_plant import AbstractSampledSystem, SampledPlant
from smajax.control.sampling_period import check_same_period
from smajax.control.sensors.instruments import Instruments, thermocouple_reading
from smajax.numerics.nonsmooth import clip, maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import Fractions

# Defaults, chosen by trial; tests/unit/control/test_extended_kalman_filter.py holds that the intervals have their
# coverage with them.
# Correlation time of the unknown parameters, s.
_CORRELATION_TIME = 30.0
# Innovation in standard deviations beyond which a measurement counts as noisier.
_HUBER_THRESHOLD = 1.0
# Standard deviation of the random walk of the temperatures in one second, K.
_TEMPERATURE_PROCESS_NOISE = 2.0
# Standard deviation of the random walk of the detwinned fractions in one second.
_FRACTION_PROCESS_NOISE = 0.1


class KalmanState(NamedTuple):
    """State of the filter.

    Attributes:
        state: Mean of the plant's state.
        thermocouples: Means of the temperatures of the thermocouples by channel, scalars, degC.
        parameters: Means of the unknown parameters, shape ``(p,)``, internal units.
        readings: Means of the exact readings of the instruments, newest first, shape
            ``(longest delay + 1, instruments)``.
        covariance: Covariance of the estimated numbers of these four, in this order, shape ``(n, n)``.
        command: Commands since the last sample, shape ``(wires,)``.
    """

    state: Any
    thermocouples: dict[str, jax.Array]
    parameters: jax.Array
    readings: jax.Array
    covariance: jax.Array
    command: jax.Array


class ExtendedKalmanFilter(AbstractFilter):
    """Extended Kalman filter on the plant; all numbers are differentiable leaves.

    Attributes:
        system: Nominal plant, sampled at the period of the filter.
        instruments: Measurements by kind of channel: noise, quantisation and delay, and the lag of the thermocouples.
        parameter_deviations: Standard deviations of the unknown parameters about those of ``system`` by name.
        initial_deviation: Standard deviations of the plant's state at the start, in the structure of that state.
        process_noise: Standard deviations of the random walk of the plant's state in one second, in the structure of
            that state, in its units per root second.
        correlation_time: Correlation time of the unknown parameters, s.
        huber_threshold: Innovation in standard deviations beyond which a measurement counts as noisier.
    """

    system: AbstractSampledSystem
    instruments: Instruments
    parameter_deviations: dict[str, jax.Array]
    initial_deviation: Any
    process_noise: Any
    correlation_time: jax.Array = parameter(
        "s", "correlation time of the unknown parameters", 0.0, default=_CORRELATION_TIME
    )
    huber_threshold: jax.Array = parameter(
        "1",
        "innovation in standard deviations beyond which a measurement counts as noisier",
        0.0,
        default=_HUBER_THRESHOLD,
    )

    def __check_init__(self) -> None:
        check_uniform_wire(self.system)
        check_same_period("plant of the filter", self.system.period, "instruments", self.instruments.period)

    @property
    def period(self) -> float:
        """Period of the samples, s: that of the plant."""
        return self.system.period

    @classmethod
    def of(
        cls,
        system: SampledPlant,
        instruments: Instruments,
        parameter_deviations: Mapping[str, Any],
        *,
        initial_temperature_deviation: Any = 0.0,
        temperature_process_noise: Any = _TEMPERATURE_PROCESS_NOISE,
        fraction_process_noise: Any = _FRACTION_PROCESS_NOISE,
    ) -> "ExtendedKalmanFilter":
        """Build the filter from standard deviations of temperatures, fractions and parameters.

        Both process noises represent the other branches of the hysteresis. With the defaults the intervals have their
        coverage for wires whose convection and ambient temperature differ from the plant's; without a process noise of
        the fraction the filter is overconfident and diverges (``tests/unit/control/test_extended_kalman_filter.py``
        has both).

        Args:
            system: The nominal plant.
            instruments: Sensors of the measured channels.
            parameter_deviations: Standard deviations of the unknown parameters by name, scalars in internal units.
            initial_temperature_deviation: Standard deviation of the temperatures at the start, K, in addition to that
                of the surroundings; a scalar, or shape ``(wires,)``.
            temperature_process_noise: Standard deviation of the random walk of the temperatures in one second, K; a
                scalar, or shape ``(wires,)``.
            fraction_process_noise: Standard deviation of the random walk of the detwinned fractions in one second; a
                scalar, or shape ``(wires,)``.
        """
        zeros, time = jax.tree.map(jnp.zeros_like, system.start())

        def wires(value: Any) -> Float[Array, " wires"]:
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

        def initial_numbers(
            error: Float[Array, " k"], values: Float[Array, " p"]
        ) -> tuple[Float[Array, " n"], KalmanState]:
            """Return the estimated numbers and the state at rest, for errors of the state and parameter values."""
            system = self._with_parameters(values)
            numbers, to_state = self._estimated_numbers(system.start())
            state = to_state(numbers + error)
            channels = system.observe(state, no_command)
            thermocouples = {n: channels[n] for n in self._channels if channel_of(n) == "temperature"}
            row = self._exact_readings(channels, thermocouples)
            readings = jnp.broadcast_to(row, (self._reading_rows, len(self._channels)))
            first = KalmanState(state, thermocouples, values, readings, jnp.zeros(()), no_command)
            return jnp.concatenate([self._core(first)[0], jnp.ravel(readings)]), first

        jacobians, first = jax.jacfwd(initial_numbers, argnums=(0, 1), has_aux=True)(
            jnp.zeros_like(deviations), nominal
        )
        root = jnp.concatenate(jacobians, axis=1) * jnp.concatenate([deviations, self._parameter_deviations()])[None]
        return first._replace(covariance=root @ root.T)

    def step(self, filter_state: KalmanState, measured: Mapping[str, Float[Array, ""]]) -> KalmanState:
        """Predict over one period under the last commands, then correct by the measurements.

        Args:
            filter_state: State after the previous sample.
            measured: Channels of the instruments at this sample by name; NaN: not measured.

        Returns:
            The state at this sample.
        """
        predicted = self._predict(filter_state)
        core, split = self._core(predicted)
        mean, covariance = jnp.concatenate([core, jnp.ravel(predicted.readings)]), predicted.covariance
        for k, name in enumerate(self._channels):
            sensor = self.instruments.sensors[str(channel_of(name))]
            index = len(core) + sensor.delay * len(self._channels) + k
            # A uniform error of one quantum has the variance quantum^2 / 12.
            noise = sensor.noise**2 + sensor.quantum**2 / 12.0
            mean, covariance = self._correct(mean, covariance, index, noise, measured[name])
        state, thermocouples, values = split(mean[: len(core)])
        state, values = self._clip_to_bounds(state, values)
        readings = mean[len(core) :].reshape(predicted.readings.shape)
        return KalmanState(state, thermocouples, values, readings, covariance, predicted.command)

    def _correct(
        self,
        mean: Float[Array, " n"],
        covariance: Float[Array, "n n"],
        index: int,
        noise: Float[Array, ""],
        measured: Float[Array, ""],
    ) -> tuple[Float[Array, " n"], Float[Array, "n n"]]:
        """Correct by a measurement of the number at ``index`` with variance ``noise`` (Joseph, Huber)."""
        variance = covariance[index, index]  # h^T P h
        valid = jnp.isfinite(measured) & (variance + noise > 0.0)
        innovation = jnp.where(valid, measured, mean[index]) - mean[index]
        total_variance = jnp.where(valid, variance + noise, 1.0)  # h^T P h + r
        deviations = jnp.abs(innovation) / (self.huber_threshold * jnp.sqrt(total_variance))
        total_variance = total_variance * maximum(deviations, 1.0)
        gain = jnp.where(valid, covariance[index] / total_variance, 0.0)
        mean = mean + gain * innovation
        reduced = covariance - jnp.outer(gain, covariance[index])  # (1 - K h^T) P
        increased_noise = total_variance - variance
        covariance = reduced - jnp.outer(reduced[:, index], gain) + increased_noise * jnp.outer(gain, gain)
        return mean, 0.5 * (covariance + covariance.T)

    def estimate(self, filter_state: KalmanState) -> Estimate:
        """Return means and standard deviations of all channels and of the martensite fractions at a sample."""
        core, split = self._core(filter_state)

        def channels_and_fractions(core: Float[Array, " core"]) -> tuple[Float[Array, " numbers"], tuple[Any, ...]]:
            state, _, values = split(core)
            martensite = state[0].fractions.martensite if isinstance(self.system, SampledPlant) else jnp.zeros(0)
            both = self._with_parameters(values).observe(state, filter_state.command), martensite
            return ravel_pytree(both)[0], both

        jacobian, (mean, martensite) = jax.jacfwd(channels_and_fractions, has_aux=True)(core)
        variance = jnp.sum((jacobian @ filter_state.covariance[: len(core), : len(core)]) * jacobian, axis=1)
        positive = variance > 0.0
        deviations = jnp.where(positive, jnp.sqrt(jnp.where(positive, variance, 1.0)), 0.0)
        mean_deviation, martensite_deviation = ravel_pytree((mean, martensite))[1](deviations)
        return Estimate(mean, mean_deviation, martensite, martensite_deviation)

    def init(self, measured: dict[str, Float[Array, ""]]) -> KalmanState:
        """Return the state at rest; the first measurements are not used."""
        return self.reset()

    def update(
        self, state: KalmanState, measured: dict[str, Float[Array, ""]]
    ) -> tuple[KalmanState, Float[Array, " wires"]]:
        """Predict and correct; return the state and the mean temperatures of the wires in degC."""
        filter_state = self.step(state, measured)
        return filter_state, filter_state.state[0].temperature

    def apply_command(self, state: KalmanState, command: Float[Array, " wires"]) -> KalmanState:
        """Return the state with the commands until the next sample."""
        return state._replace(command=command)

    def estimated_channel(self, state: KalmanState, channel: str) -> Float[Array, ""]:
        """Return a channel of the plant in its mean state."""
        return self._with_parameters(state.parameters).observe(state.state, state.command)[channel]

    def linearise(self, filter_state: KalmanState) -> tuple[Float[Array, "n n"], KalmanState]:
        """Linearise the prediction over one period about the mean.

        Returns:
            The Jacobian F of all estimated numbers after the period by those before it, and the state with the means
            after the period.
        """
        decay, nominal = jnp.exp(-self.instruments.period / self.correlation_time), self._nominal_parameters()
        core, split = self._core(filter_state)

        def after_period(core: Float[Array, " core"]) -> tuple[Float[Array, " numbers"], KalmanState]:
            """Return the estimated numbers and the state after the period."""
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

        # The steps are solved once, at the mean; ``twice_differentiable_step`` differentiates their solutions.
        system, state, command = jax.lax.stop_gradient(
            (
                self._with_parameters(nominal + decay * (filter_state.parameters - nominal)),
                filter_state.state,
                filter_state.command,
            )
        )
        _, step_solutions, _ = system.step(state, command)
        core_jacobian, later = jax.jacfwd(after_period, has_aux=True)(core)
        n, rows, size = len(core), len(core_jacobian), len(filter_state.covariance)
        # The stored readings move by one row; the oldest row is dropped.
        jacobian = jnp.zeros((size, size)).at[:rows, :n].set(core_jacobian)
        return jacobian.at[rows:, n : size - len(self._channels)].set(jnp.eye(size - rows)), later

    def _predict(self, filter_state: KalmanState) -> KalmanState:
        """Prediction over one period; the process noise acts at its beginning."""
        jacobian, later = self.linearise(filter_state)
        random_walk = self._estimated_numbers(self.process_noise)[0]
        # Relative noise that keeps the variance of the parameters stationary after the decay: (1 - decay^2) / decay^2.
        relative_noise = jnp.expm1(2.0 * self.instruments.period / self.correlation_time)
        no_noise = jnp.zeros(len(jacobian) - len(random_walk) - len(self.parameter_deviations))
        thermocouples = len(later.thermocouples)
        noise = jnp.concatenate(
            [
                self.instruments.period * random_walk**2,
                no_noise[:thermocouples],
                relative_noise * self._parameter_deviations() ** 2,
                no_noise[thermocouples:],
            ]
        )
        return later._replace(covariance=jacobian @ (filter_state.covariance + jnp.diag(noise)) @ jacobian.T)

    def _estimated_numbers(self, state: Any) -> tuple[Float[Array, " k"], Any]:
        """The estimated numbers of a plant's state, and the function that builds a state from them."""
        numbers, rest = eqx.partition(state, self.system.estimated_leaves(state))
        flat, unflatten = ravel_pytree(numbers)
        return flat, lambda flat: eqx.combine(unflatten(flat), rest)

    def _core(self, filter_state: KalmanState) -> tuple[Float[Array, " core"], Any]:
        """All estimated numbers except the readings, and the function that splits them again."""
        numbers, to_state = self._estimated_numbers(filter_state.state)
        flat, unflatten = ravel_pytree((numbers, filter_state.thermocouples, filter_state.parameters))

        def split(flat: Float[Array, " core"]) -> tuple[Any, dict[str, Float[Array, ""]], Float[Array, " p"]]:
            numbers, thermocouples, values = unflatten(flat)
            return to_state(numbers), thermocouples, values

        return flat, split

    def _exact_readings(
        self, channels: dict[str, Float[Array, ""]], thermocouples: dict[str, Float[Array, ""]]
    ) -> Float[Array, " instruments"]:
        """Readings of the instruments without noise."""
        return jnp.stack([thermocouples.get(n, channels[n]) for n in self._channels])

    @property
    def _channels(self) -> list[str]:
        """The channels that have an instrument."""
        channels = jax.eval_shape(lambda: self.system.observe(self.system.start(), jnp.zeros(self.system.wires)))
        return sorted(n for n in channels if channel_of(n) in self.instruments.sensors)

    @property
    def _reading_rows(self) -> int:
        """Number of samples whose readings are stored."""
        return 1 + max(sensor.delay for sensor in self.instruments.sensors.values())

    @property
    def _parameter_names(self) -> list[str]:
        return sorted(self.parameter_deviations)  # the order in which a compiled function sees a dictionary

    def _nominal_parameters(self) -> Float[Array, " p"]:
        plant = self.system.plant if isinstance(self.system, SampledPlant) else None
        return jnp.asarray([parameters.get(plant, n) for n in self._parameter_names], jnp.float64)

    def _parameter_deviations(self) -> Float[Array, " p"]:
        return jnp.asarray([self.parameter_deviations[n] for n in self._parameter_names], jnp.float64)

    def _with_parameters(self, values: Float[Array, " p"]) -> AbstractSampledSystem:
        return self.system.with_parameters({n: values[i] for i, n in enumerate(self._parameter_names)})

    def _clip_to_bounds(self, state: Any, values: Float[Array, " p"]) -> tuple[Any, Float[Array, " p"]]:
        """The mean with fractions between 0 and 1 and parameters within their bounds, where the equations hold."""
        if not isinstance(self.system, SampledPlant):
            return state, values
        declared = [parameters.declaration(self.system.plant, n) for n in self._parameter_names]
        detwinned = clip(state[0].fractions.detwinned, 0.0, 1.0)
        fractions = Fractions(detwinned, clip(state[0].fractions.twinned, 0.0, 1.0 - detwinned))
        lower, upper = (jnp.asarray([getattr(d, side) for d in declared], jnp.float64) for side in ("lower", "upper"))
        return (state[0]._replace(fractions=fractions), state[1]), clip(values, lower, upper)
