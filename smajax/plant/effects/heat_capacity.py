"""Heat capacity that differs between the phases."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect


class HeatCapacity(HeatEffect):
    """Heat capacity c (1 + s (1 - xi)), with xi the martensite fraction."""

    strength: jax.Array = parameter("1", "relative excess of austenite's heat capacity", -0.5, 0.8, 0.0)
    key = "heat-capacity"
    typical: ClassVar[float] = 0.1
    source = "estimate: reported capacities differ by 0 to 15 % between the phases"
    remedy = "Nothing to mend: a property of the alloy. Calorimetry (DSC) of a piece of wire measures it."
    confused_with: ClassVar[tuple[str, ...]] = ("latent-heat",)

    def capacity(self, martensite: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Compute the added heat capacity, as a share of the capacity."""
        return self.strength * (1.0 - martensite)
