"""Change of the airflow during the recording: a draught that begins or ends."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip
from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, Shapes, StageContext, WireState


class AirflowChange(HeatEffect):
    """Convection coefficient h (1 + s) from an instant on."""

    strength: jax.Array = parameter("1", "relative change of h", -0.7, 5.0, 0.0)
    instant: jax.Array = parameter("s", "time of the change, from the first row", 0.0, 1e5, 30.0)
    key = "airflow-change"
    typical: ClassVar[float] = 0.3
    source = "estimate: a fan or an open door changes h by 0.2 to 5 times"
    remedy = (
        "Close doors, switch fans off or keep them on throughout, and put the wire behind a screen; a recorded "
        "fan is the effect fan-cooling."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("ambient-drift",)
    shapes: ClassVar[Shapes] = (("instant", (0.15, 0.3, 0.45, 0.6, 0.75, 0.9)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, ""]:
        """Return 1 if the changed airflow is present, else 0."""
        return jnp.where(state.time < self.instant, 0.0, 1.0)

    def begin_step(self, memory: Float[Array, ""], time: Float[Array, ""], step: Float[Array, ""]) -> Float[Array, ""]:
        """Return the share of the step with changed airflow, since a step may extend over the change."""
        return jnp.where(
            step > 0.0, clip((time + step - self.instant) / jnp.where(step > 0.0, step, 1.0), 0.0, 1.0), memory
        )

    def power(self, state: WireState, memory: Float[Array, ""], context: StageContext) -> Float[Array, " wires"]:
        """Compute the heat added to the wires, W/m^3."""
        cooling = context.heat.conductance(state.temperature, context.wire) * (
            state.temperature - context.environment.ambient
        )
        return -self.strength * memory * cooling
