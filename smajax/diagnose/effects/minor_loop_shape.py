"""Partial transformations that proceed at another pace than complete ones."""

import jax
import jax.numpy as jnp

from smajax.kinks import larger
from smajax.parameters import parameter
from smajax.plant.effect import MaterialEffect, asleep_at_zero
from smajax.plant.material.base import Fractions

_LEAST = 1e-6  # what is less is nothing
_COMPLETE = 1e-3  # a step that leaves less is the law's last one, and ends as that does: at a temperature, where a power would leave some
_FLAT = 1e-4  # below it the series is exact to rounding


def _slowed(before: jax.Array, after: jax.Array, exponent: jax.Array) -> jax.Array:
    """What remains if d(x)/x goes with x^exponent times the law's own rate: x^-exponent grows by exponent times what -ln(x) would grow by.

    With a negative exponent, nothing remains from a finite growth on.
    """
    falling = (after < before) & (before > _LEAST)
    first = jnp.where(falling, before, 1.0)
    log = jnp.log(first)
    growth = jnp.exp(exponent * log) * (log - jnp.log(jnp.where(falling, larger(after, 1e-30), 1.0)))
    u = exponent * growth
    flat = jnp.abs(u) < _FLAT
    wide = jnp.where(flat, 1.0, larger(u, -1.0 + 1e-12))
    mean = jnp.where(flat, 1.0 - u / 2.0 + u * u / 3.0 - u**3 / 4.0, jnp.log1p(wide) / wide)
    return jnp.where(falling & (after > _COMPLETE * before), first * jnp.exp(-growth * mean), after)


class MinorLoopShape(MaterialEffect):
    """The rate of a transformation goes with (1 - progress)^(1 + s) instead of (1 - progress)."""

    strength: jax.Array = parameter("1", "additional exponent of the remaining share", -0.8, 2.0, 0.0)
    key = "minor-loop-shape"
    typical = 0.3
    source = "estimate: exponents of 0 to 1"
    confused_with = ("temperature-distribution",)

    @asleep_at_zero
    def transform(self, before: Fractions, after: Fractions) -> Fractions:
        """See ``MaterialEffect``; forward the austenite is what remains, back the martensite."""
        first, last = before.martensite, after.martensite
        back = last < first
        remains = _slowed(jnp.where(back, first, 1.0 - first), jnp.where(back, last, 1.0 - last), self.strength)
        martensite = jnp.where(back, remains, 1.0 - remains)
        some = last > 1e-12  # a step may end a little below none
        scale = jnp.where(some, martensite / jnp.where(some, last, 1.0), 1.0)
        return Fractions(after.detwinned * scale, after.twinned * scale)
