"""Slack: motion that is lost before the tendon is taut."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, Shapes


class Slack(MechanismEffect):
    """Motion x - s tanh(x / l): the motion s is lost while the tendon tightens over the motion l."""

    strength: jax.Array = parameter("m", "motion that is lost before the tendon is taut", 0.0, 5e-3, 0.0)
    span: jax.Array = parameter("m", "motion over which the tendon tightens", 1e-5, 3e-3, 5e-4)
    key = "slack"
    typical: ClassVar[float] = 2e-4
    source = "estimate: 0.1 to 0.5 mm"
    remedy = "Tighten the tendon, or add a preload that keeps it taut when the wire is cold."
    confused_with: ClassVar[tuple[str, ...]] = ("backlash", "r-phase")
    needs: ClassVar[tuple[str, ...]] = ("displacement",)
    shapes: ClassVar[Shapes] = (("span", (2e-4, 1e-3, 3e-3)),)

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the added motion, in m at the wire.

        The span is at least the slack, so that the motion never reverses.
        """
        return -self.strength * jnp.tanh(motion / maximum(self.span, self.strength))
