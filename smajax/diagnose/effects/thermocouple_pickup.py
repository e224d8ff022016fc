"""A thermocouple that picks up a voltage from the heating current."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class ThermocouplePickup(SensorEffect):
    """y = T + s i."""

    strength: jax.Array = parameter("K/A", "reading per current", -100.0, 100.0, 0.0)
    key = "thermocouple-pickup"
    typical = 1.0
    source = "Ma 2010: the reading jumps and changes sign with the current"
    confused_with = ("current-limit",)
    sees = ("current",)
    needs = ("temperature observed",)
    channel = "temperature"

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return self.strength * seen["current"]
