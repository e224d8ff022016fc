"""Strain that stays with every cycle."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class Ratcheting(MaterialEffect):
    """eps + s N, N being the cycles of transformation so far."""

    strength: jax.Array = parameter("1", "strain left by each full cycle", -2e-3, 4e-3, 0.0)
    key = "ratcheting"
    typical = 2e-4
    source = "estimate: 1e-5 to 1e-4 per cycle of a young wire, more at high stress"
    confused_with = ("encoder-drift", "creep")

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * 0.5 * now.travel
