"""Clausius-Clapeyron slopes that differ between forward and reverse transformation."""

from typing import ClassVar

import equinox as eqx
import jax

from smajax.parameters import parameter
from smajax.plant.effects.base import MaterialEffect
from smajax.plant.materials.base import AbstractMaterial


class ClausiusAsymmetry(MaterialEffect):
    """Forward slope C_M (1 + s)."""

    strength: jax.Array = parameter("1", "relative excess of the forward slope C_M", -0.6, 1.0, 0.0)
    key = "clausius-asymmetry"
    typical: ClassVar[float] = 0.2
    source = "estimate: 0 to 30 %"
    remedy = "Record cycles under at least three loads: heating and cooling then have different slopes."
    confused_with: ClassVar[tuple[str, ...]] = ()

    def modify_material(self, material: AbstractMaterial) -> AbstractMaterial:
        """Return the material law with changed parameters."""
        return eqx.tree_at(
            lambda m: m.clausius_clapeyron_martensite, material, replace_fn=lambda c: c * (1.0 + self.strength)
        )
