"""Thermocouple that conducts heat away from the wire and reads low."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect


class ThermocoupleAttachment(SensorEffect):
    """Reading y = T - s (T - T_0), with T_0 the temperature at the first row."""

    strength: jax.Array = parameter("1", "share of the excess temperature that is not measured", -0.2, 0.6, 0.0)
    key = "thermocouple-attachment"
    typical: ClassVar[float] = 0.2
    source = "estimate: 0.2 for a 75 um thermocouple on a 0.25 mm wire"
    remedy = "Use a finer thermocouple, and thermal paste between it and the wire."
    # A gain differs from other effects only through nominal values that are not measured; chosen by trial.
    absorbed_from: ClassVar[float] = 0.99
    needs: ClassVar[tuple[str, ...]] = ("temperature observed",)
    channel = "temperature"

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return -self.strength * (series - series[0])
