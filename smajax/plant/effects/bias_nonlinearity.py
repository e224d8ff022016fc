"""Bias spring with a cubic stiffness."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, StageContext, WireState


class BiasNonlinearity(MechanismEffect):
    """Additional spring force s x^3, with x the contraction since the first row."""

    strength: jax.Array = parameter("N/m^3", "cubic stiffness of the spring", -1e9, 1e10, 0.0)
    key = "bias-nonlinearity"
    typical: ClassVar[float] = 1e6
    source = "estimate: 0 to 10 % at full stroke"
    remedy = (
        "Measure force over length of the spring by hanging weights on it, and use a spring that stays within its "
        "linear range."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("load-change",)
    needs: ClassVar[tuple[str, ...]] = ("drag", "spring")
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
        motion = context.wire.motion_per_strain * (after.contraction - memory)
        return self.strength * motion**3 / context.wire.force_per_stress
