"""Lag of the thermocouple."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect
from smajax.plant.sensor import lag_series


class ThermocoupleLag(SensorEffect):
    """First-order lag of the reading: s dy/dt = T - y."""

    strength: jax.Array = parameter("s", "time constant of the thermocouple", 0.0, 5.0, 0.0)
    key = "thermocouple-lag"
    typical: ClassVar[float] = 0.3
    source = "estimate: 0.05 to 1 s"
    remedy = "Use a finer thermocouple, and heat more slowly."
    confused_with: ClassVar[tuple[str, ...]] = ("time-skew",)
    needs: ClassVar[tuple[str, ...]] = ("temperature observed",)
    channel = "temperature"

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return lag_series(series, time, self.strength) - series
