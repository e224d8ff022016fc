"""Plastic strain that the highest stress so far leaves behind."""

import jax
import jax.numpy as jnp

from smajax.kinks import larger
from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where

_REFERENCE = 1e9  # Pa


class Slip(MaterialEffect):
    """eps + s (sigma_max / 1 GPa)^n, sigma_max being the highest stress so far: slip that hardens (Ramberg, Osgood)."""

    strength: jax.Array = parameter("1", "plastic strain at 1 GPa", 0.0, 0.1, 0.0)
    exponent: jax.Array = parameter("1", "hardening exponent n", 2.0, 20.0, 8.0)
    key = "slip"
    typical = 0.005
    source = "NiTi yields by slip at 0.8 to 1.2 GPa; exponents of 5 to 12 are usual for metals (Ramberg, Osgood 1943)"
    confused_with = ("ratcheting",)
    shapes = (("exponent", (8.0,)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The highest stress so far, as a share of 1 GPa."""
        return instant.stress / _REFERENCE

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        return larger(memory, after.stress / _REFERENCE)

    def strain(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * jnp.exp(self.exponent * jnp.log(larger(memory, 1e-9)))
