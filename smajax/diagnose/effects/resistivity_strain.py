"""Resistance that rises as the wire grows longer and thinner."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class ResistivityStrain(MaterialEffect):
    """R (1 + 2 s eps_tr), which is the geometry's share at s = 1: length up, cross-section down."""

    strength: jax.Array = parameter("1", "strain's part in the resistance over that of the geometry", -4.0, 6.0, 0.0)
    key = "resistivity-strain"
    typical = 1.0
    source = "estimate: 4 % of strain make 8 % of resistance"
    confused_with = ("resistivity-temperature",)

    def resistivity(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return 2.0 * self.strength * where.material.strain_of(now.fractions)
