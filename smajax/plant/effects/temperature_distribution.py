"""Temperature distribution along the wire: ends that are colder than the middle."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState
from smajax.plant.effects.stage_context import ambient_at
from smajax.plant.materials.base import Fractions


class TemperatureDistribution(MaterialEffect):
    """Share s of the wire whose excess temperature over ambient is half that of the rest."""

    strength: jax.Array = parameter("1", "share of the wire that belongs to its cold ends", 0.0, 0.5, 0.0)
    key = "temperature-distribution"
    typical: ClassVar[float] = 0.08
    source = "two fin lengths of 4 mm on a wire of 100 mm"
    remedy = "Use a longer wire, or give the wire cells (cells under [wire]); an infrared camera shows the cold ends."
    confused_with: ClassVar[tuple[str, ...]] = ("minor-loop-shape", "end-conduction")

    def initial_memory(self, state: WireState, context: StageContext) -> Fractions:
        """Return the fractions of the ends."""
        return state.fractions

    def update_memory(
        self, memory: Fractions, before: WireState, after: WireState, step: Float[Array, ""], context: StageContext
    ) -> Fractions:
        """Return the fractions of the ends at the end of the step."""
        pairs = [(state.temperature, ambient_at(state, context)) for state in (before, after)]
        ends = tuple(ambient + 0.5 * (temperature - ambient) for temperature, ambient in pairs)
        return context.material.evolve(memory, ends, (before.stress, after.stress))

    def strain(self, state: WireState, memory: Fractions, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * (
            context.material.transformation_strain(memory) - context.material.transformation_strain(state.fractions)
        )
