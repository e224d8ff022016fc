"""Stress path: a material point under prescribed temperatures and stresses."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import MechanismContext
from smajax.plant.mechanisms.single_wire import AbstractMaterialPoint

# degC. Above every transformation temperature that a rig file accepts (600 degC), also at the largest stress.
_HOT = 1e4


class StressPath(AbstractMaterialPoint):
    """Material point under a prescribed stress; it starts as if cooled from austenite under its first stress."""

    unknowns: ClassVar[int] = 0
    prescribed: ClassVar[tuple[str, ...]] = ("stress",)

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions after cooling from austenite under the first stress."""
        hot, zero = jnp.full_like(temperature, _HOT), jnp.zeros_like(temperature)
        stress = jnp.broadcast_to(prescribed["stress"], temperature.shape)
        return material.evolve(Fractions(zero, zero), (hot, temperature), (stress, stress))

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return no unknowns."""
        return jnp.zeros((0,))

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the prescribed stress."""
        return prescribed["stress"][None]

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Return no residual: the stress is prescribed."""
        return jnp.zeros((0,))
