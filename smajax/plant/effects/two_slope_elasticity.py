"""Elastic part of two slopes: a wire that is softer above a stress."""

from typing import Any, ClassVar

import jax
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState


class TwoSlopeElasticity(MaterialEffect):
    """Elastic strain sigma / E + s max(sigma - knee, 0): the compliance is larger by s above the stress of the knee."""

    strength: jax.Array = parameter("1/Pa", "compliance that is added above the knee", -2e-11, 4e-11, 0.0)
    knee: jax.Array = parameter("Pa", "stress above which the wire is softer", 1e6, 1e9, 150e6)
    key = "two-slope-elasticity"
    typical: ClassVar[float] = 5e-12
    source = "estimate: moduli fall by a quarter where martensite reorients in part"
    remedy = "Pull the cold wire and the hot wire in a testing machine, to the largest stress of use."
    confused_with: ClassVar[tuple[str, ...]] = ("stress-dependent-strain",)
    # On other rigs the stress varies with the transformation only.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)
    shapes: ClassVar[Shapes] = (("knee", (75e6, 150e6, 300e6)),)

    def strain(self, state: WireState, memory: tuple[Any, ...], context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        return self.strength * maximum(state.stress - self.knee, 0.0)
