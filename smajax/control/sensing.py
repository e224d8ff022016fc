"""What a controller sees of a channel: noise, quantisation and delay."""

import equinox as eqx
import jax
import jax.numpy as jnp


def quantised(value: jax.Array, quantum: jax.Array) -> jax.Array:
    """A value in whole steps of ``quantum`` (0: as it is).

    A derivative passes as if there were no steps: its own is 0 nearly everywhere, and says nothing about a loop.
    """
    safe = jnp.where(quantum > 0.0, quantum, 1.0)
    rounded = jnp.where(quantum > 0.0, safe * jnp.round(value / safe), value)
    return value + jax.lax.stop_gradient(rounded - value)


class Sensing(eqx.Module):
    """Noise of standard deviation ``noise``, steps of ``quantum`` (0: none), both in the channel's unit, and ``delay`` samples."""

    noise: jax.Array
    quantum: jax.Array
    delay: int = eqx.field(static=True, default=0)

    def reset(self, value: jax.Array) -> jax.Array:
        """The values on their way, oldest first, shape ``(delay,)``, when the channel has been at rest."""
        return jnp.full(self.delay, value)

    def step(self, state: jax.Array, value: jax.Array, draw: jax.Array) -> tuple[jax.Array, jax.Array]:
        """The values on their way after a sample, and what arrives; ``draw`` is a standard normal number."""
        heard = quantised(value + self.noise * draw, self.quantum)
        if not self.delay:
            return state, heard
        return jnp.append(state[1:], heard), state[0]


def perfect() -> Sensing:
    """Sees what is."""
    return Sensing(jnp.zeros(()), jnp.zeros(()))
