"""Instruments of a rig: voltage, current and temperature of each wire as measured, with noise, quantisation and delay.

A temperature is measured by a thermocouple, which follows its wire with a first-order lag: T_m' = (T - T_m) / lag. A
measured power has the errors of voltage and current, P V_m I_m / (V I): where these are means over the pulses of a
carrier, the product V_m I_m alone is not the mean power.
"""

import itertools
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.channels import channel_of
from smajax.control.sensors.sensor_model import SensorModel
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter

# s; replaces a lag of 0, by which an instantaneous thermocouple would divide.
_MIN_LAG = 1e-9


class InstrumentState(NamedTuple):
    """State of the instruments by channel name.

    ``delayed`` are the values that are still delayed, ``thermocouples`` the temperatures of the thermocouples in degC,
    ``draws`` the latest standard normal numbers, newest first.
    """

    delayed: dict[str, jax.Array]
    thermocouples: dict[str, jax.Array]
    draws: jax.Array


class Instruments(eqx.Module):
    """Sensors by kind of channel, such as ``voltage``, ``current`` and ``temperature``, one for each wire.

    Channels without a sensor are passed on exactly. ``lag`` in s is that of the thermocouples. The draw of a sample is
    the noise of the first sensor one sample later, of the second one two samples later, and so on: at each sample the
    noises are independent of each other and of the noise of the controller's own sensor.
    """

    sensors: dict[str, SensorModel]
    period: float = eqx.field(static=True)
    lag: jax.Array = parameter("s", "time constant of the thermocouples", 0.0, default=0.0)

    def reset(self, channels: dict[str, jax.Array]) -> InstrumentState:
        """Return the state at rest.

        Args:
            channels: The plant's channels by name, scalars.
        """
        sensors = self._sensors_by_channel(channels)
        delayed = {n: sensor.reset(channels[n]) for n, sensor in sensors.items()}
        thermocouples = {n: channels[n] for n in sensors if channel_of(n) == "temperature"}
        return InstrumentState(delayed, thermocouples, jnp.zeros(len(sensors)))

    def step(
        self, state: InstrumentState, channels: dict[str, jax.Array], draw: jax.Array
    ) -> tuple[InstrumentState, dict[str, jax.Array]]:
        """Take one sample.

        Args:
            state: State after the previous sample.
            channels: The plant's channels by name, scalars.
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

    def _sensors_by_channel(self, channels: dict[str, jax.Array]) -> dict[str, SensorModel]:
        return {
            name: self.sensors[kind]
            for kind, name in itertools.product(sorted(self.sensors), channels)
            if channel_of(name) == kind
        }


def _measured_power(name: str, channels: dict[str, jax.Array], measured: dict[str, jax.Array]) -> jax.Array:
    """Power with the relative errors of voltage and current."""
    voltage, current = (f"{kind}{name.removeprefix('power')}" for kind in ("voltage", "current"))
    exact = channels[voltage] * channels[current]
    flows = exact > 0.0
    return jnp.where(flows, channels[name] / jnp.where(flows, exact, 1.0), 1.0) * measured[voltage] * measured[current]


def thermocouple_reading(reading: jax.Array, temperature: jax.Array, lag: jax.Array, period: float) -> jax.Array:
    """Return the temperature of a thermocouple a period later: the exact step of T_m' = (T - T_m) / lag.

    Args:
        reading: Temperature of the thermocouple at the last sample, degC.
        temperature: Temperature of the wire now, degC, of the same shape.
        lag: Time constant in s, a scalar.
        period: Time since the last sample, s.
    """
    return reading - jnp.expm1(-period / maximum(lag, _MIN_LAG)) * (temperature - reading)
