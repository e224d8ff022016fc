"""A thermocouple that takes heat from the wire and reads low."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class ThermocoupleAttachment(SensorEffect):
    """y = T - s (T - T at the start)."""

    strength: jax.Array = parameter("1", "share of the excess temperature that is not seen", -0.2, 0.6, 0.0)
    key = "thermocouple-attachment"
    typical = 0.2
    source = "estimate: 0.2 for a 75 um thermocouple on a 0.25 mm wire"
    absorbed_from = 0.99
    needs = ("temperature observed",)
    channel = "temperature"

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return -self.strength * (series - series[0])
