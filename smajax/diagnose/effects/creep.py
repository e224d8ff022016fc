"""Martensite that keeps reorienting under load."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where, relaxed


class Creep(MaterialEffect):
    """eps + s (xi - the xi of some time ago): the strain overshoots and relaxes, or creeps up, with the time constant."""

    strength: jax.Array = parameter("1", "strain that relaxes", -0.02, 0.02, 0.0)
    time_constant: jax.Array = parameter("s", "time in which it relaxes", 0.5, 500.0, 15.0)
    key = "creep"
    typical = 0.002
    source = "estimate: 0.1 to 1 % of strain within minutes"
    confused_with = ("ratcheting", "end-conduction")
    needs = ("clock",)
    shapes = (("time_constant", (5.0, 30.0)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The fraction, filtered."""
        return instant.fractions.martensite

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        return relaxed(memory, before.fractions.martensite, after.fractions.martensite, step, self.time_constant)

    def strain(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return -self.strength * (now.fractions.martensite - memory)
