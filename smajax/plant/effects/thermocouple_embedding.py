"""Thermocouple embedded next to the wire, which the heat reaches through glue, sleeve or body."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect
from smajax.plant.sensor import lag_series


class ThermocoupleEmbedding(SensorEffect):
    """Two first-order lags in series: s dT_b/dt = T - T_b for the layer, s dy/dt = T_b - y for the thermocouple.

    Diffusion through a layer delays a pulse, which a single lag does not. Both lags are equal, since a heating pulse
    determines little more than their sum.
    """

    strength: jax.Array = parameter("s", "time constant of each of the two lags", 0.0, 10.0, 0.0)
    key = "thermocouple-embedding"
    typical: ClassVar[float] = 1.0
    source = (
        "a soft arm with embedded wires (public recordings bu-softlimb): its bending peaks 2 to 5 s before its "
        "thermocouples do"
    )
    remedy = "Put the thermocouple on the wire itself, or keep the effect: it delays the reading, not the wire."
    confused_with: ClassVar[tuple[str, ...]] = ("thermocouple-lag", "coating")
    needs: ClassVar[tuple[str, ...]] = ("temperature observed",)
    channel = "temperature"

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return lag_series(lag_series(series, time, self.strength), time, self.strength) - series
