"""A channel whose clock is late or early."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class TimeSkew(SensorEffect):
    """y(t) = x(t - s)."""

    strength: jax.Array = parameter("s", "delay of the channel", -1.0, 1.0, 0.0)
    key = "time-skew"
    typical = 0.03
    source = "catalogue row 14; 1 to 100 ms"
    confused_with = ("sensor-lag",)

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return jnp.interp(time - self.strength, time, series) - series
