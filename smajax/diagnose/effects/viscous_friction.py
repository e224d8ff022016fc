"""Damping in proportion to the speed."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MechanismEffect, Where


class ViscousFriction(MechanismEffect):
    """A stress s times the rate of contraction, against the motion."""

    strength: jax.Array = parameter("Pa s", "stress in the wire per rate of contraction", 0.0, 3e9, 0.0)
    key = "viscous-friction"
    typical = 2e8
    source = "estimate: greased guides and sheaths"
    confused_with = ("sensor-lag",)
    needs = ("drag",)
    drags = True

    def start(self, instant: Instant, where: Where) -> tuple[jax.Array, ...]:
        """The contraction where the last step but one and where the last one began, each followed by the step's length."""
        nothing = jnp.zeros_like(instant.contraction)
        return instant.contraction, nothing, instant.contraction, nothing

    def remember(
        self, memory: tuple[jax.Array, ...], before: Instant, after: Instant, step: jax.Array, where: Where
    ) -> tuple[jax.Array, ...]:
        """See ``AbstractEffect``."""
        return *memory[2:], before.contraction, step * jnp.ones_like(before.contraction)

    def drag(self, before: Instant, after: Instant, memory: tuple[jax.Array, ...], step: jax.Array, where: Where) -> jax.Array:
        """See ``MechanismEffect``; the rate at the step's end is that of the parabola through the last three ends."""
        older, gap, *_ = memory
        moving, known = step > 0, gap > 0
        length, gap = jnp.where(moving, step, 1.0), jnp.where(known, gap, 1.0)
        mean = (after.contraction - before.contraction) / length
        bend = (mean - (before.contraction - older) / gap) * length / (length + gap)
        return jnp.where(moving, self.strength * (mean + jnp.where(known, bend, 0.0)), 0.0)
