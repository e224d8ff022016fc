"""Convection that depends on the temperature difference, as natural convection does."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState

# Excess temperature in K to which the strength refers.
_REFERENCE_EXCESS = 50.0


class ConvectionTemperature(HeatEffect):
    """Convection coefficient h (1 + s (T - T_ambient) / 50 K)."""

    strength: jax.Array = parameter("1", "relative rise of h per 50 K above ambient", -0.4, 1.0, 0.0)
    key = "convection-temperature"
    typical: ClassVar[float] = 0.11
    source = "Churchill and Chu's correlation for thin wires: 0.10 to 0.12 per 50 K"
    remedy = "Record inputs at several levels, so that the wire is at several temperatures, or measure its temperature."
    confused_with: ClassVar[tuple[str, ...]] = ("radiation", "current-limit")

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        excess = state.temperature - context.environment.ambient
        return (
            -self.strength
            * context.heat.conductance(state.temperature, context.wire)
            * excess
            * excess
            / _REFERENCE_EXCESS
        )
