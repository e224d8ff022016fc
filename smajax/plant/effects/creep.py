"""Creep: martensite that continues to reorient under load."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState
from smajax.plant.effects.memory import first_order_lag


class Creep(MaterialEffect):
    """Strain -s (xi - xi_f), with xi_f the martensite fraction behind a first-order lag.

    After a change of the fraction the strain creeps on (s > 0), or overshoots and relaxes (s < 0), with the time
    constant.
    """

    strength: jax.Array = parameter("1", "strain that relaxes", -0.02, 0.02, 0.0)
    time_constant: jax.Array = parameter("s", "time in which it relaxes", 0.5, 500.0, 15.0)
    key = "creep"
    typical: ClassVar[float] = 0.002
    source = "estimate: 0.1 to 1 % of strain within minutes"
    remedy = (
        "Hold the input for minutes and record on; a strain that goes on at constant temperature is creep. Train "
        "a new wire by some tens of cycles first."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting", "end-conduction")
    needs: ClassVar[tuple[str, ...]] = ("clock",)
    shapes: ClassVar[Shapes] = (("time_constant", (5.0, 30.0)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the filtered fraction: that of the first row."""
        return state.fractions.martensite

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the filtered fraction at the end of the step."""
        return first_order_lag(
            memory, before.fractions.martensite, after.fractions.martensite, step, self.time_constant
        )

    def strain(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return -self.strength * (state.fractions.martensite - memory)
