"""Viscous friction: damping in proportion to the speed."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, StageContext, WireState


class ViscousFriction(MechanismEffect):
    """Stress s d(contraction)/dt against the motion."""

    strength: jax.Array = parameter("Pa s", "stress in the wire per rate of contraction", 0.0, 3e9, 0.0)
    key = "viscous-friction"
    typical: ClassVar[float] = 2e8
    source = "estimate: greased guides and sheaths"
    remedy = "Move at several speeds under the same load; drain or warm the grease, or use dry bearings."
    confused_with: ClassVar[tuple[str, ...]] = ("sensor-lag",)
    needs: ClassVar[tuple[str, ...]] = ("drag",)
    has_drag = True

    def initial_memory(self, state: WireState, context: StageContext) -> tuple[jax.Array, ...]:
        """Return contraction and duration of the last two steps: no steps yet, so their durations are 0."""
        zero = jnp.zeros_like(state.contraction)
        return state.contraction, zero, state.contraction, zero

    def update_memory(
        self,
        memory: tuple[jax.Array, ...],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> tuple[jax.Array, ...]:
        """Return the contraction at the start of each of the last two steps, followed by the duration of the step."""
        return *memory[2:], before.contraction, step * jnp.ones_like(before.contraction)

    def drag(
        self,
        before: WireState,
        after: WireState,
        memory: tuple[jax.Array, ...],
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, ""]:
        """Compute the stress against contraction, Pa.

        The rate of contraction at the end of the step is that of the parabola through the last three ends of steps.
        """
        previous, gap, *_ = memory
        advances, has_previous = step > 0, gap > 0
        length, gap = jnp.where(advances, step, 1.0), jnp.where(has_previous, gap, 1.0)
        mean = (after.contraction - before.contraction) / length
        correction = (mean - (before.contraction - previous) / gap) * length / (length + gap)
        return jnp.where(advances, self.strength * (mean + jnp.where(has_previous, correction, 0.0)), 0.0)
