"""A set that a wire keeps from before the recording until it is heated through."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where


class InitialSet(MaterialEffect):
    """eps + s r, r being what is left of the martensite of the first row: heating wipes its history out, once and for all."""

    strength: jax.Array = parameter("1", "strain from before that the first heating takes away", -0.02, 0.02, 0.0)
    key = "initial-set"
    typical = 0.002
    source = "a soft arm (public recordings bu-softlimb): its rest shape moves by 1 to 3 of 15 deg with the first pulse and not again"
    confused_with = ("ratcheting", "creep")

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """All of it."""
        return jnp.ones_like(instant.temperature)

    def remember(self, memory: jax.Array, before: Instant, after: Instant, step: jax.Array, where: Where) -> jax.Array:
        """See ``AbstractEffect``."""
        had, has = before.fractions.martensite, after.fractions.martensite
        lost = has < had
        return memory * jnp.where(lost, has / jnp.where(lost, had, 1.0), 1.0)

    def strain(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * memory
