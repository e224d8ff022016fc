"""Closed loop: sensor, estimator, temperature limiter, controller and allocation, sampled once a period."""

import dataclasses
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController, require_controller
from smajax.control.controllers.step_check import check_step
from smajax.control.estimators.base import AbstractFilter, AbstractTemperatureEstimator, per_wire
from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.dropouts import step_with_dropouts
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampling_period import check_same_period
from smajax.control.sensors.base import AbstractSensor
from smajax.control.sensors.dropout_hold import DropoutHold
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import ideal_sensor
from smajax.errors import InputError, suggestion
from smajax.numerics.nonsmooth import maximum, minimum
from smajax.parameters.checks import is_concrete


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


def _ends(limits: Any) -> tuple[jax.Array, jax.Array]:
    """The smallest and the largest command."""
    try:
        lower, upper = (jnp.asarray(end, jnp.float64) for end in limits)
    except (TypeError, ValueError):
        raise InputError(f"limits = {limits!r}: give two numbers, the smallest and the largest command") from None
    return lower, upper


class ClosedLoop(eqx.Module):
    """Everything between the reference and the wires.

    The largest allowed commands of the temperature limiter are limits of the controller at that sample, so that its
    integral does not wind up. With ``allow_dropouts`` the controlled channel may be NaN, as on a rig (in a simulation
    it never is), and is held at its last value; after ``DROPOUT_TIMEOUT`` the command is 0, or the smallest one, until
    the controller is reset at the next finite value.

    The period is that of the controller; all other parts have to have the same.

    Attributes:
        controller: Controller of the channel.
        allocation: Allocation of its command to the wires; ``None``: a single wire gets it unchanged.
        sensor: Sensor of the controlled channel; by default an exact one.
        temperature_limiter: Limiter of each wire's command by its temperature.
        estimator: Estimator of the temperatures that the limiter gets; ``None``: they are measured.
        instruments: Sensors of the channels that limiter and estimator get; ``None``: those channels are exact.
        channel: Name of the controlled channel.
        use_estimate: Whether the controller gets the estimate of the channel by ``estimator``, a filter of the whole
            plant, instead of the value of ``sensor``.
        allow_dropouts: Whether the controlled channel may be NaN.
    """

    controller: AbstractController
    allocation: Allocation | None
    sensor: AbstractSensor
    temperature_limiter: TemperatureLimiter | None
    estimator: AbstractTemperatureEstimator | None
    instruments: Instruments | None
    channel: str = eqx.field(static=True)
    use_estimate: bool = eqx.field(static=True)
    allow_dropouts: bool = eqx.field(static=True)

    def __init__(
        self,
        controller: AbstractController,
        allocation: Allocation | None = None,
        sensor: AbstractSensor | None = None,
        temperature_limiter: TemperatureLimiter | None = None,
        estimator: AbstractTemperatureEstimator | None = None,
        instruments: Instruments | None = None,
        *,
        channel: str,
        limits: tuple[Any, Any] | None = None,
        use_estimate: bool = False,
        allow_dropouts: bool = False,
    ) -> None:
        """Build a loop.

        Args:
            controller: Controller of the channel.
            allocation: Allocation of its command to the wires; a rollout of two wires makes one from the limits.
            sensor: Sensor of the controlled channel; by default an exact one.
            temperature_limiter: Limiter of each wire's command by its temperature.
            estimator: Estimator of the temperatures that the limiter gets.
            instruments: Sensors of the channels that limiter and estimator get.
            channel: Name of the controlled channel.
            limits: Smallest and largest command, in the unit of the drive, instead of those of the controller.
            use_estimate: Whether the controller gets the estimate of the channel by ``estimator``.
            allow_dropouts: Whether the controlled channel may be NaN.

        Raises:
            InputError: if ``controller`` is not one, or does not return what it should; if the parts have different
                periods; if the limits are not in order; or if ``use_estimate`` is set without a filter of the whole
                plant, or with ``allow_dropouts``.
        """
        require_controller(controller)
        check_step(controller)
        if limits is not None:
            lower, upper = _ends(limits)
            if is_concrete(lower) and is_concrete(upper) and lower >= upper:
                raise InputError(f"limits = ({lower:g}, {upper:g}): the first command has to be below the second")
            controller = controller.with_limits(lower, upper)
        self.controller = controller
        self.allocation = allocation
        self.sensor = ideal_sensor() if sensor is None else sensor
        self.temperature_limiter = temperature_limiter
        self.estimator = estimator
        self.instruments = instruments
        self.channel = channel
        self.use_estimate = use_estimate
        self.allow_dropouts = allow_dropouts

    def __check_init__(self) -> None:
        if self.use_estimate and not isinstance(self.estimator, AbstractFilter):
            raise InputError("a loop with use_estimate needs a filter of the whole plant as its estimator")
        if self.use_estimate and self.allow_dropouts:
            raise InputError("a filter skips a measurement that is NaN: leave allow_dropouts out with use_estimate")
        limiter = self.temperature_limiter
        periods = {
            "sensor": self.sensor.sampling_period,
            "temperature limiter": None if limiter is None else limiter.pid.period,
            "estimator": None if self.estimator is None else self.estimator.period,
            "instruments": None if self.instruments is None else self.instruments.period,
        }
        for name, period in periods.items():
            if period is not None:
                check_same_period(name, period, "controller", self.period)
        if limiter is not None and isinstance(self.estimator, ThermalObserver):
            self.estimator.check_stability(limiter.limit)

    @property
    def period(self) -> float:
        """Period of the samples, s: that of the controller."""
        return self.controller.period

    @property
    def wires(self) -> int:
        """Number of wires that get a command."""
        return 1 if self.allocation is None else self.allocation.wires

    @property
    def max_commands(self) -> Float[Array, " wires"]:
        """Largest command of each wire."""
        return self.controller.upper[None] if self.allocation is None else self.allocation.max_commands

    def for_wires(self, wires: int) -> "ClosedLoop":
        """Return the loop for a plant of so many wires; two wires get an allocation if there is none.

        Args:
            wires: Number of wires of the plant.

        Raises:
            InputError: if the loop is for another number of wires, or its commands never heat one of two wires.
        """
        loop = self
        if self.allocation is None and wires == 2:
            lower, upper = self.controller.limits
            loop = dataclasses.replace(self, allocation=Allocation(upper, jnp.zeros(()), wires, -lower))
        if loop.wires != wires:
            raise InputError(
                f"the plant has {wires} wires, and the loop is for {self.wires}: give an Allocation with wires={wires}"
            )
        if wires == 2:
            loop._check_that_both_wires_are_heated()
        return loop

    def _check_that_both_wires_are_heated(self) -> None:
        """Raise an error for limits with which one of two wires never gets a command; traced ones are not checked."""
        lower, upper = self.controller.limits
        co_contraction = 0.0 if self.allocation is None else self.allocation.co_contraction
        if not all(map(is_concrete, (lower, upper, co_contraction))) or co_contraction > 0.0:
            return
        if not lower < 0.0 < upper:
            raise InputError(
                f"the commands for two wires are limited to {lower:g} to {upper:g}, and a command above 0 heats the "
                "first wire, one below 0 the second: give a lower limit below 0 and an upper limit above 0"
            )

    def allocate(self, command: Float[Array, ""]) -> Float[Array, " wires"]:
        """Return the commands of the wires.

        Args:
            command: Command of the controller.
        """
        return command[None] if self.allocation is None else self.allocation(command)

    def controlled_value(self, channels: dict[str, Float[Array, ""]]) -> Float[Array, ""]:
        """Return the value of the controlled channel.

        Args:
            channels: The plant's channels by name.

        Raises:
            InputError: if there is no channel of that name; it suggests the most similar one.
        """
        if self.channel not in channels:
            raise InputError(
                f"the plant has no channel '{self.channel}'{suggestion(self.channel, channels)}: "
                f"its channels are {', '.join(channels)}"
            )
        return channels[self.channel]

    def reset(self, reference: Float[Array, ""], channels: dict[str, Float[Array, ""]]) -> LoopState:
        """Return the state of a loop whose reference and channels have been constant.

        Args:
            reference: Reference so far, in the channel's unit.
            channels: The plant's channels by name.

        Raises:
            InputError: if the controlled channel is not one of them.
        """
        value = self.controlled_value(channels)
        limiters = (
            ()
            if self.temperature_limiter is None
            else tuple(self.temperature_limiter.reset(t) for t in per_wire(channels, "temperature"))
        )
        estimator = () if self.estimator is None else self.estimator.init(channels)
        instruments = () if self.instruments is None else self.instruments.reset(channels)
        hold = DropoutHold.init(value) if self.allow_dropouts else None
        value = value if hold is None else hold.value
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
        hold = None if last_hold is None else last_hold.update(channels[self.channel], self.period)
        if hold is not None:
            channels = channels | {self.channel: hold.value}
        measurement = self.measure(measurement_states, channels, draw)
        controller, limiters, max_commands = self.apply_temperature_limits(limiters, measurement.temperatures)
        if last_hold is None or hold is None:
            controller_state, command = controller.step(controller_state, reference, measurement.value)
        else:
            timed_out = (last_hold.timed_out, hold.timed_out)
            controller_state, command = step_with_dropouts(
                controller, controller_state, timed_out, reference, measurement.value
            )
        commands = self.allocate(command)
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
            return self.controller, limiters, jnp.full(self.wires, jnp.inf)
        steps = [
            self.temperature_limiter.step(state, temperature, command)
            for state, temperature, command in zip(limiters, temperatures, self.max_commands, strict=True)
        ]
        states, max_commands = tuple(state for state, _ in steps), jnp.stack([command for _, command in steps])
        return self.controller.with_limits(*self.command_limits(max_commands)), states, max_commands

    def command_limits(self, max_commands: Float[Array, " wires"]) -> tuple[Float[Array, ""], Float[Array, ""]]:
        """Return the smallest and the largest command of the controller that the wires can follow.

        Args:
            max_commands: Largest allowed command of each wire at this sample.
        """
        lowest, largest = jnp.asarray(-jnp.inf), max_commands[0]
        if self.allocation is not None:
            lowest, largest = self.allocation.command_limits(max_commands)
        upper = minimum(self.controller.upper, largest)
        return minimum(maximum(self.controller.lower, lowest), upper), upper
