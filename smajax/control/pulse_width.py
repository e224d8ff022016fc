"""Pulse-width modulation of a duty cycle."""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import minimum


def on_fraction(
    duty: Float[Array, "*wires"], start: Float[Array, ""], step: Float[Array, ""], carrier: float
) -> Float[Array, "*wires"]:
    """Return the fraction of a time step during which a pulse-width modulator is switched on.

    Each period of the carrier begins switched on. Within a step the switch is averaged; steps shorter than a period
    resolve it.

    Args:
        duty: Duty cycle, 0 to 1.
        start: Beginning of the step, s.
        step: Length of the step, s.
        carrier: Frequency of the carrier, Hz.
    """

    def time_switched_on(time: jax.Array) -> jax.Array:
        periods = time * carrier
        whole = jnp.floor(periods)
        return (whole * duty + minimum(periods - whole, duty)) / carrier

    return (time_switched_on(start + step) - time_switched_on(start)) / step
