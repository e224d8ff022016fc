"""Heat of transformation."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class LatentHeat(HeatEffect):
    """The austenite holds L more than the martensite: C dT/dt = ... + L dxi/dt."""

    strength: jax.Array = parameter("J/m^3", "latent heat per volume of wire", 0.0, 4e8, 0.0)
    key = "latent-heat"
    typical = 1.5e8
    source = "Flexinol data sheet: 5.78 cal/g at 6450 kg/m^3"
    confused_with = ("coating", "heat-capacity")

    def enthalpy(self, now: Instant, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        return -self.strength * now.fractions.martensite
