"""A thermocouple that follows slowly."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect
from smajax.plant.sensor import lagged


class ThermocoupleLag(SensorEffect):
    """s dy/dt = T - y."""

    strength: jax.Array = parameter("s", "time constant of the thermocouple", 0.0, 5.0, 0.0)
    key = "thermocouple-lag"
    typical = 0.3
    source = "estimate: 0.05 to 1 s"
    confused_with = ("time-skew",)
    needs = ("temperature observed",)
    channel = "temperature"

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return lagged(series, time, self.strength) - series
