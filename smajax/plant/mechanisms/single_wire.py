"""Base classes of the mechanisms with a single wire: those that move a load, and those that only have a strain."""

import abc
from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions


class AbstractDisplacement(AbstractMechanism):
    """Base class of one wire that moves a load along a line: the displacement is the contraction in m.

    The state of the mechanism is the strain at zero displacement.
    """

    wires: ClassVar[int] = 1
    prescribed: ClassVar[tuple[str, ...]] = ()
    coordinate: ClassVar[str] = "displacement"

    @property
    def obstacle_to_rates(self) -> str:
        """Nothing: the state of the mechanism is constant."""
        return ""

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
        """Compute the displacement in m."""
        return {"displacement": context.wire.motion_per_strain * (motion - strain[0])}


class AbstractElasticLoad(AbstractDisplacement):
    """Base class of one wire that pulls on a load whose force F(x) depends on the displacement alone.

    It starts as detwinned martensite under F(0), where the displacement x is 0. The unknown is the wire's stress. A
    mechanism adds its parameters and ``force``.
    """

    unknowns = 1

    @abc.abstractmethod
    def force(self, displacement: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the force F(x) of the load in N; it should not fall as the displacement rises.

        Args:
            displacement: Displacement x, the contraction of the wire, m.
        """

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of martensite that grew under the load at displacement 0."""
        strain = material.current_transformation_strain(self.initial_unknowns(prescribed, context))
        return detwinned_fractions(material, temperature, strain)

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return the stress under the load at displacement 0."""
        return self.force(jnp.zeros((1,))) / context.wire.force_per_stress

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the unknown, or zero for a slack wire."""
        return maximum(unknown, 0.0)

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate the stress of the wire less that of the load: sigma - F(x) / A."""
        contraction = context.wire.motion_per_strain * (motion - strain)
        return unknown - self.force(contraction) / context.wire.force_per_stress


class AbstractMaterialPoint(AbstractMechanism):
    """Base class of one wire whose strain is its only motion, counted from ``wire.prestrain``; without a state."""

    wires: ClassVar[int] = 1
    coordinate: ClassVar[str] = "strain"

    @property
    def obstacle_to_rates(self) -> str:
        """Nothing: there is no state of motion."""
        return ""

    def initial_motion(self, strain: Float[Array, " wires"]) -> tuple[Any, ...]:
        """Return no state."""
        return ()

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> tuple[Any, ...]:
        """Return no state."""
        return ()

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the strain, counted from ``wire.prestrain``; a slack wire may be longer than prescribed."""
        return {"strain": strain[0] - context.wire.prestrain}
