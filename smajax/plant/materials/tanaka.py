"""Tanaka's law: exponential kinetics of one martensite fraction."""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.plant.materials.one_fraction import AbstractOneFraction


class Tanaka(AbstractOneFraction):
    """Tanaka's law: 1 - xi = 0.01^p, xi = 0.01^q. Source: tanaka1986."""

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the ratio of the remaining shares: 0.01 to the power of the progress made past the band's start."""
        return jnp.exp(math.log(0.01) * (maximum(end, 0.0) - maximum(start, 0.0)))
