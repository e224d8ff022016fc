"""Resistance that rises with the transformation strain."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class ResistivityStrain(MaterialEffect):
    """Resistance R (1 + 2 s eps_tr): s = 1 is the geometry's part, a longer wire of a smaller cross-section."""

    strength: jax.Array = parameter(
        "1", "change of the resistance with strain over that of the geometry", -4.0, 6.0, 0.0
    )
    key = "resistivity-strain"
    typical: ClassVar[float] = 1.0
    source = "estimate: 4 % of strain raise the resistance by 8 %"
    remedy = "Record the resistance under several loads at the same temperature."
    confused_with: ClassVar[tuple[str, ...]] = ("resistivity-temperature",)

    def resistivity(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added resistivity, as a share of the resistivity."""
        return 2.0 * self.strength * context.material.transformation_strain(state.fractions)
