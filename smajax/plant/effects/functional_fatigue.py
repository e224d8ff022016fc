"""Functional fatigue: transformation strain that is lost with every cycle."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class FunctionalFatigue(MaterialEffect):
    """Transformation strain eps_L (1 - s N) after N full transformation cycles."""

    strength: jax.Array = parameter("1", "share of the transformation strain lost in each full cycle", -0.02, 0.06, 0.0)
    key = "functional-fatigue"
    typical: ClassVar[float] = 0.005
    source = "estimate: 0.1 to 1 % in 100 cycles of a trained wire, much more in the first cycles"
    remedy = (
        "Train the wire until its stroke is steady, and keep stress, strain and temperature below the limits of "
        "the maker."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting",)

    def strain(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return (
            -self.strength
            * 0.5
            * state.accumulated_transformation
            * context.material.transformation_strain(state.fractions)
        )
