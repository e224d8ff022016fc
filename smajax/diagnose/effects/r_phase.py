"""The R-phase: a small strain and a hump of resistivity before the martensite."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where

_SLOPE = 15e6  # Pa/K
_WIDTH = 4.0  # K
_HUMP = 0.15  # of resistivity, for a strain of 1 %


class RPhase(MaterialEffect):
    """Strain s and a hump of resistivity where austenite is colder than the R-phase's start temperature."""

    strength: jax.Array = parameter("1", "strain of the R-phase", 0.0, 0.015, 0.0)
    above: jax.Array = parameter("K", "R-phase start above the martensite start temperature", -20.0, 60.0, 12.0)
    key = "r-phase"
    typical = 0.006
    source = "estimate: 0.5 to 1 % of strain, 10 to 20 % of resistance"
    confused_with = ("resistivity-temperature", "slack")
    shapes = (("above", (8.0, 25.0)),)

    def _share(self, now: Instant, where: Where) -> jax.Array:
        start = where.material.forward_start + self.above + now.stress / _SLOPE
        return (1.0 - now.fractions.martensite) * 0.5 * (1.0 + jnp.tanh((start - now.temperature) / _WIDTH))

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * self._share(now, where)

    def resistivity(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return _HUMP / 0.01 * self.strength * self._share(now, where)
