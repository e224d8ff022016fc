"""Base class of the mechanisms: the load of the wires, and the force balance that their stresses satisfy.

A mechanism states its balance as a few equations in as many unknowns at the end of a step. All are in Pa, and each
equation increases with its unknown; ``stress`` converts the unknowns into the stresses of the wires. A wire cannot
push. An unknown stress may still be negative: the stress of the wire is then zero, and the negative part measures its
slack, as the stress that would stretch the wire elastically by that length. So one equation holds for slack and taut
wires. Contraction is positive displacement; strains and stresses are positive in tension.
"""

import abc
import dataclasses
import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters import CheckedModule, declarations, module_types
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment, Wire

# degC. Below every transformation temperature that a rig file accepts (-200 degC), also at the largest stress.
_COLD = -1e4
# Section of a rig file with the parameters that a mechanism declares itself: its field in the plant.
OWN_SECTION = "mechanism"


class MechanismContext(NamedTuple):
    """Other parts of the plant that a mechanism uses.

    Attributes:
        wire: The wire.
        environment: Its surroundings.
        modulus: Young's modulus of austenite, Pa, which scales the equations of the mechanism.
    """

    wire: AbstractWire
    environment: Environment
    modulus: jax.Array


class AbstractMechanism(CheckedModule):
    """Base class of the mechanisms.

    Attributes:
        wires: Number of wires.
        unknowns: Number of unknowns.
        prescribed: Names of the recorded channels that the mechanism follows.
        coordinate: Name of the channel of its motion.
        extra_channels: Names of further channels that it adds to those of the plant.
        inertial: Whether the state of motion has rates (``motion_rates``) from an equation of motion.
        wire_class: Geometry of the wire in a rig file.
    """

    required_attributes: ClassVar[tuple[str, ...]] = ("wires", "unknowns", "prescribed", "coordinate")
    wires: ClassVar[int]
    unknowns: ClassVar[int]
    prescribed: ClassVar[tuple[str, ...]]
    coordinate: ClassVar[str]
    extra_channels: ClassVar[tuple[str, ...]] = ()
    inertial: ClassVar[bool] = False
    wire_class: ClassVar[type[AbstractWire]] = Wire

    @classmethod
    def rig_sections(cls) -> dict[str, type[eqx.Module]]:
        """Return the classes of the parameter sections that the mechanism adds to a rig file, by section.

        A field that is a module, such as ``load: Load``, is a section of its name. Parameters that the mechanism
        declares itself are those of ``[mechanism]``.
        """
        parts = {field.name: part for field in dataclasses.fields(cls) for part in module_types(cls, field)}
        return ({OWN_SECTION: cls} if declarations(cls) else {}) | parts

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        """The effects that the mechanism always has, such as the heat capacity of a sheath."""
        return ()

    @property
    def has_dry_friction(self) -> bool:
        """Whether the mechanism itself has dry friction: its last equation then changes from flat to steep and back."""
        return False

    @property
    def wire_motion_per_coordinate(self) -> Float[Array, "..."] | float:
        """Motion of the wire's end in m per unit of the coordinate."""
        return 1.0

    @property
    def parallel_wires(self) -> Float[Array, "..."] | float:
        """Number of equal wires that pull in parallel; channels are those of one of them."""
        return 1.0

    @property
    def obstacle_to_rates(self) -> str:
        """What prevents a vector field (``smajax.simulation.vector_field``), in words that follow "has".

        It is empty if there are rates; then the state of the mechanism is constant, or ``motion_rates`` and
        ``balance_at_motion`` are given.
        """
        return "a state of motion whose rates it does not give"

    def balance_at_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Float[Array, " unknowns"]:
        """Evaluate the residual of the balance at a given state of motion in Pa: for the vector field.

        By default it is ``balance`` in a step of 0 s.

        Args:
            unknown: The unknowns, Pa.
            strain: Strains of the wires.
            motion: State of the mechanism.
            prescribed: Prescribed channels.
            context: Wire, environment and scale.
        """
        return self.balance(unknown, strain, motion, prescribed, context, jnp.zeros(()))

    def complete_motion(
        self, unknown: Float[Array, " unknowns"], strain: Float[Array, " wires"], motion: Any, context: MechanismContext
    ) -> Any:
        """Compute the state of the mechanism with the entries that follow from stresses, such as an acceleration.

        Args:
            unknown: The unknowns, Pa.
            strain: Strains of the wires.
            motion: State of the mechanism.
            context: Wire, environment and scale.
        """
        return motion

    def motion_rates(self, motion: Any) -> Any:
        """Compute the rates of a complete state of motion, per second; by default it is constant.

        Args:
            motion: State of the mechanism, as ``complete_motion`` returns it.
        """
        return jax.tree.map(jnp.zeros_like, motion)

    def longest_step(self, context: MechanismContext) -> Float[Array, "..."] | float:
        """Compute the longest step that resolves the mechanism's own motion.

        Args:
            context: Wire, environment and scale.

        Returns:
            Step in s; infinite for a mechanism without inertia.
        """
        return math.inf

    def contraction(self, strain: Float[Array, " wires"]) -> Float[Array, ""]:
        """Compute the motion that a drag opposes: the contraction of wire 1, or of wire 1 against wire 2.

        Args:
            strain: Strains of the wires.

        Returns:
            Contraction, as a strain.
        """
        return -strain[0] if self.wires == 1 else 0.5 * (strain[1] - strain[0])

    def with_drag(self, stress: Float[Array, " wires"], drag: Float[Array, ""]) -> Float[Array, " wires"]:
        """Compute the stresses of the wires with a drag that opposes the contraction; a wire cannot push.

        Args:
            stress: Stresses without the drag, Pa.
            drag: The drag, Pa.

        Returns:
            Stresses in Pa, at least 0.
        """
        share = jnp.ones(1) if self.wires == 1 else jnp.array([0.5, -0.5])
        return maximum(stress + share * drag, 0.0)

    @abc.abstractmethod
    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of the wires as installed.

        Args:
            material: The material law.
            temperature: Temperatures of the wires at the start, degC.
            prescribed: Prescribed channels at the start.
            context: Wire, environment and scale.
        """

    @abc.abstractmethod
    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Compute the stresses of the wires in Pa.

        Args:
            unknown: The unknowns, Pa.
            prescribed: Prescribed channels at the same instant.
            context: Wire, environment and scale.
        """

    @abc.abstractmethod
    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate the residual of the force balance at the end of a step in Pa.

        Args:
            unknown: The unknowns at the end, Pa.
            strain: Strains of the wires at the end.
            motion: State of the mechanism at the start.
            prescribed: Prescribed channels at the end.
            context: Wire, environment and scale.
            step: Duration, s.
        """

    @abc.abstractmethod
    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Compute the unknowns at the start in Pa.

        Args:
            prescribed: Prescribed channels at the start.
            context: Wire, environment and scale.
        """

    @abc.abstractmethod
    def initial_motion(self, strain: Float[Array, " wires"]) -> Any:
        """Return the state of the mechanism at the start, a pytree.

        Args:
            strain: Strains of the wires at the start.
        """

    @abc.abstractmethod
    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Any:
        """Compute the state of the mechanism at the end of a step.

        Args:
            unknown: The unknowns at the end, Pa.
            strain: Strains of the wires at the end.
            motion: State of the mechanism at the start.
            context: Wire, environment and scale.
            step: Duration, s.
        """

    @abc.abstractmethod
    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the channels of the mechanism.

        Args:
            strain: Strains of the wires.
            stress: Stresses of the wires, Pa.
            motion: State of the mechanism.
            context: Wire, environment and scale.

        Returns:
            ``coordinate`` and ``extra_channels`` by name, SI.
        """


def detwinned_fractions(
    material: AbstractMaterial, temperature: Float[Array, " wires"], strain: Float[Array, " wires"]
) -> Fractions:
    """Compute the fractions of a wire that was stretched while cold and stress-free, and then brought to a temperature.

    Args:
        material: The material law.
        temperature: Temperatures, degC.
        strain: Strains to which the wires were stretched.
    """
    cold, zero_stress = jnp.full_like(temperature, _COLD), jnp.zeros_like(temperature)
    return material.evolve(material.installed_fractions(strain), (cold, temperature), (zero_stress, zero_stress))
