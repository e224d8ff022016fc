"""A sensor of displacement, angle or force that follows slowly."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


class SensorLag(SensorEffect):
    """s dy/dt = x - y."""

    strength: jax.Array = parameter("s", "time constant of the sensor", 0.0, 2.0, 0.0)
    key = "sensor-lag"
    typical = 0.03
    source = "estimate: 10 to 100 ms"
    confused_with = ("time-skew", "viscous-friction")

    def read(self, series: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``SensorEffect``; the implicit form has a derivative at 0."""

        def follow(y: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            value, gap = row
            y = y + (value - y) * gap / (gap + self.strength)
            return y, y

        _, rest = jax.lax.scan(follow, series[0], (series[1:], jnp.diff(time)), unroll=8)
        return jnp.append(series[:1], rest) - series
