"""Curved Clausius-Clapeyron lines: transformation temperatures that are not linear in the stress."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, StageContext, WireState

# Stress in Pa to which the strength refers: a usual load of an actuator wire.
_REFERENCE_STRESS = 100e6


class ClausiusCurvature(MaterialEffect):
    """Shift of all four transformation temperatures by s (sigma / 100 MPa)^2.

    The Clausius-Clapeyron slope is the entropy change over the transformation strain: the lines bend if that strain
    grows with the stress.
    """

    strength: jax.Array = parameter(
        "K", "rise of the transformation temperatures beyond a straight line, at 100 MPa", -4.0, 8.0, 0.0
    )
    key = "clausius-curvature"
    typical: ClassVar[float] = 0.5
    source = (
        "isobaric cycles of NiTiHf at 50 to 400 MPa, whose lines bend on heating and on cooling "
        "(experiments/measured/isobaric.py)"
    )
    remedy = (
        "Record cycles under at least three loads that cover the stresses of use; two loads determine a straight "
        "line only."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("stress-dependent-strain", "gradual-transformation")
    # On other rigs the stress varies with the transformation only.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)

    def shift(self, state: WireState, context: StageContext) -> Float[Array, " wires"]:
        """Compute the shift of the transformation temperatures, K."""
        return self.strength * (state.stress / _REFERENCE_STRESS) ** 2
