"""Thermal radiation."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where

_STEFAN_BOLTZMANN = 5.670374e-8
_ZERO_CELSIUS = 273.15


class Radiation(HeatEffect):
    """emissivity sigma (T^4 - T_ambient^4) over the surface."""

    strength: jax.Array = parameter("1", "emissivity of the surface", 0.0, 1.0, 0.0)
    key = "radiation"
    typical = 0.5
    source = "estimate: oxidised NiTi 0.2 to 0.8, which is 2 to 9 % of h in still air"
    confused_with = ("convection-temperature",)

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        hot, cold = now.temperature + _ZERO_CELSIUS, where.environment.ambient + _ZERO_CELSIUS
        return -self.strength * _STEFAN_BOLTZMANN * 4.0 / where.wire.diameter * (hot**4 - cold**4)
