"""Coulomb (dry) friction in guide, pulley or sheath."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, Shapes, StageContext, WireState
from smajax.plant.effects.memory import presliding_state


class CoulombFriction(MechanismEffect):
    """Stress s z against the motion; the presliding state z reverses over a small motion.

    dz = d(contraction) / reversal, with z limited to -1..1.
    """

    strength: jax.Array = parameter("Pa", "friction as stress in the wire", 0.0, 1.5e8, 0.0)
    reversal: jax.Array = parameter(
        "1", "contraction, as a strain, over which friction builds up from 0", 1e-7, 1e-3, 1e-5
    )
    key = "coulomb-friction"
    obstacle_to_rates = "dry friction"
    typical: ClassVar[float] = 2e7
    source = "capstan equation: 8 to 21 % of the load over a quarter turn at a coefficient of 0.05 to 0.15"
    remedy = (
        "Reverse the motion at several loads: friction opposes both directions. Replace guides by bearings, "
        "straighten the sheath, reduce the angle of wrap."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("backlash",)
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    has_drag = True
    shapes: ClassVar[Shapes] = (("reversal", (1e-5, 3e-6)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, ""]:
        """Return the presliding state at the first row: 0."""
        return jnp.zeros_like(state.contraction)

    def update_memory(
        self,
        memory: Float[Array, ""],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, ""]:
        """Return the presliding state at the end of the step."""
        return presliding_state(memory, after.contraction - before.contraction, self.reversal)

    def drag(
        self,
        before: WireState,
        after: WireState,
        memory: Float[Array, ""],
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, ""]:
        """Compute the stress against contraction, Pa."""
        return self.strength * memory
