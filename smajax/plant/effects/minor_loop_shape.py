"""Shape of minor loops: partial transformations whose rate differs from that of complete ones."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect
from smajax.plant.effects.skip_at_zero import skip_at_zero
from smajax.plant.materials.base import Fractions

# Shares below it count as 0, so that rounding is not amplified.
_SMALLEST = 1e-6
# A step after which a smaller part of the remaining share is left completes the transformation, as the material law
# does at the finish; the power law alone would never complete it. Chosen by trial; tests/unit/plant/test_effects.py
# holds it.
_COMPLETE = 1e-3
# Below it the series of log1p(u) / u to third order is exact to rounding.
_SERIES_BELOW = 1e-4
# A step may end slightly below a fraction of 0, by rounding; such a fraction is not changed.
_ZERO_FRACTION = 1e-12
# Keeps the logarithm of a share finite; no share that is not 0 is that small.
_TINY = 1e-30
# Smallest argument of log1p, just above -1, where nothing remains to transform: the logarithm is finite there.
_SMALLEST_ARGUMENT = -1.0 + 1e-12


def _remaining_share(before: jax.Array, after: jax.Array, exponent: jax.Array) -> jax.Array:
    """Share x that remains after a step if d(x)/x is x^exponent times the rate of the material law.

    The law alone gives ``after``. x^-exponent grows by exponent times the growth of -ln(x) under the law; with a
    negative exponent nothing remains from a finite growth on.
    """
    falling = (after < before) & (before > _SMALLEST)
    first = jnp.where(falling, before, 1.0)
    log = jnp.log(first)
    growth = jnp.exp(exponent * log) * (log - jnp.log(jnp.where(falling, maximum(after, _TINY), 1.0)))
    u = exponent * growth
    small = jnp.abs(u) < _SERIES_BELOW
    regular = jnp.where(small, 1.0, maximum(u, _SMALLEST_ARGUMENT))
    mean = jnp.where(small, 1.0 - u / 2.0 + u * u / 3.0 - u**3 / 4.0, jnp.log1p(regular) / regular)
    return jnp.where(falling & (after > _COMPLETE * before), first * jnp.exp(-growth * mean), after)


def with_shaped_rate(before: Fractions, after: Fractions, exponent: jax.Array) -> Fractions:
    """Return the fractions after a step whose rate is that of the material law times a power of the remaining share.

    The remaining share is the austenite in the forward transformation, the martensite in the reverse one.

    Args:
        before: Fractions at the start.
        after: Fractions at the end by the material law.
        exponent: The power.
    """
    first, last = before.martensite, after.martensite
    reverse = last < first
    share = _remaining_share(jnp.where(reverse, first, 1.0 - first), jnp.where(reverse, last, 1.0 - last), exponent)
    martensite = jnp.where(reverse, share, 1.0 - share)
    positive = last > _ZERO_FRACTION
    scale = jnp.where(positive, martensite / jnp.where(positive, last, 1.0), 1.0)
    return Fractions(after.detwinned * scale, after.twinned * scale)


class MinorLoopShape(MaterialEffect):
    """Transformation rate in proportion to (1 - progress)^(1 + s) instead of (1 - progress)."""

    strength: jax.Array = parameter("1", "additional exponent of the remaining share", -0.8, 2.0, 0.0)
    key = "minor-loop-shape"
    typical: ClassVar[float] = 0.3
    source = "estimate: exponents of 0 to 1"
    remedy = "Record partial loops: reverse the input at several strokes within the main loop."
    confused_with: ClassVar[tuple[str, ...]] = ("temperature-distribution",)

    @skip_at_zero
    def modify_fractions(self, before: Fractions, after: Fractions) -> Fractions:
        """Return the fractions after the step.

        The remaining share is the austenite in the forward transformation, the martensite in the reverse one.
        """
        return with_shaped_rate(before, after, self.strength)
