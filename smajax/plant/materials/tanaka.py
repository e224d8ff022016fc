"""Tanaka's law: exponential kinetics of one martensite fraction.

    forward    1 - xi = exp(ln(0.01) p)    p = (M_s + sigma / C_M - T) / (M_s - M_f)
    reverse    xi = exp(ln(0.01) q)        q = (T - A_s - sigma / C_A) / (A_f - A_s)

for a transformation that starts from one phase: 99 per cent have transformed at the finish temperature.
``smajax.plant.materials.one_fraction`` has the form for partial transformations.

Source: tanaka1986.
"""

import math

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.plant.materials.one_fraction import AbstractOneFraction


class Tanaka(AbstractOneFraction):
    """Tanaka's law: 1 - xi = 0.01^p forward, xi = 0.01^q reverse.

    Source: tanaka1986.
    """

    def remainder(self, start: Float[Array, "..."], end: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute 0.01 to the power of the progress over a step, counted from the start of the band."""
        return jnp.exp(math.log(0.01) * (maximum(end, 0.0) - maximum(start, 0.0)))
