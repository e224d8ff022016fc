"""Initial set: strain from before the recording that the first heating removes."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState


class InitialSet(MaterialEffect):
    """Strain s r, with r the share of the first row's martensite that has not yet transformed to austenite."""

    strength: jax.Array = parameter(
        "1", "strain from before the recording that the first heating removes", -0.02, 0.02, 0.0
    )
    key = "initial-set"
    typical: ClassVar[float] = 0.002
    source = (
        "a soft arm (public recordings bu-softlimb): its rest shape moves by 1 to 3 of 15 deg with the first pulse "
        "and not again"
    )
    remedy = "Run a few full cycles before the recording, and start each recording from the same state."
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting", "creep")

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the remaining share: 1."""
        return jnp.ones_like(state.temperature)

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the remaining share r at the end of the step."""
        first, last = before.fractions.martensite, after.fractions.martensite
        heating = last < first
        return memory * jnp.where(heating, last / jnp.where(heating, first, 1.0), 1.0)

    def strain(self, state: WireState, memory: Float[Array, " wires"], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * memory
