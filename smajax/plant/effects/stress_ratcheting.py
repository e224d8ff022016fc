"""Plastic strain of the transformation that grows with the stress."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState

# Stress in Pa to which the strength refers: a usual load of an actuator wire.
_REFERENCE_STRESS = 150e6


class StressRatcheting(MaterialEffect):
    """Permanent strain s (sigma / 150 MPa)^n per full transformation cycle, which adds up while the wire transforms."""

    strength: jax.Array = parameter("1", "permanent strain per full cycle at 150 MPa", -2e-3, 4e-3, 0.0)
    power: jax.Array = parameter("1", "power of the stress with which the strain grows", 0.5, 5.0, 2.0)
    key = "stress-ratcheting"
    typical: ClassVar[float] = 2e-4
    source = "lagoudas2004: plastic strain of the transformation grows with the stress"
    remedy = "Train the wire under the largest stress of use until its position after each cycle is steady."
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting",)
    # At one load it is ratcheting.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)
    shapes: ClassVar[Shapes] = (("power", (1.0, 2.0, 4.0)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the strain over the strength at the first row: 0."""
        return jnp.zeros_like(state.temperature)

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the strain over the strength at the end of the step; a full cycle counts twice a half."""
        stress = 0.5 * (before.stress + after.stress) / _REFERENCE_STRESS
        is_pulled = stress > 0.0
        weight = jnp.where(is_pulled, jnp.exp(self.power * jnp.log(jnp.where(is_pulled, stress, 1.0))), 0.0)
        return memory + 0.5 * weight * jnp.abs(after.fractions.martensite - before.fractions.martensite)

    def strain(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * memory
