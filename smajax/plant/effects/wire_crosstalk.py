"""Thermal crosstalk between neighbouring wires."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState


class WireCrosstalk(HeatEffect):
    """Heat flow between two wires: s times the convection at ambient, per kelvin of their difference."""

    strength: jax.Array = parameter("1", "conductance between the wires over that of convection", 0.0, 0.6, 0.0)
    key = "wire-crosstalk"
    typical: ClassVar[float] = 0.05
    source = "estimate: 2 to 10 % of h at a pitch of 1 to 2 mm"
    remedy = "Increase the distance between the wires, or put a screen between them."
    confused_with: ClassVar[tuple[str, ...]] = ("ambient-drift",)
    needs: ClassVar[tuple[str, ...]] = ("two wires",)

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        per_kelvin = context.heat.conductance(context.environment.ambient, context.wire)
        return -self.strength * per_kelvin * (state.temperature - state.temperature[::-1])
