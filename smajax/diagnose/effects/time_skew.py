"""A channel whose clock is late or early."""

import jax
import jax.numpy as jnp

from smajax.kinks import larger, within
from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect
from smajax.plant.sensor import slopes


class TimeSkew(SensorEffect):
    """y(t) = x(t - s)."""

    strength: jax.Array = parameter("s", "delay of the channel", -1.0, 1.0, 0.0)
    key = "time-skew"
    typical = 0.03
    source = "estimate: 1 to 100 ms"
    confused_with = ("sensor-lag",)
    needs = ("clock",)

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``."""
        return _at(time - self.strength, time, series) - series


def _at(wanted: jax.Array, time: jax.Array, series: jax.Array) -> jax.Array:
    """A series between its samples by cubics through them, whose slope at a sample is the same from both sides; its ends go on level."""
    slope = slopes(series, time)
    wanted = within(wanted, time[0], time[-1])
    i = jnp.clip(jnp.searchsorted(time, jax.lax.stop_gradient(wanted), side="right") - 1, 0, len(time) - 2)
    gap = larger(time[i + 1] - time[i], 1e-9)
    u = (wanted - time[i]) / gap
    near = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * series[i] + u * (1.0 - u) ** 2 * gap * slope[i]
    return near + u**2 * (3.0 - 2.0 * u) * series[i + 1] - u**2 * (1.0 - u) * gap * slope[i + 1]
