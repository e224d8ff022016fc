"""Testing machine that prescribes the strain of a wire."""

from typing import Any, ClassVar

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum, minimum
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import MechanismContext, detwinned_fractions
from smajax.plant.mechanisms.single_wire import AbstractMaterialPoint


class TestingMachine(AbstractMaterialPoint):
    """One wire whose strain is prescribed, counted from ``wire.prestrain``.

    It starts stress-free, stretched to its first strain. The unknown is the wire's stress.
    """

    __test__ = False
    unknowns: ClassVar[int] = 1
    prescribed: ClassVar[tuple[str, ...]] = ("strain",)

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of a stress-free wire stretched to its first strain."""
        return detwinned_fractions(material, temperature, context.wire.prestrain + prescribed["strain"][None])

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return zero stress."""
        return jnp.zeros((1,))

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
        """Evaluate the wire's strain less the prescribed one, times the modulus."""
        return context.modulus * (strain - context.wire.prestrain - prescribed["strain"]) + minimum(unknown, 0.0)
