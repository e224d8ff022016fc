"""A wire that lifts a weight."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions


class Load(eqx.Module):
    """A mass that hangs on the wire."""

    mass: jax.Array = parameter("kg", "hanging mass", 0.0, 1e4)


class DeadWeight(AbstractMechanism):
    """One vertical wire that lifts a hanging mass: sigma = m g / A.

    It starts as detwinned martensite, where the displacement is 0. There is no unknown.
    """

    load: Load
    wires, unknowns, prescribed, coordinate = 1, 0, (), "displacement"

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict,
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of martensite that grew under the load."""
        strain = material.current_transformation_strain(self._load_stress(context))
        return detwinned_fractions(material, temperature, strain)

    def initial_unknowns(self, prescribed: dict, context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return no unknowns."""
        return jnp.zeros((0,))

    def _load_stress(self, context: MechanismContext) -> Float[Array, " wires"]:
        return (self.load.mass * context.environment.gravity / context.wire.force_per_stress)[None]

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict, context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Compute the stress of the load, m g / A."""
        return self._load_stress(context)

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Return no residual: the stress follows from the load."""
        return jnp.zeros((0,))

    def initial_motion(self, strain: Float[Array, " wires"]) -> Float[Array, ""]:
        """Return the strain at zero displacement."""
        return strain[0]

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Return the strain at zero displacement unchanged."""
        return motion

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the displacement, the contraction in m."""
        return {"displacement": context.wire.motion_per_strain * (motion - strain[0])}
