"""R-phase: a small strain and a hump of the resistivity before the martensite."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState
from smajax.plant.materials.cosine_kinetics import cosine_remainder

# Clausius-Clapeyron slope of the R-phase in Pa/K: steeper than that of the martensite, since its strain is small. An
# estimate.
_SLOPE = 15e6
# R-phase strain to which the hump of the resistivity refers.
_REFERENCE_STRAIN = 0.01


class RPhase(MaterialEffect):
    """Strain s and a hump of the resistivity below the R-phase's start temperature.

    The R-phase forms along half a cosine of the temperature, as the martensite does. In the martensitic part of the
    wire only the share ``kept`` of its strain remains: martensite that formed from R-phase loses the strain, while
    regions of R-phase retain it.
    """

    strength: jax.Array = parameter("1", "strain of the R-phase", 0.0, 0.015, 0.0)
    above: jax.Array = parameter(
        "K", "middle of the R-phase's transformation above the martensite start temperature", -40.0, 60.0, 12.0
    )
    width: jax.Array = parameter("K", "from the R-phase's start temperature to its finish temperature", 1.0, 40.0, 10.0)
    kept: jax.Array = parameter("1", "share of its strain that remains in the martensitic part", 0.0, 1.0, 0.5)
    hump: jax.Array = parameter("1", "relative rise of the resistivity per 1 % of R-phase strain", -0.2, 0.5, 0.1)
    key = "r-phase"
    typical: ClassVar[float] = 0.006
    source = "estimate: 0.5 to 1 % of strain, 10 to 20 % of resistance"
    remedy = (
        "Record the resistance, and cool slowly from above: a hump before the martensite forms is the R-phase. "
        "Calorimetry (DSC) shows it as a separate peak."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("resistivity-temperature", "slack")
    shapes: ClassVar[Shapes] = (("above", (8.0, -10.0, 25.0)), ("width", (10.0,)), ("kept", (0.5,)), ("hump", (0.1,)))

    def _share(self, state: WireState, context: StageContext) -> jax.Array:
        middle = context.material.forward_start + self.above + state.stress / _SLOPE
        cold = 1.0 - cosine_remainder((middle - state.temperature) / self.width + 0.5, 0.0)
        return (1.0 - (1.0 - self.kept) * state.fractions.martensite) * cold

    def strain(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * self._share(state, context)

    def resistivity(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added resistivity, as a share of the resistivity."""
        return self.hump / _REFERENCE_STRAIN * self.strength * self._share(state, context)
