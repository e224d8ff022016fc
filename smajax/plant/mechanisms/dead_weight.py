"""Dead weight: a wire that lifts a hanging mass."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import MechanismContext, detwinned_fractions
from smajax.plant.mechanisms.single_wire import AbstractDisplacement


class Load(CheckedModule):
    """Mass that hangs on the wire."""

    mass: jax.Array = parameter("kg", "hanging mass", 0.0, 1e4)


class DeadWeight(AbstractDisplacement):
    """One vertical wire that lifts a hanging mass: sigma = m g / A.

    It starts as detwinned martensite, where the displacement is 0. There is no unknown.
    """

    load: Load
    unknowns = 0

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of martensite that grew under the load."""
        strain = material.current_transformation_strain(self._load_stress(context))
        return detwinned_fractions(material, temperature, strain)

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return no unknowns."""
        return jnp.zeros((0,))

    def _load_stress(self, context: MechanismContext) -> Float[Array, " wires"]:
        return (self.load.mass * context.environment.gravity / context.wire.force_per_stress)[None]

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Compute the stress of the load, m g / A."""
        return self._load_stress(context)

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Return no residual: the stress follows from the load."""
        return jnp.zeros((0,))
