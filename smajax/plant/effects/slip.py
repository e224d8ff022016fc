"""Plastic strain by slip, set by the highest stress so far."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState

# Stress in Pa to which the strength refers: NiTi yields by slip near it.
_REFERENCE_STRESS = 1e9
# Smallest relative stress, so that its logarithm is finite; at n >= 2 its power is 0 to rounding.
_SMALLEST = 1e-9


class Slip(MaterialEffect):
    """Plastic strain s (sigma_max / 1 GPa)^n, with sigma_max the highest stress so far.

    Source: ramberg1943, for slip with hardening.
    """

    strength: jax.Array = parameter("1", "plastic strain at 1 GPa", 0.0, 0.1, 0.0)
    exponent: jax.Array = parameter("1", "hardening exponent n", 2.0, 20.0, 8.0)
    key = "slip"
    obstacle_to_rates = "a memory of the highest stress"
    typical: ClassVar[float] = 0.005
    source = "NiTi yields by slip at 0.8 to 1.2 GPa; exponents of 5 to 12 are usual for metals (Ramberg, Osgood 1943)"
    remedy = "Keep the stress below the limit of the maker; a wire that has yielded has to be replaced."
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting",)
    shapes: ClassVar[Shapes] = (("exponent", (8.0,)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the highest stress so far as a share of 1 GPa."""
        return state.stress / _REFERENCE_STRESS

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the highest stress so far as a share of 1 GPa."""
        return maximum(memory, after.stress / _REFERENCE_STRESS)

    def strain(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * jnp.exp(self.exponent * jnp.log(maximum(memory, _SMALLEST)))
