"""Ratcheting: permanent strain that grows with every cycle."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class Ratcheting(MaterialEffect):
    """Permanent strain s ((1 + N)^p - 1) / p after N full transformation cycles.

    With an exponent p of 1 it is s N; with p < 1 it slows down.
    """

    strength: jax.Array = parameter(
        "1", "permanent strain per full cycle; of the first cycle if they decrease", -2e-3, 4e-3, 0.0
    )
    exponent: jax.Array = parameter("1", "power of the number of cycles with which the strain grows", 0.02, 1.5, 1.0)
    key = "ratcheting"
    typical: ClassVar[float] = 2e-4
    source = "estimate: 1e-5 to 1e-4 per cycle of a young wire, more at high stress"
    remedy = "Train the wire until its position after each cycle is steady, and reduce stress and peak temperature."
    confused_with: ClassVar[tuple[str, ...]] = ("encoder-drift", "creep")

    def strain(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return (
            self.strength * jnp.expm1(self.exponent * jnp.log1p(0.5 * state.accumulated_transformation)) / self.exponent
        )
