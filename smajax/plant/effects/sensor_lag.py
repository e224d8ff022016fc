"""Lag of the displacement, angle or force sensor."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect
from smajax.plant.sensor import lag_series


class SensorLag(SensorEffect):
    """First-order lag of the reading y: s dy/dt = x - y."""

    strength: jax.Array = parameter("s", "time constant of the sensor", 0.0, 2.0, 0.0)
    key = "sensor-lag"
    typical: ClassVar[float] = 0.03
    source = "estimate: 10 to 100 ms"
    remedy = (
        "Turn off the filter of the sensor or raise its bandwidth; displace the sensor by hand in a step to measure "
        "its time constant."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("time-skew", "viscous-friction")
    needs: ClassVar[tuple[str, ...]] = ("clock",)

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return lag_series(series, time, self.strength) - series
