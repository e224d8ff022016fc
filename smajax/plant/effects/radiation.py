"""Thermal radiation."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState

# Stefan-Boltzmann constant, W/m^2/K^4.
_STEFAN_BOLTZMANN = 5.670374e-8
# 0 degC in K.
_ZERO_CELSIUS = 273.15


class Radiation(HeatEffect):
    """Heat loss s sigma (T^4 - T_ambient^4) per surface, with emissivity s and absolute temperatures."""

    strength: jax.Array = parameter("1", "emissivity of the surface", 0.0, 1.0, 0.0)
    key = "radiation"
    typical: ClassVar[float] = 0.5
    source = "estimate: emissivity of oxidised NiTi 0.2 to 0.8, which is 2 to 9 % of h in still air"
    remedy = (
        "Nothing to mend in air; below a few hundred degrees it is a small part of the heat loss. Several levels "
        "of the input distinguish it from convection."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("convection-temperature",)

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        hot, cold = state.temperature + _ZERO_CELSIUS, context.environment.ambient + _ZERO_CELSIUS
        return -self.strength * _STEFAN_BOLTZMANN * 4.0 / context.wire.diameter * (hot**4 - cold**4)
