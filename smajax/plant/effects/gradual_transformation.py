"""Gradual transformation: grains with distributed transformation temperatures."""

from typing import ClassVar

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect, Shapes, StageContext, WireState
from smajax.plant.materials.base import Fractions

# Eight grains at the middles of equal shares; chosen by trial, tests/unit/plant/test_effects.py holds it.
_QUANTILES = (np.arange(8) + 0.5) / 8
# Their places on a logistic distribution of width 1: the inverse of its cumulative distribution.
_OFFSETS = np.log(_QUANTILES / (1.0 - _QUANTILES))[:, None]


class GradualTransformation(MaterialEffect):
    """Share s of the wire that consists of grains whose transformation temperatures scatter about those of the law.

    The curve of strain over temperature gets tails on both sides.
    """

    strength: jax.Array = parameter("1", "share of the wire that transforms gradually", 0.0, 1.0, 0.0)
    width: jax.Array = parameter("K", "width of the logistic distribution of the grains' temperatures", 1.0, 40.0, 8.0)
    key = "gradual-transformation"
    typical: ClassVar[float] = 0.3
    source = "isobaric cycles of actuator wire, rounded at all four corners (experiments/measured/isobaric.py)"
    remedy = (
        "It is a property of the wire; partial loops determine it. Give the material grains (grains under "
        "[material]) where loops inside the main one matter."
    )
    confused_with: ClassVar[tuple[str, ...]] = (
        "temperature-distribution",
        "minor-loop-shape",
        "stress-dependent-strain",
    )
    # The grains make every step expensive, and a free motion hardly identifies them.
    needs: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)
    shapes: ClassVar[Shapes] = (("width", (5.0, 12.0)),)

    def initial_memory(self, state: WireState, context: StageContext) -> Fractions:
        """Return the fractions of the grains, shape ``(8, wires)``."""
        return jax.tree.map(lambda f: jnp.broadcast_to(f[None], (len(_OFFSETS), *f.shape)), state.fractions)

    def update_memory(
        self, memory: Fractions, before: WireState, after: WireState, step: Float[Array, ""], context: StageContext
    ) -> Fractions:
        """Return the fractions of the grains at the end of the step."""
        temperatures = tuple(at.temperature[None] + self.width * _OFFSETS for at in (before, after))
        stresses = tuple(
            jnp.broadcast_to(at.stress[None], t.shape) for at, t in zip((before, after), temperatures, strict=True)
        )
        return context.material.evolve(memory, temperatures, stresses)

    def strain(self, state: WireState, memory: Fractions, context: StageContext) -> Float[Array, " wires"]:
        """Compute the added strain."""
        gradual = jnp.mean(context.material.transformation_strain(memory), axis=0)
        return self.strength * (gradual - context.material.transformation_strain(state.fractions))
