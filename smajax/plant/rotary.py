"""Two antagonistic wires on a pulley: heating wire 1 turns the angle positive.

Strains follow the angle (rotary paper eq. 9, integrated): eps_1 = prestrain - r theta / l, eps_2 = prestrain + r theta / l. Both wires
are stress-free at angle 0. A light pulley follows the balance of forces at once: both wires then carry the same force, and the angle
between two slack wires stays where it is. With inertia or damping the rotation obeys I theta'' + c theta' + M(theta) = r (F_1 - F_2)
(eq. 10), held over a step by the generalised-alpha rule that damps what the step cannot resolve (Chung, Hulbert 1993, spectral radius 0
at infinity): second order, and equal to the light pulley as I and c go to 0. M is 0 for a pulley and m g l sin(theta) for a link.
"""

import math
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger, smaller, within
from smajax.parameters import parameter
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.mechanism import AbstractMechanism, Pulley, Surroundings, detwinned
from smajax.plant.wire import Environment

_FASTEST = 0.01  # s; a swing faster than that is so small that its damping by the rule does not show


class Link(eqx.Module):
    """A limb that hangs down from the pulley's axis at angle 0."""

    mass: jax.Array = parameter("kg", "mass of the link", 0.0, 500.0)
    centre: jax.Array = parameter("m", "distance from the axis to the link's centre of mass", 0.0, 10.0)


class LightRotary(AbstractMechanism):
    """Two wires on a pulley without inertia or damping. The unknown is their common stress."""

    pulley: Pulley
    wires, unknowns, prescribed, coordinate, beside = 2, 1, (), "angle", ("torque",)

    @property
    def metres(self) -> jax.Array:
        """See ``AbstractMechanism``: the pulley's radius."""
        return self.pulley.radius

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: detwinned by the prestrain, else twinned."""
        return detwinned(material, temperature, jnp.broadcast_to(around.wire.prestrain, temperature.shape))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((1,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.broadcast_to(larger(unknown, 0.0), (2,))

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: the strains add up to twice the prestrain, or both wires are slack."""
        return around.modulus * (0.5 * jnp.sum(strain) - around.wire.prestrain)[None] + smaller(unknown, 0.0)

    def start(self, strain: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the angle."""
        return jnp.zeros(())

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the angle stays between those at which wire 1 and wire 2 come taut, which are one while they are."""
        per_strain = around.wire.motion_per_strain / self.pulley.radius
        first = (around.wire.prestrain - strain[0]) * per_strain
        second = (strain[1] - around.wire.prestrain) * per_strain
        taut = 0.5 * (first + second)
        return jnp.where(unknown[0] < 0.0, within(motion, first, second), taut)

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: angle in rad, and the moment of the wires in N m."""
        return {"angle": motion, "torque": (stress[0] - stress[1]) * around.wire.force_per_stress * self.pulley.radius}


class AbstractTurning(AbstractMechanism):
    """Base class of pulleys with inertia, damping, or a moment that bears on them.

    The unknowns are the wires' stresses, and the angle as the stress that it makes in a wire.
    """

    pulley: eqx.AbstractVar[Pulley]
    wires, unknowns, prescribed, coordinate, beside = 2, 3, (), "angle", ("torque", "rate")

    @property
    def metres(self) -> jax.Array:
        """See ``AbstractMechanism``: the pulley's radius."""
        return self.pulley.radius

    @property
    def inertia(self) -> jax.Array:
        """Moment of inertia of all that turns, in kg m^2."""
        return self.pulley.inertia

    def moment(self, angle: jax.Array, environment: Environment) -> jax.Array | float:
        """Moment in N m that works against the angle beside inertia and damping."""
        return 0.0

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: detwinned by the prestrain, else twinned."""
        return detwinned(material, temperature, jnp.broadcast_to(around.wire.prestrain, temperature.shape))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((3,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return larger(unknown[:2], 0.0)

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: both wires' strains, and the balance of moments."""
        turned = unknown[2] / around.modulus * jnp.array([-1.0, 1.0])
        wires = around.modulus * (strain - around.wire.prestrain - turned) + smaller(unknown[:2], 0.0)
        after = self.move(unknown, strain, motion, around, step)
        moments = self.pulley.moment(motion, after, self.inertia) + self.moment(after[0], around.environment)
        pull = larger(unknown[0], 0.0) - larger(unknown[1], 0.0)
        return jnp.append(wires, moments / (self.pulley.radius * around.wire.force_per_stress) - pull)

    def start(self, strain: jax.Array) -> tuple:
        """See ``AbstractMechanism``: angle, its rate, and the rule's acceleration."""
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> tuple:
        """See ``AbstractMechanism``."""
        return self.pulley.turned(motion, unknown[2] / around.modulus * around.wire.motion_per_strain / self.pulley.radius, step)

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: angle in rad, its rate in rad/s, and the moment of the wires in N m."""
        torque = (stress[0] - stress[1]) * around.wire.force_per_stress * self.pulley.radius
        return {"angle": motion[0], "torque": torque, "rate": motion[1]}


class Rotary(AbstractTurning):
    """Two wires on a pulley with inertia or damping."""

    pulley: Pulley


class Joint(AbstractTurning):
    """Two wires, or bundles of springs, that turn a hanging link: I theta'' + c theta' + m g l sin(theta) = r (F_1 - F_2), I with m l^2."""

    pulley: Pulley
    link: Link

    def longest_step(self, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``: a twelfth of the period in which the link swings between taut wires, not below 10 ms."""
        stiffness = 2.0 * around.modulus * around.wire.force_per_stress / around.wire.motion_per_strain * self.pulley.radius**2
        return larger(_FASTEST, 2.0 * math.pi / 12.0 * jnp.sqrt(self.inertia / stiffness))

    @property
    def inertia(self) -> jax.Array:
        """See ``AbstractTurning``: the pulley's, and the link's mass at its centre."""
        return self.pulley.inertia + self.link.mass * self.link.centre**2

    def moment(self, angle: jax.Array, environment: Environment) -> jax.Array:
        """See ``AbstractTurning``: the link's weight."""
        return self.link.mass * environment.gravity * self.link.centre * jnp.sin(angle)
