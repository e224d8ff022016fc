"""Load that changes with the position, such as a weight on an arm."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, StageContext, WireState

# Contraction to which the strength refers: a usual stroke of an actuator wire.
_STROKE = 0.04


class LoadChange(MechanismEffect):
    """Load that grows by s per 4 % of contraction since the first row."""

    strength: jax.Array = parameter(
        "Pa", "change of the load, as stress in the wire, over a contraction of 4 %", -2e8, 4e8, 0.0
    )
    key = "load-change"
    typical: ClassVar[float] = 3e7
    source = "estimate: the lever arm of a weight changes with the position"
    remedy = (
        "Measure the force, or compute the lever arm over the angle; hang the weight so that its lever arm is constant."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("bias-nonlinearity",)
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    has_drag = True

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, ""]:
        """Return the contraction at the first row."""
        return state.contraction

    def drag(
        self,
        before: WireState,
        after: WireState,
        memory: Float[Array, ""],
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, ""]:
        """Compute the stress against contraction, Pa."""
        return self.strength * (after.contraction - memory) / _STROKE
