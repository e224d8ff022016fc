"""A sensor of displacement or angle with a wrong gain."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class EncoderGain(SensorEffect):
    """y = x (1 + s)."""

    strength: jax.Array = parameter("1", "relative error of the gain", -0.1, 0.1, 0.0)
    key = "encoder-gain"
    typical = 0.01
    source = "estimate: 0.1 to 2 %"
    absorbed_from = 0.99

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return self.strength * series
