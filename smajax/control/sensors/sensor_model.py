"""Sensor of one channel: noise, quantisation and delay."""

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float


def quantise(value: jax.Array, quantum: jax.Array) -> jax.Array:
    """Round to whole multiples of ``quantum`` (0: no rounding).

    The derivative is 1, as without quantisation: the true one is 0 almost everywhere and says nothing about a loop.
    """
    safe = jnp.where(quantum > 0.0, quantum, 1.0)
    rounded = jnp.where(quantum > 0.0, safe * jnp.round(value / safe), value)
    return value + jax.lax.stop_gradient(rounded - value)


class SensorModel(eqx.Module):
    """Sensor with white ``noise`` (standard deviation) and ``quantum`` (0: none), in the channel's unit, and ``delay``.

    The delay is a number of samples.
    """

    noise: jax.Array
    quantum: jax.Array
    delay: int = eqx.field(static=True, default=0)

    def reset(self, value: jax.Array) -> Float[Array, " delay"]:
        """Return the state of a channel at rest: the delayed values, oldest first."""
        return jnp.full(self.delay, value)

    def step(self, state: jax.Array, value: jax.Array, draw: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Take one sample.

        Args:
            state: Delayed values, oldest first, shape ``(delay,)``.
            value: True value, a scalar.
            draw: Standard normal number of this sample, a scalar.

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
