"""Transformation temperatures that shift with every cycle."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class TransformationShift(MaterialEffect):
    """Shift of all four transformation temperatures by s N after N full transformation cycles."""

    strength: jax.Array = parameter("K", "shift of the transformation temperatures per full cycle", -4.0, 4.0, 0.0)
    key = "transformation-shift"
    typical: ClassVar[float] = 0.3
    source = "estimate: start temperatures shift with accumulated transformation"
    remedy = "Train the wire until its cycles repeat, and give each recording the same history."
    confused_with: ClassVar[tuple[str, ...]] = ("ambient-drift",)

    def shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the shift of the transformation temperatures, K."""
        return self.strength * 0.5 * state.accumulated_transformation
