"""Latent heat of the transformation: C dT/dt = ... + s dxi/dt."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import HeatEffect, StageContext, WireState


class LatentHeat(HeatEffect):
    """Latent heat s per volume: C dT/dt = ... + s dxi/dt, with xi the martensite fraction.

    The forward transformation releases heat, the reverse one absorbs it.
    """

    strength: jax.Array = parameter("J/m^3", "latent heat per volume of wire", 0.0, 4e8, 0.0)
    key = "latent-heat"
    typical: ClassVar[float] = 1.5e8
    source = "Flexinol data sheet: 5.78 cal/g at 6450 kg/m^3"
    remedy = (
        "Nothing to mend: a property of the alloy, which every heat balance of a transforming wire needs. Take it "
        "from the data sheet or from calorimetry (DSC)."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("coating", "heat-capacity")

    def enthalpy(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the stored heat -s xi, J/m^3."""
        return -self.strength * state.fractions.martensite
