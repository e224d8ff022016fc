"""Gain error of the displacement or angle sensor."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect


class EncoderGain(SensorEffect):
    """Reading y = x (1 + s)."""

    strength: jax.Array = parameter("1", "relative error of the gain", -0.1, 0.1, 0.0)
    key = "encoder-gain"
    typical: ClassVar[float] = 0.01
    source = "estimate: 0.1 to 2 %"
    remedy = "Calibrate the sensor with gauge blocks or a micrometer over the whole range."
    # A gain differs from other effects only through nominal values that are not measured, such as the wire's length;
    # chosen by trial.
    absorbed_from: ClassVar[float] = 0.99

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return self.strength * series
