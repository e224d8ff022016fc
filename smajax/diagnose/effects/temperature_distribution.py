"""Ends of the wire that stay colder than its middle."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where
from smajax.plant.material.base import Fractions


class TemperatureDistribution(MaterialEffect):
    """A share s of the wire is only half as warm above ambient as the rest."""

    strength: jax.Array = parameter("1", "share of the wire that belongs to its cold ends", 0.0, 0.5, 0.0)
    key = "temperature-distribution"
    typical = 0.08
    source = "two fin lengths of 4 mm on a wire of 100 mm"
    confused_with = ("minor-loop-shape", "end-conduction")

    def start(self, instant: Instant, where: Where) -> Fractions:
        """The fractions of the ends."""
        return instant.fractions

    def remember(self, memory: Fractions, before: Instant, after: Instant, step: jax.Array, where: Where) -> Fractions:
        """See ``AbstractEffect``."""
        ambient = where.environment.ambient
        ends = tuple(ambient + 0.5 * (i.temperature - ambient) for i in (before, after))
        return where.material.evolve(memory, ends, (before.stress, after.stress))

    def strain(self, now: Instant, memory: Fractions, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * (where.material.strain_of(memory) - where.material.strain_of(now.fractions))
