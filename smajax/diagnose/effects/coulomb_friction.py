"""Dry friction in guide, pulley or sheath."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MechanismEffect, Where, engaged


class CoulombFriction(MechanismEffect):
    """A stress s against the motion, s z with z in -1..1, z turning around over a small motion."""

    strength: jax.Array = parameter("Pa", "friction as stress in the wire", 0.0, 1.5e8, 0.0)
    reversal: jax.Array = parameter("1", "contraction, as a strain, that engages it from the middle", 1e-7, 1e-3, 1e-5)
    key = "coulomb-friction"
    typical = 2e7
    source = "capstan equation: 8 to 21 % of the load over a quarter turn at a coefficient of 0.05 to 0.15"
    confused_with = ("backlash",)
    needs = ("drag",)
    drags = True
    shapes = (("reversal", (1e-5, 3e-6)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """How far friction is engaged: 0 at rest."""
        return jnp.zeros_like(instant.contraction)

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        return engaged(memory, after.contraction - before.contraction, self.reversal)

    def drag(self, before: Instant, after: Instant, memory: jax.Array, step: jax.Array, where: Where) -> jax.Array:
        """See ``MechanismEffect``."""
        return self.strength * memory
