"""Conduction into crimps that warm up slowly."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class EndConduction(HeatEffect):
    """Heat flows into the crimps, s times the convection at ambient; they warm up to half the wire's excess with their time constant."""

    strength: jax.Array = parameter("1", "conduction to the crimps over convection", 0.0, 0.6, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the crimps warm up", 2.0, 500.0, 30.0)
    key = "end-conduction"
    typical = 0.08
    source = "fin length sqrt(k d / 4 h): 4 mm at each end of a 0.25 mm wire"
    confused_with = ("ambient-drift", "coating")
    shapes = (("time_constant", (15.0, 60.0)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The node's temperature above ambient, which it has at rest."""
        return jnp.zeros_like(instant.temperature)

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        stays = jnp.exp(-step / self.time_constant)
        over = 0.5 * (before.temperature + after.temperature) - where.environment.ambient
        return stays * memory + (1.0 - stays) * 0.5 * over

    def power(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        per_kelvin = 4.0 / where.wire.diameter * where.convection(where.environment.ambient)
        return -self.strength * per_kelvin * (now.temperature - where.environment.ambient - memory)
