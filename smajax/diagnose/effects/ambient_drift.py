"""Surroundings that warm up or cool down during the recording."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class AmbientDrift(HeatEffect):
    """T_ambient + s t, as the wire's convection sees it."""

    strength: jax.Array = parameter("K/s", "rate at which the ambient temperature changes", -0.3, 0.3, 0.0)
    key = "ambient-drift"
    typical = 0.03
    source = "estimate: 1 to 5 K in a run"
    confused_with = ("end-conduction", "airflow-change")

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        return where.heat.conductance(now.temperature, where.wire) * self.strength * now.time
