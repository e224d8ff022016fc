"""Strain that stays with every cycle."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class Ratcheting(MaterialEffect):
    """eps + s ((1 + N)^p - 1) / p, N being the cycles of transformation so far: s N for an exponent p of 1, ever slower for less."""

    strength: jax.Array = parameter("1", "strain left by a full cycle, by the first one where they fade", -2e-3, 4e-3, 0.0)
    exponent: jax.Array = parameter("1", "power of the number of cycles with which the strain grows", 0.02, 1.5, 1.0)
    key = "ratcheting"
    typical = 2e-4
    source = "estimate: 1e-5 to 1e-4 per cycle of a young wire, more at high stress"
    confused_with = ("encoder-drift", "creep")

    def strain(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * jnp.expm1(self.exponent * jnp.log1p(0.5 * now.travel)) / self.exponent
