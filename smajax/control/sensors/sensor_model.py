"""Sensor of one channel: noise, quantisation and delay."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.sensors.base import AbstractSensor


def quantise(value: Float[Array, ""], quantum: Float[Array, ""]) -> Float[Array, ""]:
    """Round a value to a whole multiple of ``quantum``.

    The derivative is 1, as without quantisation: the true one is 0 almost everywhere and useless for tuning.

    Args:
        value: Exact value.
        quantum: Step of the quantisation, in the same unit; 0: none.
    """
    safe = jnp.where(quantum > 0.0, quantum, 1.0)
    rounded = jnp.where(quantum > 0.0, safe * jnp.round(value / safe), value)
    return value + jax.lax.stop_gradient(rounded - value)


class SensorModel(AbstractSensor):
    """Sensor of one channel.

    Attributes:
        noise: Standard deviation of the white noise, a scalar in the channel's unit.
        quantum: Step of the quantisation, a scalar in the channel's unit; 0: none.
        delay: Delay of the measurement, samples.
    """

    noise: jax.Array
    quantum: jax.Array
    delay: int = eqx.field(static=True, default=0)

    def reset(self, value: Float[Array, ""]) -> Float[Array, " delay"]:
        """Return the state of a channel with the constant value ``value``: the delayed values, oldest first."""
        return jnp.full(self.delay, value)

    def step(
        self, state: Float[Array, " delay"], value: Float[Array, ""], draw: Float[Array, ""]
    ) -> tuple[Float[Array, " delay"], Float[Array, ""]]:
        """Take one sample.

        Args:
            state: Delayed values, oldest first.
            value: Exact value, in the channel's unit.
            draw: Standard normal number of this sample.

        Returns:
            The delayed values after this sample, and the measured value.
        """
        measured = quantise(value + self.noise * draw, self.quantum)
        if not self.delay:
            return state, measured
        return jnp.append(state[1:], measured), state[0]


def ideal_sensor() -> SensorModel:
    """Return a sensor without noise, quantisation and delay."""
    return SensorModel(jnp.zeros(()), jnp.zeros(()))
