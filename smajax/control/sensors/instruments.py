"""Instruments of a rig: voltage, current and temperature of each wire as measured, with noise, quantisation and delay.

A temperature is measured by a thermocouple, which follows its wire with a first-order lag: T_m' = (T - T_m) / lag. A
measured power has the relative errors of voltage and current, P_m = P V_m I_m / (V I). The product V_m I_m is not used:
if V and I are means over the pulses of a carrier, their product is not the mean power.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.channels import channel_of
from smajax.control.sensors.sensor_model import SensorModel
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import CheckedModule, parameter

# Smallest lag, s: it is a divisor, and 0 for an instantaneous thermocouple. With this one, exp(-period / lag) is 0 in
# double precision for every period above 1 us.
_MIN_LAG = 1e-9


class InstrumentState(NamedTuple):
    """State of the instruments.

    Attributes:
        delayed: Measured values that are still delayed, oldest first, by channel, shape ``(delay,)`` each.
        thermocouples: Temperatures of the thermocouples by channel, scalars, degC.
        draws: Latest standard normal numbers, newest first, shape ``(instruments,)``.
    """

    delayed: dict[str, jax.Array]
    thermocouples: dict[str, jax.Array]
    draws: jax.Array


class Instruments(CheckedModule):
    """Sensors of a rig, one for each measured channel and wire; channels without a sensor are exact.

    The draw of a sample is the noise of the first sensor one sample later, of the second one two samples later, and so
    on: at each sample the noises are independent of each other and of the noise of the controller's own sensor.

    Attributes:
        sensors: Sensors by kind of channel, such as ``voltage``, ``current`` and ``temperature``.
        period: Period of the samples, s.
        lag: Time constant of the thermocouples, s.
    """

    sensors: dict[str, SensorModel]
    period: float = eqx.field(static=True)
    lag: jax.Array = parameter("s", "time constant of the thermocouples", 0.0, default=0.0)

    def reset(self, channels: dict[str, Float[Array, ""]]) -> InstrumentState:
        """Return the state for channels that have been constant, given by name."""
        sensors = self._sensors_by_channel(channels)
        delayed = {n: sensor.reset(channels[n]) for n, sensor in sensors.items()}
        thermocouples = {n: channels[n] for n in sensors if channel_of(n) == "temperature"}
        return InstrumentState(delayed, thermocouples, jnp.zeros(len(sensors)))

    def step(
        self, state: InstrumentState, channels: dict[str, Float[Array, ""]], draw: Float[Array, ""]
    ) -> tuple[InstrumentState, dict[str, Float[Array, ""]]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            channels: The plant's exact channels by name.
            draw: Standard normal number of this sample.

        Returns:
            The state after this sample, and the measured channels by name.
        """
        delayed, measured = {}, dict(channels)
        thermocouples = {
            n: thermocouple_reading(reading, channels[n], self.lag, self.period)
            for n, reading in state.thermocouples.items()
        }
        for (name, sensor), noise in zip(self._sensors_by_channel(channels).items(), state.draws, strict=True):
            exact = thermocouples.get(name, channels[name])
            delayed[name], measured[name] = sensor.step(state.delayed[name], exact, noise)
        if self.sensors.keys() & {"voltage", "current"}:
            for name in [n for n in channels if channel_of(n) == "power"]:
                measured[name] = _measured_power(name, channels, measured)
        draws = jnp.append(draw, state.draws)[: len(state.draws)]
        return InstrumentState(delayed, thermocouples, draws), measured

    def _sensors_by_channel(self, channels: dict[str, Float[Array, ""]]) -> dict[str, SensorModel]:
        return {
            name: self.sensors[kind]
            for kind, name in itertools.product(sorted(self.sensors), channels)
            if channel_of(name) == kind
        }


def _measured_power(
    name: str, channels: dict[str, Float[Array, ""]], measured: dict[str, Float[Array, ""]]
) -> Float[Array, ""]:
    """Power with the relative errors of voltage and current."""
    voltage, current = (f"{kind}{name.removeprefix('power')}" for kind in ("voltage", "current"))
    exact = channels[voltage] * channels[current]
    flows = exact > 0.0
    return jnp.where(flows, channels[name] / jnp.where(flows, exact, 1.0), 1.0) * measured[voltage] * measured[current]


def thermocouple_reading(
    reading: Float[Array, "*shape"], temperature: Float[Array, "*shape"], lag: Float[Array, ""], period: float
) -> Float[Array, "*shape"]:
    """Return the temperature of a thermocouple a period later: the exact step of T_m' = (T - T_m) / lag.

    Args:
        reading: Temperature of the thermocouple at the last sample, degC.
        temperature: Temperature of the wire now, degC.
        lag: Time constant, s.
        period: Time since the last sample, s.
    """
    return reading - jnp.expm1(-period / maximum(lag, _MIN_LAG)) * (temperature - reading)
