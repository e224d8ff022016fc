"""Thermometer that lags the specimen whose temperature it records."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, Shapes, StageContext, WireState


class SpecimenLag(HeatEffect):
    """Specimen that is s g above its prescribed temperature, with dg = (sign(dT) - g) |dT| / width.

    A thermometer of time constant tau reads r tau too little while the specimen is heated at a rate r, and r tau too
    much while it is cooled. Recordings of a path have no clock; of a furnace with a constant rate, s is r tau. The sign
    of the direction, g, changes over a path of the width after each reversal. With s < 0 the specimen lags the sensor.
    """

    strength: jax.Array = parameter("K", "specimen above reading while it is heated", -15.0, 15.0, 0.0)
    width: jax.Array = parameter("K", "change of temperature after which the lag is reversed", 0.1, 50.0, 2.0)
    key = "specimen-lag"
    typical: ClassVar[float] = 1.0
    source = "estimate: a time constant of 5 to 20 s at 5 to 10 K/min"
    remedy = "Heat and cool more slowly, or put the thermometer on the specimen: the lag falls with the rate."
    confused_with: ClassVar[tuple[str, ...]] = ("hysteresis-widening",)
    needs: ClassVar[tuple[str, ...]] = ("prescribed temperature",)
    shapes: ClassVar[Shapes] = (("width", (1.0, 4.0, 16.0)),)
    obstacle_to_rates = "a thermometer that lags the specimen"

    def initial_memory(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Return the sign of the direction at the first row: 0, at rest."""
        return jnp.zeros_like(state.temperature)

    def update_memory(
        self,
        memory: Float[Array, " wires"],
        before: WireState,
        after: WireState,
        step: Float[Array, ""],
        context: StageContext,
    ) -> Float[Array, " wires"]:
        """Return the sign of the direction at the end of the step, which changes gradually: -1 to 1."""
        change = after.temperature - before.temperature
        direction = jnp.sign(change)
        return direction + (memory - direction) * jnp.exp(-jnp.abs(change) / self.width)

    def specimen_offset(self, memory: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Compute the temperature of the specimen above its reading, K."""
        return self.strength * memory
