"""Partial transformations that proceed at another pace than complete ones."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import MaterialEffect
from smajax.plant.material.base import Fractions

_LEAST = 1e-6


def _slowed(before: jax.Array, after: jax.Array, exponent: jax.Array) -> jax.Array:
    """What remains if d(x)/x goes with x^exponent times the law's own rate."""
    falling = (after < before) & (before > _LEAST)
    share = jnp.where(falling, jnp.maximum(after, 1e-12) / jnp.where(falling, before, 1.0), 1.0)
    pace = jnp.where(falling, before, 1.0) ** exponent
    return jnp.where(falling, before * share**pace, after)


class MinorLoopShape(MaterialEffect):
    """The rate of a transformation goes with (1 - progress)^(1 + s) instead of (1 - progress)."""

    strength: jax.Array = parameter("1", "additional exponent of the remaining share", -0.8, 2.0, 0.0)
    key = "minor-loop-shape"
    typical = 0.3
    source = "estimate: exponents of 0 to 1"
    confused_with = ("temperature-distribution",)

    def transform(self, before: Fractions, after: Fractions) -> Fractions:
        """See ``MaterialEffect``; forward the austenite is what remains, back the martensite."""
        first, last = before.martensite, after.martensite
        back = _slowed(first, last, self.strength)
        forth = 1.0 - _slowed(1.0 - first, 1.0 - last, self.strength)
        martensite = jnp.where(last < first, back, forth)
        scale = martensite / jnp.maximum(last, 1e-12)
        return Fractions(after.detwinned * scale, after.twinned * scale)
