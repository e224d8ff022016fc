"""Transformation strain that grows with the stress."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where

_RATE = 0.02e-6  # 1/Pa
_REFERENCE = 150e6  # Pa


class StressDependentStrain(MaterialEffect):
    """eps_L (1 + s (H(sigma) / H(150 MPa) - 1)) with H = 1 - exp(-k sigma)."""

    strength: jax.Array = parameter("1", "how far the transformation strain follows 1 - exp(-k sigma)", -0.6, 1.6, 0.0)
    key = "stress-dependent-strain"
    typical = 1.0
    source = "estimate: k = 0.01 to 0.03 per MPa"
    confused_with = ()

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        ratio = (1.0 - jnp.exp(-_RATE * now.stress)) / (1.0 - jnp.exp(-_RATE * jnp.asarray(_REFERENCE)))
        return self.strength * (ratio - 1.0) * where.material.strain_of(now.fractions)
