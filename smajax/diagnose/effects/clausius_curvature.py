"""Transformation temperatures that do not rise along a straight line with the stress."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where

_REFERENCE = 100e6  # Pa


class ClausiusCurvature(MaterialEffect):
    """All four transformation temperatures + s (sigma / 100 MPa)^2.

    The slope of Clausius and Clapeyron is entropy over transformation strain: where the strain grows with the stress, the lines bend.
    """

    strength: jax.Array = parameter("K", "rise of the transformation temperatures beyond a straight line, at 100 MPa", -4.0, 8.0, 0.0)
    key = "clausius-curvature"
    typical = 0.5
    source = "isobaric cycles of NiTiHf at 50 to 400 MPa, whose lines bend on heating and on cooling (experiments/measured_isobaric.py)"
    confused_with = ("stress-dependent-strain", "gradual-transformation")
    needs = ("prescribed strain or stress",)  # elsewhere the stress hardly varies apart from the transformation

    def shift(self, now: Instant, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * (now.stress / _REFERENCE) ** 2
