"""A tendon that has to come taut before anything moves."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import MechanismEffect

_LEAST = 0.005  # of the range


class Slack(MechanismEffect):
    """x - s tanh(x / s): the first s of the motion is lost."""

    strength: jax.Array = parameter("m", "motion that is lost before the tendon is taut", 0.0, 5e-3, 0.0)
    key = "slack"
    typical = 2e-4
    source = "estimate: 0.1 to 0.5 mm"
    confused_with = ("backlash", "r-phase")
    needs = ("displacement",)

    def carry(self, motion: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``MechanismEffect``."""
        span = jnp.maximum(self.strength, jax.lax.stop_gradient(_LEAST * (jnp.max(motion) - jnp.min(motion))) + 1e-300)
        return -self.strength * jnp.tanh(motion / span)
