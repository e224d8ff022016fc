"""A draught that sets in, or ends, during the recording."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where

_RISE = 0.02  # s, so that the instant has a derivative; a slower one would blur a sudden draught that meets a wire in transformation


class AirflowChange(HeatEffect):
    """h (1 + s) from an instant on."""

    strength: jax.Array = parameter("1", "relative change of h", -0.7, 5.0, 0.0)
    instant: jax.Array = parameter("s", "time of the change, from the first row", 0.0, 1e5, 30.0)
    key = "airflow-change"
    typical = 0.3
    source = "estimate: a fan or an open door changes h by 0.2 to 5 times"
    confused_with = ("ambient-drift",)
    shapes = (("instant", (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)),)

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        on = 0.5 * (1.0 + jnp.tanh((now.time - self.instant) / _RISE))
        cooling = where.heat.conductance(now.temperature, where.wire) * (now.temperature - where.environment.ambient)
        return -self.strength * on * cooling
