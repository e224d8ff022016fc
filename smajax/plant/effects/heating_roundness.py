"""Heating that is rounder than cooling: a reverse transformation that ends more gradually than the forward one."""

from typing import ClassVar

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect
from smajax.plant.effects.minor_loop_shape import with_shaped_rate
from smajax.plant.effects.skip_at_zero import skip_at_zero
from smajax.plant.materials.base import Fractions


class HeatingRoundness(MaterialEffect):
    """Rate of the reverse transformation in proportion to xi^(1 + s) instead of xi, with xi the remaining martensite.

    With s > 0 heating ends more gradually, with s < 0 more suddenly; cooling is that of the material law. Laws with
    smooth hardening likewise have separate exponents for the two directions.
    """

    strength: jax.Array = parameter("1", "additional exponent of the remaining martensite on heating", -0.8, 2.0, 0.0)
    key = "heating-roundness"
    typical: ClassVar[float] = 0.3
    source = "lagoudas2012: exponents of 0 to 1 of smooth hardening, those of heating apart from those of cooling"
    remedy = "Nothing to mend: a property of the alloy. Slow full cycles at a constant load determine it."
    confused_with: ClassVar[tuple[str, ...]] = ("minor-loop-shape", "gradual-transformation")
    # A free motion hardly identifies it next to the other shapes of the transformation.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)

    @skip_at_zero
    def modify_fractions(self, before: Fractions, after: Fractions) -> Fractions:
        """Return the fractions after the step; those of cooling are unchanged."""
        shaped = with_shaped_rate(before, after, self.strength)
        is_heating = after.martensite < before.martensite
        return Fractions(*(jnp.where(is_heating, new, old) for new, old in zip(shaped, after, strict=True)))
