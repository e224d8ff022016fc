"""A sensor of displacement, angle or force that follows slowly."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect
from smajax.plant.sensor import lagged


class SensorLag(SensorEffect):
    """s dy/dt = x - y."""

    strength: jax.Array = parameter("s", "time constant of the sensor", 0.0, 2.0, 0.0)
    key = "sensor-lag"
    typical = 0.03
    source = "estimate: 10 to 100 ms"
    confused_with = ("time-skew", "viscous-friction")
    needs = ("clock",)

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return lagged(series, time, self.strength) - series
