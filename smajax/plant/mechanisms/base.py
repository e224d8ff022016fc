"""Base class of the mechanisms: what the wires pull on, and the balance that their stresses satisfy.

A mechanism states its balance as equations in a few unknowns at the end of a step, all in Pa, each increasing in its
unknown; ``stress`` converts the unknowns into the wires' stresses. A wire cannot push. An unknown stress may
nevertheless be negative: the wire's own stress is then zero, and the negative part measures how slack the wire is, as
the stress that would take the slack up elastically. So one equation holds for slack and taut wires. Contraction is
positive displacement; strains and stresses are positive in tension.
"""

import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment

# degC. Below every transformation temperature that a rig file takes (-200 degC), also at the largest stress.
_COLD = -1e4


class MechanismContext(NamedTuple):
    """What a mechanism needs of the other parts of the plant.

    Attributes:
        wire: The wire.
        environment: Its surroundings.
        modulus: Young's modulus of austenite in Pa, which scales the mechanism's equations.
    """

    wire: AbstractWire
    environment: Environment
    modulus: jax.Array


class AbstractMechanism(eqx.Module):
    """Base class of the mechanisms.

    ``wires`` and ``unknowns`` are the numbers of wires and unknowns, ``prescribed`` the recorded channels that the
    mechanism follows. ``coordinate`` names the channel of its motion, ``extra_channels`` further ones that it adds to
    those of the plant.
    """

    wires: eqx.AbstractClassVar[int]
    unknowns: eqx.AbstractClassVar[int]
    prescribed: eqx.AbstractClassVar[tuple[str, ...]]
    coordinate: eqx.AbstractClassVar[str]
    extra_channels: ClassVar[tuple[str, ...]] = ()

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        """The effects that the mechanism always has, such as the heat capacity of a sheath."""
        return ()

    @property
    def has_dry_friction(self) -> bool:
        """Whether it has dry friction of its own: its last equation then turns from flat to steep and back."""
        return False

    @property
    def wire_motion_per_coordinate(self) -> Float[Array, "..."] | float:
        """Motion of the wire's end in m per unit of the coordinate."""
        return 1.0

    @property
    def parallel_wires(self) -> Float[Array, "..."] | float:
        """Number of wires, each like the one of the plant, that pull in parallel; channels are those of one."""
        return 1.0

    def longest_step(self, context: MechanismContext) -> Float[Array, "..."] | float:
        """Compute the longest step in s that resolves the mechanism's own motion; infinite where it has no inertia."""
        return math.inf

    def contraction(self, strain: Float[Array, " wires"]) -> Float[Array, ""]:
        """Compute the motion that a drag opposes, as a strain: of wire 1, or of wire 1 against wire 2."""
        return -strain[0] if self.wires == 1 else 0.5 * (strain[1] - strain[0])

    def with_drag(self, stress: Float[Array, " wires"], drag: Float[Array, ""]) -> Float[Array, " wires"]:
        """Compute the wires' stresses in Pa where a drag opposes the contraction; a wire cannot push.

        Args:
            stress: Stresses without the drag.
            drag: The drag in Pa.
        """
        share = jnp.ones(1) if self.wires == 1 else jnp.array([0.5, -0.5])
        return maximum(stress + share * drag, 0.0)

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict,
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of the wires as installed.

        Args:
            material: The law.
            temperature: Temperatures of the wires at the start in degC.
            prescribed: Prescribed channels at the start.
            context: Wire, environment and scale.
        """
        raise NotImplementedError

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict, context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Compute the stress of each wire in Pa.

        Args:
            unknown: The unknowns in Pa.
            prescribed: Prescribed channels at the same instant.
            context: Wire, environment and scale.
        """
        raise NotImplementedError

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate the residual of the equilibrium at the end of a step in Pa.

        Args:
            unknown: The unknowns at the end in Pa.
            strain: Strains of the wires at the end.
            motion: What the mechanism remembers, at the start.
            prescribed: Prescribed channels at the end.
            context: Wire, environment and scale.
            step: Duration in s.
        """
        raise NotImplementedError

    def initial_unknowns(self, prescribed: dict, context: MechanismContext) -> Float[Array, " unknowns"]:
        """Compute the unknowns at the start in Pa.

        Args:
            prescribed: Prescribed channels at the start.
            context: Wire, environment and scale.
        """
        raise NotImplementedError

    def initial_motion(self, strain: Float[Array, " wires"]) -> Any:
        """Make what the mechanism remembers from step to step, a pytree.

        Args:
            strain: Strains of the wires at the start.
        """
        raise NotImplementedError

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Any:
        """Compute what the mechanism remembers at the end of a step; arguments as of ``balance``."""
        raise NotImplementedError

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute what can be measured at the mechanism, by channel; its ``coordinate`` is among them.

        Args:
            strain: Strains of the wires.
            stress: Stresses of the wires in Pa.
            motion: What the mechanism remembers.
            context: Wire, environment and scale.
        """
        raise NotImplementedError


def detwinned_fractions(
    material: AbstractMaterial, temperature: Float[Array, " wires"], strain: Float[Array, " wires"]
) -> Fractions:
    """Compute the fractions of a wire that was stretched while cold and stress-free, and then brought to a temperature.

    Args:
        material: The law.
        temperature: Temperatures in degC.
        strain: Strains to which the wires were stretched.
    """
    cold, zero_stress = jnp.full_like(temperature, _COLD), jnp.zeros_like(temperature)
    return material.evolve(material.installed_fractions(strain), (cold, temperature), (zero_stress, zero_stress))
