"""Material in internal stress fields, which transforms at higher temperatures than the rest."""

import equinox as eqx
import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MaterialEffect, Where
from smajax.plant.material.base import AbstractMaterial, Fractions


class InternalStress(MaterialEffect):
    """In a share s of the material, internal stresses of all sizes up to one worth ``reach`` favour the detwinned martensite.

    There the reverse transformation ends, and the forward one begins, ``reach`` K higher, while their other ends stay.
    """

    strength: jax.Array = parameter("1", "share of the material in internal stress fields", 0.0, 0.5, 0.0)
    reach: jax.Array = parameter("K", "how much wider both bands are there", 5.0, 300.0, 60.0)
    key = "internal-stress"
    typical = 0.1
    source = "estimate: 5 to 20 % of a trained wire; training leaves internal stress (Bo, Lagoudas 1999)"
    confused_with = ("temperature-distribution", "minor-loop-shape", "r-phase")
    shapes = (("reach", (30.0, 120.0)),)

    def _widened(self, material: AbstractMaterial) -> AbstractMaterial:
        low = self.reach * material.clausius_clapeyron_martensite  # pyright: ignore[reportAttributeAccessIssue]
        wide = eqx.tree_at(lambda m: m.austenite_finish, material, replace_fn=lambda finish: finish + self.reach)
        return eqx.tree_at(lambda m: m.detwinning_start_stress, wide, replace_fn=lambda start: start - low)

    def start(self, instant: Instant, where: Where) -> Fractions:
        """The fractions of that share."""
        return instant.fractions

    def remember(self, memory: Fractions, before: Instant, after: Instant, step: jax.Array, where: Where) -> Fractions:
        """See ``AbstractEffect``."""
        return self._widened(where.material).evolve(memory, (before.temperature, after.temperature), (before.stress, after.stress))

    def strain(self, now: Instant, memory: Fractions, where: Where) -> jax.Array:
        """See ``MaterialEffect``."""
        return self.strength * (where.material.strain_of(memory) - where.material.strain_of(now.fractions))
