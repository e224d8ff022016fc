"""Effects of a soft arm that the catalogue does not have: its body's slow heat, and the place where it begins."""

from __future__ import annotations

from typing import ClassVar

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, Shapes, StageContext, ThermalNode, WireState


class HeatSoak(ThermalNode):
    """Body around the wire that warms slowly, and at the first row is as warm as the wire."""

    strength: jax.Array = parameter("1", "conduction into the body over convection", 0.0, 6.0, 0.0)
    time_constant: jax.Array = parameter("s", "time in which the body follows the wire", 60.0, 3000.0, 300.0)
    key = "heat-soak"
    typical: ClassVar[float] = 0.1
    source = "public recordings bu-softlimb: the wire ends 0.5 to 1.6 K above its start after 180 s of cooling"
    confused_with: ClassVar[tuple[str, ...]] = ("coating", "ambient-drift")
    shapes: ClassVar[Shapes] = (("time_constant", (150.0, 600.0)),)

    def initial_memory(self, state: WireState, context: StageContext) -> jax.Array:
        """Return the body's excess over ambient: that of the wire at the first row."""
        return state.temperature - context.environment.ambient


class InitialOffset(MechanismEffect):
    """Distance of the arm from its rest at the first row, which its own motion removes.

    x = u + s exp(-travel / stroke), with u the coordinate of the mechanism and travel the way it has gone since the
    first row.
    """

    strength: jax.Array = parameter("m", "distance from rest at the first row", -1e-3, 1e-3, 0.0)
    stroke: jax.Array = parameter("m", "way of the mechanism that removes most of it", 2e-5, 1e-2, 4e-4)
    key = "initial-offset"
    typical: ClassVar[float] = 1e-4
    source = "public recordings bu-softlimb: the arm begins 1 to 3 of 15 deg from where it later rests"
    confused_with: ClassVar[tuple[str, ...]] = ("initial-set",)
    shapes: ClassVar[Shapes] = (("stroke", (2e-4, 8e-4)),)

    def displacement(self, motion: jax.Array, channels: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """Compute the remaining distance, m at the wire."""
        travel = jnp.concatenate([jnp.zeros(1), jnp.cumsum(jnp.abs(jnp.diff(motion)))])
        return self.strength * jnp.exp(-travel / self.stroke)


ARM_EFFECTS = {effect.key: effect for effect in (HeatSoak, InitialOffset)}
