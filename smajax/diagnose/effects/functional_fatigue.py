"""Transformation strain that is lost with every cycle."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class FunctionalFatigue(MaterialEffect):
    """eps_L (1 - s N), N being the cycles of transformation so far."""

    strength: jax.Array = parameter("1", "share of the transformation strain lost in each full cycle", -0.02, 0.06, 0.0)
    key = "functional-fatigue"
    typical = 0.005
    source = "estimate: 0.1 to 1 % in 100 cycles once trained, far more in the first ones"
    confused_with = ("ratcheting",)

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return -self.strength * 0.5 * now.travel * where.material.strain_of(now.fractions)
