"""A heat capacity that differs between the phases."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect


class HeatCapacity(HeatEffect):
    """c (1 + s (1 - xi))."""

    strength: jax.Array = parameter("1", "relative excess of austenite's heat capacity", -0.5, 0.8, 0.0)
    key = "heat-capacity"
    typical = 0.1
    source = "estimate: reported capacities differ by 0 to 15 % between the phases"
    confused_with = ("latent-heat",)

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """See ``HeatEffect``."""
        return self.strength * (1.0 - martensite)
