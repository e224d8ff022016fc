"""Drift of the ambient temperature during the recording."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState


class AmbientDrift(HeatEffect):
    """Ambient temperature T_ambient + s t in the wire's convection."""

    strength: jax.Array = parameter("K/s", "rate at which the ambient temperature changes", -0.3, 0.3, 0.0)
    key = "ambient-drift"
    typical: ClassVar[float] = 0.03
    source = "estimate: 1 to 5 K during a recording"
    remedy = (
        "Wait until enclosure and driver are warm, or record the ambient temperature next to the wire as a column "
        "ambient."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("end-conduction", "airflow-change")

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        return context.heat.conductance(state.temperature, context.wire) * self.strength * state.time
