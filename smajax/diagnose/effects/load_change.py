"""A load that changes along the way, such as a weight on an arm."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MechanismEffect, Where

_STROKE = 0.04  # contraction to which the strength refers


class LoadChange(MechanismEffect):
    """Load + s per 4 % of contraction from the start."""

    strength: jax.Array = parameter("Pa", "change of the load, as stress in the wire, over a contraction of 4 %", -2e8, 4e8, 0.0)
    key = "load-change"
    typical = 3e7
    source = "estimate: the lever arm of a weight changes along the way"
    confused_with = ("bias-nonlinearity",)
    needs = ("drag",)
    drags = True

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The contraction at the first row."""
        return instant.contraction

    def drag(self, before: Instant, after: Instant, memory: jax.Array, step: jax.Array, where: Where) -> jax.Array:
        """See ``MechanismEffect``."""
        return self.strength * (after.contraction - memory) / _STROKE
