"""Damping in proportion to the speed."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MechanismEffect, Where


class ViscousFriction(MechanismEffect):
    """A stress s times the rate of contraction, against the motion."""

    strength: jax.Array = parameter("Pa s", "stress in the wire per rate of contraction", 0.0, 3e9, 0.0)
    key = "viscous-friction"
    typical = 2e8
    source = "estimate: greased guides and sheaths"
    confused_with = ("sensor-lag",)
    needs = ("drag",)
    drags = True

    def drag(self, before: Instant, after: Instant, memory: tuple, step: jax.Array, where: Where) -> jax.Array:
        """See ``MechanismEffect``."""
        moving = step > 0
        return jnp.where(moving, self.strength * (after.contraction - before.contraction) / jnp.where(moving, step, 1.0), 0.0)
