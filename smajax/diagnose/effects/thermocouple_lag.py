"""A thermocouple that follows slowly."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import SensorEffect


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
        """See ``SensorEffect``; the implicit form has a derivative at 0."""

        def follow(y: jax.Array, row: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
            value, gap = row
            y = y + (value - y) * gap / (gap + self.strength)
            return y, y

        _, rest = jax.lax.scan(follow, series[0], (series[1:], jnp.diff(time)), unroll=8)
        return jnp.append(series[:1], rest) - series
