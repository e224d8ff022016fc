"""Thermocouple that picks up a voltage from the heating current."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect


class ThermocouplePickup(SensorEffect):
    """Reading y = T + s i."""

    strength: jax.Array = parameter("K/A", "reading per current", -100.0, 100.0, 0.0)
    key = "thermocouple-pickup"
    typical: ClassVar[float] = 1.0
    source = "Ma 2010: the reading jumps and changes sign with the current"
    remedy = (
        "Insulate the thermocouple electrically from the wire; switch the current off for a moment: the reading "
        "must not jump."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("current-limit",)
    other_channels: ClassVar[tuple[str, ...]] = ("current",)
    needs: ClassVar[tuple[str, ...]] = ("temperature observed",)
    channel = "temperature"

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return self.strength * channels["current"]
