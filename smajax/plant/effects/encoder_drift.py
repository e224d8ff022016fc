"""Drift of the displacement or angle sensor."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect


class EncoderDrift(SensorEffect):
    """Reading y = x + s t."""

    strength: jax.Array = parameter("m/s", "drift of the reading", -1e-3, 1e-3, 0.0)
    key = "encoder-drift"
    typical: ClassVar[float] = 2e-6
    source = "estimate: a displacement or angle that drifts with time"
    remedy = (
        "Record for minutes without heating: the drift of a sensor goes on, the wire rests. Let the sensor warm "
        "up, and zero it before each recording."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("ratcheting",)
    needs: ClassVar[tuple[str, ...]] = ("clock",)

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return self.strength * (time - time[0])
