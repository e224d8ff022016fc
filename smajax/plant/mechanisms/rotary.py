"""Two antagonistic wires on a pulley: heating wire 1 turns the angle positive.

The strains follow the angle, and both wires are stress-free at angle 0:

    eps_1 = prestrain - r theta / l        eps_2 = prestrain + r theta / l

A massless pulley is always in equilibrium: both wires carry the same force, and between two slack wires the angle does
not change. With inertia or damping the rotation obeys

    I theta'' + c theta' + M(theta) = r (F_1 - F_2)

M is 0 for a pulley and m g l sin(theta) for a link. The equation is integrated by the generalised-alpha rule
(chung1993) with spectral radius 0 at infinite frequency, which damps motions that the step does not resolve. It is of
second order, and becomes the massless pulley as I and c go to 0.

Source: fast_rotary_actuator, equations 9 (integrated) and 10.
"""

import math
from typing import Any, ClassVar

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum, minimum
from smajax.parameters import CheckedModule, parameter
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions
from smajax.plant.mechanisms.pulley import Pulley, zero_inertia_obstacle
from smajax.plant.wire import Environment

# s. Oscillations that this step does not resolve are so small that their damping by the integration rule is irrelevant.
# Chosen by trial.
_SHORTEST_LIMIT = 0.01
# Steps per period of the link's free oscillation. Chosen by trial.
_STEPS_PER_PERIOD = 12.0


class Link(CheckedModule):
    """Limb that hangs down from the axis of the pulley at angle 0."""

    mass: jax.Array = parameter("kg", "mass of the link", 0.0, 500.0)
    centre: jax.Array = parameter("m", "distance from the axis to the link's centre of mass", 0.0, 10.0)


class AbstractRotary(AbstractMechanism):
    """Base class of two antagonistic wires on a pulley, stretched to the prestrain at angle 0."""

    pulley: eqx.AbstractVar[Pulley]

    @property
    def wire_motion_per_coordinate(self) -> Float[Array, "..."]:
        """Motion of the wire's end in m per rad: the radius of the pulley."""
        return self.pulley.radius

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions of wires stretched to the prestrain: detwinned by it, the rest twinned."""
        prestrain = jnp.broadcast_to(context.wire.prestrain, temperature.shape)
        return detwinned_fractions(material, temperature, prestrain)

    def torque(self, stress: Float[Array, "2"], context: MechanismContext) -> Float[Array, ""]:
        """Compute the moment of the wires on the pulley, r (F_1 - F_2).

        Args:
            stress: Stresses of the wires, Pa.
            context: Wire, environment and scale.

        Returns:
            Moment in N m.
        """
        return (stress[0] - stress[1]) * context.wire.force_per_stress * self.pulley.radius


class MasslessRotary(AbstractRotary):
    """Two wires on a pulley without inertia or damping. The unknown is their common stress; the motion is the angle."""

    pulley: Pulley
    wires: ClassVar[int] = 2
    unknowns: ClassVar[int] = 1
    prescribed: ClassVar[tuple[str, ...]] = ()
    coordinate: ClassVar[str] = "angle"
    extra_channels: ClassVar[tuple[str, ...]] = ("torque",)

    @property
    def obstacle_to_rates(self) -> str:
        """The range of angles in which both wires are slack."""
        return "play between two slack wires"

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return zero stress."""
        return jnp.zeros((1,))

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the unknown in both wires, or zero for slack wires."""
        return jnp.broadcast_to(maximum(unknown, 0.0), (2,))

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate the mean strain less the prestrain, times the modulus, or the slack of both wires."""
        return context.modulus * (0.5 * jnp.sum(strain) - context.wire.prestrain)[None] + minimum(unknown, 0.0)

    def initial_motion(self, strain: Float[Array, " wires"]) -> Float[Array, ""]:
        """Return the angle 0."""
        return jnp.zeros(())

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, ""]:
        """Compute the angle: that of both wires if they are taut, else limited to the range in which both are slack."""
        per_strain = context.wire.motion_per_strain / self.pulley.radius
        first = (context.wire.prestrain - strain[0]) * per_strain
        second = (strain[1] - context.wire.prestrain) * per_strain
        taut = 0.5 * (first + second)
        return jnp.where(unknown[0] < 0.0, clip(motion, first, second), taut)

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the angle in rad, and the moment of the wires in N m."""
        return {"angle": motion, "torque": self.torque(stress, context)}


class AbstractInertialRotary(AbstractRotary):
    """Base class of pulleys with inertia, damping, or a moment that acts on them.

    The unknowns are the stresses of the wires, and the angle as an elastic stress in a wire. The state of the mechanism
    consists of the angle, its rate and the acceleration (``Pulley.step``).
    """

    wires: ClassVar[int] = 2
    unknowns: ClassVar[int] = 3
    prescribed: ClassVar[tuple[str, ...]] = ()
    coordinate: ClassVar[str] = "angle"
    extra_channels: ClassVar[tuple[str, ...]] = ("torque", "rate")
    inertial: ClassVar[bool] = True

    @property
    def obstacle_to_rates(self) -> str:
        """An inertia of 0; empty otherwise."""
        return zero_inertia_obstacle(self.inertia)

    @property
    def inertia(self) -> Float[Array, "..."]:
        """Moment of inertia of all rotating parts, in kg m^2."""
        return self.pulley.inertia

    def moment(self, angle: Float[Array, ""], environment: Environment) -> Float[Array, ""] | float:
        """Compute the moment M(theta) in N m that opposes the angle; by default 0.

        Args:
            angle: Angle theta, rad.
            environment: Gravity and air.
        """
        return 0.0

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Return zero stresses and angle 0."""
        return jnp.zeros((3,))

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the unknown stresses, or zero for slack wires."""
        return maximum(unknown[:2], 0.0)

    def balance(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> Float[Array, " unknowns"]:
        """Evaluate both wires' strains less those at the angle, and the balance of moments."""
        strain_of_angle = unknown[2] / context.modulus * jnp.array([-1.0, 1.0])
        wires = context.modulus * (strain - context.wire.prestrain - strain_of_angle) + minimum(unknown[:2], 0.0)
        after = self.update_motion(unknown, strain, motion, context, step)
        moments = self.pulley.moment(motion, after, self.inertia) + self.moment(after[0], context.environment)
        pull = maximum(unknown[0], 0.0) - maximum(unknown[1], 0.0)
        return jnp.append(wires, moments / (self.pulley.radius * context.wire.force_per_stress) - pull)

    def balance_at_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Float[Array, " unknowns"]:
        """Evaluate both wires' strains less those at the angle of the motion, and the angle less that of the motion."""
        angle = context.modulus * motion[0] * self.pulley.radius / context.wire.motion_per_strain
        balance = self.balance(unknown, strain, motion, prescribed, context, jnp.zeros(()))
        return jnp.append(balance[:2], unknown[2] - angle)

    def complete_motion(
        self, unknown: Float[Array, " unknowns"], strain: Float[Array, " wires"], motion: Any, context: MechanismContext
    ) -> tuple[Any, ...]:
        """Compute the acceleration under the moments of the wires, the damping, and M."""
        angle, rate, _ = motion
        moment = self.torque(maximum(unknown[:2], 0.0), context) - self.moment(angle, context.environment)
        return angle, rate, self.pulley.acceleration(rate, moment, self.inertia)

    def motion_rates(self, motion: Any) -> tuple[Any, ...]:
        """Return the rates of angle and rate; that of the acceleration, which follows from the stresses, is 0."""
        _, rate, acceleration = motion
        return rate, acceleration, jnp.zeros(())

    def initial_motion(self, strain: Float[Array, " wires"]) -> tuple[Any, ...]:
        """Return zeros: angle, rate and acceleration."""
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> tuple[Any, ...]:
        """Compute angle, rate and acceleration at the end of a step."""
        angle = unknown[2] / context.modulus * context.wire.motion_per_strain / self.pulley.radius
        return self.pulley.step(motion, angle, step)

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the angle in rad, its rate in rad/s, and the moment of the wires in N m."""
        return {"angle": motion[0], "torque": self.torque(stress, context), "rate": motion[1]}


class Rotary(AbstractInertialRotary):
    """Two wires on a pulley with inertia or damping."""

    pulley: Pulley


class Joint(AbstractInertialRotary):
    """Two wires, or bundles of springs, that turn a hanging link.

    I theta'' + c theta' + m g l sin(theta) = r (F_1 - F_2), where I includes m l^2 of the link.
    """

    pulley: Pulley
    link: Link

    def longest_step(self, context: MechanismContext) -> Float[Array, "..."]:
        """Compute the longest step in s: a twelfth of the period in which the link oscillates between taut wires."""
        stiffness = (
            2.0
            * context.modulus
            * context.wire.force_per_stress
            / context.wire.motion_per_strain
            * self.pulley.radius**2
        )
        return maximum(_SHORTEST_LIMIT, 2.0 * math.pi / _STEPS_PER_PERIOD * jnp.sqrt(self.inertia / stiffness))

    @property
    def inertia(self) -> Float[Array, "..."]:
        """Moment of inertia in kg m^2: the pulley's, and that of the link's mass at its centre."""
        return self.pulley.inertia + self.link.mass * self.link.centre**2

    def moment(self, angle: Float[Array, ""], environment: Environment) -> Float[Array, ""]:
        """Compute the moment of the link's weight in N m."""
        return self.link.mass * environment.gravity * self.link.centre * jnp.sin(angle)
