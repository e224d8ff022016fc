"""Grains whose transformation temperatures differ: the wire transforms gradually, with tails on either side."""

import jax
import jax.numpy as jnp
import numpy as np

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where
from smajax.plant.material.base import Fractions

_SHARES = (np.arange(8) + 0.5) / 8
_PLACES = np.log(_SHARES / (1.0 - _SHARES))[:, None]  # of a logistic distribution of width 1


class GradualTransformation(MaterialEffect):
    """A share s of the wire consists of grains whose transformation temperatures are spread about the law's."""

    strength: jax.Array = parameter("1", "share of the wire that transforms gradually", 0.0, 1.0, 0.0)
    width: jax.Array = parameter("K", "width of the logistic distribution of the grains' temperatures", 1.0, 40.0, 8.0)
    key = "gradual-transformation"
    typical = 0.3
    source = "isobaric cycles of actuator wire, rounded at all four corners (experiments/measured_isobaric.py)"
    confused_with = ("temperature-distribution", "minor-loop-shape", "stress-dependent-strain")
    needs = ("prescribed strain or stress",)  # its grains make every step dearer, and a free motion shows them badly
    shapes = (("width", (5.0, 12.0)),)

    def start(self, instant: Instant, where: Where) -> Fractions:
        """The fractions of the grains, shape ``(8, wires)``."""
        return jax.tree.map(lambda f: jnp.broadcast_to(f[None], (len(_PLACES), *f.shape)), instant.fractions)

    def remember(self, memory: Fractions, before: Instant, after: Instant, step: jax.Array, where: Where) -> Fractions:
        """See ``AbstractEffect``."""
        temperatures = tuple(i.temperature[None] + self.width * _PLACES for i in (before, after))
        stresses = tuple(jnp.broadcast_to(i.stress[None], t.shape) for i, t in zip((before, after), temperatures, strict=True))
        return where.material.evolve(memory, temperatures, stresses)

    def strain(self, now: Instant, memory: Fractions, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        gradual = jnp.mean(where.material.strain_of(memory), axis=0)
        return self.strength * (gradual - where.material.strain_of(now.fractions))
