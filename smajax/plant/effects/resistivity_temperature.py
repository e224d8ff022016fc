"""Resistivity that rises with temperature."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class ResistivityTemperature(MaterialEffect):
    """Resistivity rho (1 + s (T - T_ambient))."""

    strength: jax.Array = parameter("1/K", "temperature coefficient of resistivity", -2e-3, 5e-3, 0.0)
    key = "resistivity-temperature"
    typical: ClassVar[float] = 7e-4
    source = "estimate: 5e-4 to 1e-3 per kelvin"
    remedy = "Record the resistance of the fully austenitic wire at several temperatures."
    confused_with: ClassVar[tuple[str, ...]] = ("convection-temperature", "current-limit", "lead-resistance")

    def resistivity(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added resistivity, as a share of the resistivity."""
        return self.strength * (state.temperature - context.environment.ambient)
