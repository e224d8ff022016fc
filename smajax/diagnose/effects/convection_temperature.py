"""Natural convection that grows with the temperature difference."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class ConvectionTemperature(HeatEffect):
    """h (1 + s (T - T_ambient) / 50 K)."""

    strength: jax.Array = parameter("1", "relative rise of h per 50 K above ambient", -0.4, 1.0, 0.0)
    key = "convection-temperature"
    typical = 0.11
    source = "Churchill and Chu's correlation for thin wires: 0.10 to 0.12 per 50 K"
    confused_with = ("radiation", "current-limit")

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        over = now.temperature - where.environment.ambient
        return -self.strength * where.heat.conductance(now.temperature, where.wire) * over * over / 50.0
