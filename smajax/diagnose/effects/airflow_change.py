"""A draught that sets in, or ends, during the recording."""

import jax
import jax.numpy as jnp

from smajax.kinks import within
from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class AirflowChange(HeatEffect):
    """h (1 + s) from an instant on."""

    strength: jax.Array = parameter("1", "relative change of h", -0.7, 5.0, 0.0)
    instant: jax.Array = parameter("s", "time of the change, from the first row", 0.0, 1e5, 30.0)
    key = "airflow-change"
    typical = 0.3
    source = "estimate: a fan or an open door changes h by 0.2 to 5 times"
    confused_with = ("ambient-drift",)
    shapes = (("instant", (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)),)

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """Whether it blows: the share of the step for which it does, so that a sudden draught that meets a transformation blurs nothing."""
        return jnp.where(instant.time < self.instant, 0.0, 1.0)

    def begin(self, memory: jax.Array, time: jax.Array, step: jax.Array) -> jax.Array:
        """See ``HeatEffect``."""
        return jnp.where(step > 0.0, within((time + step - self.instant) / jnp.where(step > 0.0, step, 1.0), 0.0, 1.0), memory)

    def power(self, now: Instant, memory: jax.Array, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        cooling = where.heat.conductance(now.temperature, where.wire) * (now.temperature - where.environment.ambient)
        return -self.strength * memory * cooling
