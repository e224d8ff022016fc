"""A wire that pulls on a linear spring."""

from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions


class Spring(eqx.Module):
    """A linear spring that the wire stretches further as it contracts."""

    stiffness: jax.Array = parameter("N/m", "stiffness of the bias spring", 0.0, 1e7)
    preload: jax.Array = parameter("N", "force of the spring at the start", 0.0, 1e5)


class BiasSpring(AbstractMechanism):
    """One wire that pulls on a linear spring, F = preload + stiffness x.

    It starts as detwinned martensite under the preload, where the displacement x is 0. The unknown is the wire's
    stress.
    """

    spring: Spring
    wires, unknowns, prescribed, coordinate = 1, 1, (), "displacement"

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict,
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of martensite that grew under the preload."""
        strain = material.current_transformation_strain(self.initial_unknowns(prescribed, context))
        return detwinned_fractions(material, temperature, strain)

    def initial_unknowns(self, prescribed: dict, context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return the stress under the preload."""
        return (self.spring.preload / context.wire.force_per_stress)[None]

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict, context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the unknown, or zero for a slack wire."""
        return maximum(unknown, 0.0)

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate the wire's stress less that of the spring's force."""
        contraction = context.wire.motion_per_strain * (motion - strain)
        return unknown - (self.spring.preload + self.spring.stiffness * contraction) / context.wire.force_per_stress

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
