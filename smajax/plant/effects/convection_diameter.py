"""Convection that depends on the wire's diameter; visible only in wires of several diameters."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState

# Diameter in m to which the strength refers.
_REFERENCE_DIAMETER = 0.25e-3


class ConvectionDiameter(HeatEffect):
    """Convection coefficient h (d / 0.25 mm)^(-s), to first order in s; with one wire it is a factor of h."""

    strength: jax.Array = parameter("1", "exponent with which h falls with the diameter", -0.5, 1.0, 0.0)
    key = "convection-diameter"
    typical: ClassVar[float] = 0.6
    source = "Churchill and Chu's correlation: h = 147, 71, 43 W/m^2/K at diameters of 0.1, 0.25, 0.5 mm"
    remedy = "Measure wires of several diameters in the same air; with a single diameter it is a factor of h."
    confused_with: ClassVar[tuple[str, ...]] = ()

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        cooling = context.heat.conductance(state.temperature, context.wire) * (
            state.temperature - context.environment.ambient
        )
        return self.strength * jnp.log(context.wire.diameter / _REFERENCE_DIAMETER) * cooling
