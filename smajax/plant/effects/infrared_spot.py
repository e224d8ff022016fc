"""Infrared thermometer whose spot is larger than the wire, so that it sees wire and background."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect, Shapes
from smajax.plant.sensor import lag_series

# K of 0 degC, for the law of Stefan and Boltzmann.
_KELVIN = 273.15


class InfraredSpot(SensorEffect):
    """Reading y of a spot of which the wire fills the share 1 - s and a background of temperature B the rest, in K.

        y^4 = (1 - s) T^4 + s B^4        B = T_0 + w v        tau dv/dt = (T - T_0) - v

    The radiation of the two is added by area, and read as that of a single body (law of Stefan and Boltzmann). The
    background begins at the temperature T_0 of the first row, and follows the wire with the time constant tau, as far
    as the warming w: 0 for a background that stays cold.
    """

    strength: jax.Array = parameter("1", "share of the spot that the background fills", 0.0, 0.95, 0.0)
    warming: jax.Array = parameter("1", "excess temperature of the background over that of the wire", 0.0, 1.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the background follows the wire", 1.0, 1000.0, 30.0)
    key = "infrared-spot"
    typical: ClassVar[float] = 0.5
    source = (
        "law of Stefan and Boltzmann; estimate. Public recordings "
        "guarneros-sma-force: the thermometer reads 57 degC at most on a wire that has transformed"
    )
    remedy = (
        "Use a thermometer whose spot is smaller than the wire, or a fine thermocouple; put a cold, matt "
        "background behind the wire."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("thermocouple-attachment", "thermocouple-embedding", "coating")
    # A cold background is nearly a gain, as ``thermocouple-attachment``; the same share.
    absorbed_from: ClassVar[float] = 0.99
    needs: ClassVar[tuple[str, ...]] = ("temperature observed",)
    channel = "temperature"
    shapes: ClassVar[Shapes] = (("warming", (0.0, 0.3)),)

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        excess = lag_series(series - series[0], time, self.time_constant)
        wire, background = series + _KELVIN, series[0] + self.warming * excess + _KELVIN
        return wire * ((1.0 + self.strength * ((background / wire) ** 4 - 1.0)) ** 0.25 - 1.0)
