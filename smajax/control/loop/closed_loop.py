"""Closed loop: sensor, estimator, temperature limiter, controller and allocation, sampled once a period."""

from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController
from smajax.control.estimators.base import AbstractFilter, AbstractTemperatureEstimator, per_wire
from smajax.control.estimators.imu_sensor import ImuSensor
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sensors.dropout_hold import DropoutHold
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.numerics.nonsmooth import clip, maximum, minimum


class Measurement(NamedTuple):
    """Measurements of a loop at a sample.

    Attributes:
        value: Measured value of the controlled channel, a scalar.
        temperatures: Measured or estimated temperatures of the wires, degC, shape ``(wires,)``; ``None`` without a
            limiter and an estimator.
        states: States of sensor, estimator and instruments after this sample.
    """

    value: jax.Array
    temperatures: jax.Array | None
    states: Any


class LoopState(NamedTuple):
    """State of a closed loop.

    Attributes:
        controller: State of the controller.
        measurement: States of sensor, estimator and instruments.
        limiters: State of the temperature limiter of each wire.
        hold: Hold of the controlled channel, if dropouts are allowed.
    """

    controller: Any
    measurement: Any
    limiters: Any
    hold: DropoutHold | None


class ClosedLoop(eqx.Module):
    """Everything between the reference and the wires.

    The largest allowed commands of the temperature limiter are limits of the controller at that sample, so that its
    integral does not wind up. With ``allow_dropouts`` the controlled channel may be NaN, as on a rig (in a simulation
    it never is), and is held at its last value; after ``DROPOUT_TIMEOUT`` the command is 0, or the smallest one, until
    the controller is reset at the next finite value.

    Attributes:
        controller: Controller of the channel.
        allocation: Allocation of its command to the wires.
        sensor: Sensor of the controlled channel.
        temperature_limiter: Limiter of each wire's command by its temperature.
        estimator: Estimator of the temperatures that the limiter gets; ``None``: they are measured.
        instruments: Sensors of the channels that limiter and estimator get; ``None``: those channels are exact.
        channel: Name of the controlled channel.
        use_estimate: Whether the controller gets the estimate of the channel by ``estimator``, a filter of the whole
            plant, instead of the value of ``sensor``.
        allow_dropouts: Whether the controlled channel may be NaN.

    Raises:
        ValueError: if ``use_estimate`` is set without a filter of the whole plant, or with ``allow_dropouts``.
    """

    controller: AbstractController
    allocation: Allocation
    sensor: SensorModel | ImuSensor
    temperature_limiter: TemperatureLimiter | None = None
    estimator: AbstractTemperatureEstimator | None = None
    instruments: Instruments | None = None
    channel: str = eqx.field(static=True, kw_only=True)
    use_estimate: bool = eqx.field(static=True, kw_only=True, default=False)
    allow_dropouts: bool = eqx.field(static=True, kw_only=True, default=False)

    def __check_init__(self) -> None:
        if self.use_estimate and not isinstance(self.estimator, AbstractFilter):
            raise ValueError("a loop with use_estimate needs a filter of the whole plant as its estimator")
        if self.use_estimate and self.allow_dropouts:
            raise ValueError("a filter skips a measurement that is NaN: leave allow_dropouts out with use_estimate")

    def reset(self, reference: Float[Array, ""], channels: dict[str, Float[Array, ""]]) -> LoopState:
        """Return the state of a loop whose reference and channels have been constant.

        Args:
            reference: Reference so far, in the channel's unit.
            channels: The plant's channels by name.
        """
        limiters = (
            ()
            if self.temperature_limiter is None
            else tuple(self.temperature_limiter.reset(t) for t in per_wire(channels, "temperature"))
        )
        estimator = () if self.estimator is None else self.estimator.init(channels)
        instruments = () if self.instruments is None else self.instruments.reset(channels)
        hold = DropoutHold.init(channels[self.channel]) if self.allow_dropouts else None
        value = channels[self.channel] if hold is None else hold.value
        measurement = (self.sensor.reset(value), estimator, instruments)
        return LoopState(self.controller.reset(reference, value), measurement, limiters, hold)

    def step(
        self,
        state: LoopState,
        reference: Float[Array, ""],
        channels: dict[str, Float[Array, ""]],
        draw: Float[Array, ""],
    ) -> tuple[LoopState, Float[Array, " wires"]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            reference: Reference at this sample, in the channel's unit.
            channels: The plant's channels at this sample by name.
            draw: Standard normal number of this sample, for the noise of sensor and instruments.

        Returns:
            The state after this sample, and the commands of the wires until the next one.
        """
        controller_state, measurement_states, limiters, last_hold = state
        hold = None if last_hold is None else last_hold.update(channels[self.channel], self.controller.inner.period)
        if hold is not None:
            channels = channels | {self.channel: hold.value}
        measurement = self.measure(measurement_states, channels, draw)
        controller, limiters, max_commands = self.apply_temperature_limits(limiters, measurement.temperatures)
        if last_hold is not None:
            controller_state = jax.tree.map(
                lambda a, b: jnp.where(last_hold.timed_out, a, b),
                controller.reset(reference, measurement.value),
                controller_state,
            )
        controller_state, command = controller.step(controller_state, reference, measurement.value)
        if hold is not None:
            no_command = clip(jnp.zeros(()), controller.inner.lower, controller.inner.upper)
            command = jnp.where(hold.timed_out, no_command, command)
        commands = self.allocation(command)
        if self.temperature_limiter is not None:
            commands = minimum(commands, max_commands)
        sensor, estimator, instruments = measurement.states
        if self.estimator is not None:
            estimator = self.estimator.apply_command(estimator, commands)
        return LoopState(controller_state, (sensor, estimator, instruments), limiters, hold), commands

    def measure(self, states: Any, channels: dict[str, Float[Array, ""]], draw: Float[Array, ""]) -> Measurement:
        """Measure the channels at one sample, and update the estimator.

        Args:
            states: States of sensor, estimator and instruments after the previous sample.
            channels: The plant's channels by name.
            draw: Standard normal number of this sample.
        """
        sensor, estimator, instruments = states
        sensor, value = self.sensor.step(sensor, channels[self.channel], draw)
        if self.temperature_limiter is None and self.estimator is None:
            return Measurement(value, None, (sensor, estimator, instruments))
        if self.instruments is not None:
            instruments, channels = self.instruments.step(instruments, channels, draw)
        temperatures = per_wire(channels, "temperature")
        if self.estimator is not None:
            estimator, temperatures = self.estimator.update(estimator, channels)
        if self.use_estimate and isinstance(self.estimator, AbstractFilter):
            value = self.estimator.estimated_channel(estimator, self.channel)
        return Measurement(value, temperatures, (sensor, estimator, instruments))

    def apply_temperature_limits(
        self, limiters: Any, temperatures: Float[Array, " wires"] | None
    ) -> tuple[AbstractController, Any, Float[Array, " wires"]]:
        """Return the controller with the limits that the temperature limiter sets at one sample.

        Args:
            limiters: States of the limiters after the previous sample.
            temperatures: Temperatures of the wires, degC.

        Returns:
            The controller with these limits, the states of the limiters, and the largest allowed command of each wire
            (infinite without a limiter).
        """
        if self.temperature_limiter is None or temperatures is None:
            return self.controller, limiters, jnp.full(self.allocation.wires, jnp.inf)
        steps = [
            self.temperature_limiter.step(state, temperature, command)
            for state, temperature, command in zip(limiters, temperatures, self.allocation.max_commands, strict=True)
        ]
        states, max_commands = tuple(state for state, _ in steps), jnp.stack([command for _, command in steps])
        pid = self.controller.inner
        lowest, largest = self.allocation.command_limits(max_commands)
        upper = minimum(pid.upper, largest)
        return self.controller.with_limits(minimum(maximum(pid.lower, lowest), upper), upper), states, max_commands
