"""Pulse-width modulation of a duty cycle."""

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import minimum


def on_fraction(
    duty: Float[Array, "*wires"], start: Float[Array, ""], step: Float[Array, ""], carrier: float
) -> Float[Array, "*wires"]:
    """Return the fraction of a time step during which a pulse-width modulator is switched on.

    Each period of the carrier begins switched on. The result is the average over the step; only steps shorter than a
    period resolve the pulses.

    Args:
        duty: Duty cycle of each wire, 0 to 1.
        start: Beginning of the step, s.
        step: Length of the step, s.
        carrier: Frequency of the carrier, Hz.

    Returns:
        The fraction of each wire, 0 to 1, of the shape of ``duty``.
    """

    def time_switched_on(time: Float[Array, ""]) -> Float[Array, "*wires"]:
        periods = time * carrier
        whole = jnp.floor(periods)
        return (whole * duty + minimum(periods - whole, duty)) / carrier

    return (time_switched_on(start + step) - time_switched_on(start)) / step
