"""Forced convection by a fan whose duty or relative speed is recorded."""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, Shapes, StageContext, WireState


class FanCooling(HeatEffect):
    """Convection coefficient h (1 + s u^n) with the recorded duty or relative speed u of a fan.

    The coefficient of a thin wire across a flow rises with the root of the velocity (King's law), n = 0.5; for a thick
    bundle or a turbulent flow n is up to 1. Nothing is added where u is 0 or not recorded.
    """

    strength: jax.Array = parameter("1", "rise of h at full speed of the fan, relative to h without it", 0.0, 50.0, 0.0)
    exponent: jax.Array = parameter("1", "exponent n with which h rises with the speed of the fan", 0.5, 1.0, 0.5)
    key = "fan-cooling"
    typical: ClassVar[float] = 2.0
    source = "King's law for n; estimate: a small fan raises h of a thin wire 2 to 5 times"
    remedy = "Record the duty or the speed of the fan as a column fan, at several levels."
    confused_with: ClassVar[tuple[str, ...]] = ("airflow-change",)
    needs: ClassVar[tuple[str, ...]] = ("fan observed",)
    surroundings: ClassVar[tuple[str, ...]] = ("fan",)
    shapes: ClassVar[Shapes] = (("exponent", (0.5, 0.75, 1.0)),)

    def power(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3; the derivative in n is 0, not NaN, where the fan is off."""
        speed = jnp.zeros(()) if state.fan is None else state.fan
        runs = speed > 0.0
        rise = jnp.where(runs, jnp.where(runs, speed, 1.0) ** self.exponent, 0.0)
        excess = state.temperature - context.environment.ambient
        return -self.strength * rise * context.heat.conductance(state.temperature, context.wire) * excess
