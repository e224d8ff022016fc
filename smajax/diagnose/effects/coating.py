"""A sleeve or coating: a second thermal node around the wire."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class Coating(HeatEffect):
    """Heat flows into a node that follows the wire's temperature with its time constant, s times the convection at ambient per kelvin."""

    strength: jax.Array = parameter("1", "conduction into the coating over convection", 0.0, 6.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the coating follows the wire", 0.2, 60.0, 3.0)
    key = "coating"
    typical = 0.5
    source = "estimate: time constants 0.5 to 10 s, capacities 0.3 to 3 of the wire's"
    confused_with = ("latent-heat", "end-conduction", "heat-capacity")
    shapes = (("time_constant", (1.0, 5.0)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The node's temperature above ambient, which it has at rest."""
        return jnp.zeros_like(instant.temperature)

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        stays = jnp.exp(-step / self.time_constant)
        over = 0.5 * (before.temperature + after.temperature) - where.environment.ambient
        return stays * memory + (1.0 - stays) * over

    def power(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        per_kelvin = 4.0 / where.wire.diameter * where.convection(where.environment.ambient)
        return -self.strength * per_kelvin * (now.temperature - where.environment.ambient - memory)
