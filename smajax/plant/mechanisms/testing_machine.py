"""A testing machine that prescribes the strain."""

from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum, minimum
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions


class TestingMachine(AbstractMechanism):
    """One wire whose strain is prescribed, counted from ``wire.prestrain``.

    It starts stress-free, stretched to its first strain. The unknown is the wire's stress.
    """

    __test__ = False
    wires, unknowns, prescribed, coordinate = 1, 1, ("strain",), "strain"

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict,
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of a stress-free wire stretched to its first strain."""
        return detwinned_fractions(material, temperature, context.wire.prestrain + prescribed["strain"][None])

    def initial_unknowns(self, prescribed: dict, context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return zero stress."""
        return jnp.zeros((1,))

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
        """Evaluate the wire's strain less the prescribed one, times the modulus."""
        return context.modulus * (strain - context.wire.prestrain - prescribed["strain"]) + minimum(unknown, 0.0)

    def initial_motion(self, strain: Float[Array, " wires"]) -> tuple:
        """Return nothing to remember."""
        return ()

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> tuple:
        """Return nothing to remember."""
        return ()

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the strain, counted from ``wire.prestrain``; that of a slack wire may exceed the prescribed one."""
        return {"strain": strain[0] - context.wire.prestrain}
