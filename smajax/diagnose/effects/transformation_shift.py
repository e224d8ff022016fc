"""Transformation temperatures that move with every cycle."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class TransformationShift(MaterialEffect):
    """All four transformation temperatures + s N, N being the cycles of transformation so far."""

    strength: jax.Array = parameter("K", "shift of the transformation temperatures per full cycle", -4.0, 4.0, 0.0)
    key = "transformation-shift"
    typical = 0.3
    source = "estimate: start temperatures move with accumulated transformation"
    confused_with = ("ambient-drift",)

    def shift(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * 0.5 * now.travel
