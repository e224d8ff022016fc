"""A tendon that has to come taut before anything moves."""

import jax
import jax.numpy as jnp

from smajax.kinks import larger
from smajax.parameters import parameter
from smajax.plant.effect import MechanismEffect


class Slack(MechanismEffect):
    """x - s tanh(x / l): the motion s is lost while the tendon comes taut over the motion l."""

    strength: jax.Array = parameter("m", "motion that is lost before the tendon is taut", 0.0, 5e-3, 0.0)
    span: jax.Array = parameter("m", "motion over which the tendon comes taut", 1e-5, 3e-3, 5e-4)
    key = "slack"
    typical = 2e-4
    source = "estimate: 0.1 to 0.5 mm"
    confused_with = ("backlash", "r-phase")
    needs = ("displacement",)
    shapes = (("span", (2e-4, 1e-3, 3e-3)),)

    def carry(self, motion: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``MechanismEffect``; the motion never goes back, so the span is at least the slack."""
        return -self.strength * jnp.tanh(motion / larger(self.span, self.strength))
