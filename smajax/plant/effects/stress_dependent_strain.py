"""Transformation strain that depends on the stress."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState

# Stress in Pa at which the transformation strain is that of the material law: a usual load of an actuator wire.
_REFERENCE_STRESS = 150e6


class StressDependentStrain(MaterialEffect):
    """Transformation strain eps_L (1 + s (H(sigma) / H(150 MPa) - 1)), with H = 1 - exp(-sigma / saturation)."""

    strength: jax.Array = parameter(
        "1", "share of the transformation strain that depends on the stress", -0.6, 1.6, 0.0
    )
    saturation: jax.Array = parameter("Pa", "stress over which the transformation strain saturates", 10e6, 600e6, 50e6)
    key = "stress-dependent-strain"
    typical: ClassVar[float] = 1.0
    source = "estimate: saturation within 30 to 100 MPa, more in NiTiHf (experiments/measured/isobaric.py)"
    remedy = "Record cycles under at least three loads, one of them small: the stroke then grows less than the load."
    confused_with: ClassVar[tuple[str, ...]] = ()
    shapes: ClassVar[Shapes] = (("saturation", (50e6, 200e6)),)

    def strain(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        ratio = jnp.expm1(-state.stress / self.saturation) / jnp.expm1(-_REFERENCE_STRESS / self.saturation)
        return self.strength * (ratio - 1.0) * context.material.transformation_strain(state.fractions)
