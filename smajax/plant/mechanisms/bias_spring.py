"""Bias spring: a wire that pulls on a linear spring."""

from typing import Any

import equinox as eqx
import jax
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import MechanismContext, detwinned_fractions
from smajax.plant.mechanisms.single_wire import AbstractDisplacement


class Spring(eqx.Module):
    """Linear spring, which the wire stretches as it contracts."""

    stiffness: jax.Array = parameter("N/m", "stiffness of the bias spring", 0.0, 1e7)
    preload: jax.Array = parameter("N", "force of the spring at the start", 0.0, 1e5)


class BiasSpring(AbstractDisplacement):
    """One wire that pulls on a linear spring: F = preload + stiffness x.

    It starts as detwinned martensite under the preload, where the displacement x is 0. The unknown is the wire's
    stress.
    """

    spring: Spring
    unknowns = 1

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
        """Evaluate the stress of the wire less that of the spring: sigma - (preload + stiffness x) / A."""
        contraction = context.wire.motion_per_strain * (motion - strain)
        return unknown - (self.spring.preload + self.spring.stiffness * contraction) / context.wire.force_per_stress
