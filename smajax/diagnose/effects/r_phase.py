"""The R-phase: a small strain and a hump of resistivity before the martensite."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where
from smajax.plant.material.brinson import remaining

_SLOPE = 15e6  # Pa/K
_SMALL = 0.01  # strain to which the hump refers


class RPhase(MaterialEffect):
    """Strain s and a hump of resistivity in what is colder than the R-phase's start temperature.

    It comes about by half a cosine, as the martensite does. Of the share that is martensite, only ``kept``: martensite that formed of the
    R-phase has given its strain up to that of its variants, while regions that go no further than to the R-phase keep it.
    """

    strength: jax.Array = parameter("1", "strain of the R-phase", 0.0, 0.015, 0.0)
    above: jax.Array = parameter("K", "middle of the R-phase's transformation above the martensite start temperature", -40.0, 60.0, 12.0)
    width: jax.Array = parameter("K", "from the R-phase's start temperature to its finish temperature", 1.0, 40.0, 10.0)
    kept: jax.Array = parameter("1", "share of its strain that is there beside martensite, too", 0.0, 1.0, 0.5)
    hump: jax.Array = parameter("1", "share by which a strain of 1 % of it raises the resistivity", -0.2, 0.5, 0.1)
    key = "r-phase"
    typical = 0.006
    source = "estimate: 0.5 to 1 % of strain, 10 to 20 % of resistance"
    confused_with = ("resistivity-temperature", "slack")
    shapes = (("above", (8.0, -10.0, 25.0)), ("width", (10.0,)), ("kept", (0.5,)), ("hump", (0.1,)))

    def _share(self, now: Instant, where: Where) -> jax.Array:
        middle = where.material.forward_start + self.above + now.stress / _SLOPE
        cold = 1.0 - remaining((middle - now.temperature) / self.width + 0.5, 0.0)
        return (1.0 - (1.0 - self.kept) * now.fractions.martensite) * cold

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * self._share(now, where)

    def resistivity(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.hump / _SMALL * self.strength * self._share(now, where)
