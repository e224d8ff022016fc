"""Transformation strain that grows with the stress."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where

_REFERENCE = 150e6  # Pa


class StressDependentStrain(MaterialEffect):
    """eps_L (1 + s (H(sigma) / H(150 MPa) - 1)) with H = 1 - exp(-sigma / saturation)."""

    strength: jax.Array = parameter("1", "how far the transformation strain follows the stress", -0.6, 1.6, 0.0)
    saturation: jax.Array = parameter("Pa", "stress over which the transformation strain saturates", 10e6, 600e6, 50e6)
    key = "stress-dependent-strain"
    typical = 1.0
    source = "estimate: saturation within 30 to 100 MPa, more in NiTiHf (experiments/measured_isobaric.py)"
    confused_with = ()
    shapes = (("saturation", (50e6, 200e6)),)

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        ratio = jnp.expm1(-now.stress / self.saturation) / jnp.expm1(-_REFERENCE / self.saturation)
        return self.strength * (ratio - 1.0) * where.material.strain_of(now.fractions)
