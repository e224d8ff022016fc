"""Limb turned by wires through a tendon and a pulley: an elbow, a wrist, a finger.

``count`` equal wires pull in parallel. A transmission multiplies their contraction by ``ratio`` (2 with a pulley that
doubles it) and divides their force by it:

    theta = ratio l (eps_0 - eps) / r        count A sigma_joint r / ratio = I theta'' + c theta' + M(theta)

sigma_joint is the stress of the wires less the friction of the sheath (``smajax.plant.mechanisms.sheath``), eps_0 the
strain at angle 0, and M the moment of gravity and spring. Above the angle at which the moment of gravity is largest,
the load decreases as the wires contract, faster than their stress relaxes. The limb then moves ahead of the
equilibrium, and only inertia and damping limit its speed: such a rig needs one of the two.

Source: copaci2020 for the actuator and the elbow.
"""

from typing import Any, ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum, minimum
from smajax.parameters import CheckedModule, parameter
from smajax.plant.effects.base import AbstractEffect
from smajax.plant.effects.memory import presliding_state
from smajax.plant.materials.base import AbstractMaterial, Fractions
from smajax.plant.mechanisms.base import AbstractMechanism, MechanismContext, detwinned_fractions
from smajax.plant.mechanisms.pulley import Pulley, zero_inertia_obstacle
from smajax.plant.mechanisms.sheath import Liner, Sheath


class Limb(CheckedModule):
    """Limb that the wires lift: M(theta) = m g a sin(theta + tilt) + stiffness theta + preload.

    The moment M is positive where it stretches the wires.
    """

    mass: jax.Array = parameter("kg", "mass of the limb", 0.0, 1e3)
    lever: jax.Array = parameter("m", "distance of the limb's centre of mass from the joint", 0.0, 10.0)
    tilt: jax.Array = parameter("rad", "angle between the limb and straight down at angle 0", -3.2, 3.2, 0.0)
    stiffness: jax.Array = parameter("N m/rad", "stiffness of joint and return spring", 0.0, 1e4, 0.0)
    preload: jax.Array = parameter("N m", "moment of the return spring at angle 0", 0.0, 1e4, 0.0)

    def moment(self, angle: Float[Array, ""], gravity: Float[Array, ""]) -> Float[Array, ""]:
        """Compute the moment M(theta) against the wires.

        Args:
            angle: Angle theta, rad.
            gravity: Gravitational acceleration, m/s^2.

        Returns:
            Moment in N m.
        """
        weight = self.mass * gravity * self.lever * jnp.sin(angle + self.tilt)
        return weight + self.stiffness * angle + self.preload


class Transmission(CheckedModule):
    """Number of wires, and transmission of their motion to the pulley."""

    count: jax.Array = parameter(
        "1", "number of wires that pull in parallel, each driven as the recording says", 1e-2, 1e4, 1.0, whole=True
    )
    ratio: jax.Array = parameter("1", "motion at the pulley over contraction of the wires", 1e-3, 1e3, 1.0)


class TendonLimb(AbstractMechanism):
    """Wires that turn a limb.

    It starts at rest at angle 0, with wires that were stretched to the prestrain and then loaded. The unknown is the
    stress of the wires. The state of the mechanism consists of the strain at angle 0, the strain, the presliding state
    of the friction, and the angle, its rate and the acceleration (``Pulley.step``).
    """

    limb: Limb
    pulley: Pulley
    transmission: Transmission
    sheath: Sheath | None = None
    wires: ClassVar[int] = 1
    unknowns: ClassVar[int] = 1
    prescribed: ClassVar[tuple[str, ...]] = ()
    coordinate: ClassVar[str] = "angle"
    extra_channels: ClassVar[tuple[str, ...]] = ("torque",)
    inertial: ClassVar[bool] = True

    @property
    def obstacle_to_rates(self) -> str:
        """The friction of a sheath, or an inertia of 0; empty otherwise."""
        return "dry friction in a sheath" if self.sheath else zero_inertia_obstacle(self.pulley.inertia)

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        """The heat of the sheath's liner, if there is a sheath."""
        return (Liner(self.sheath.conductance_ratio, self.sheath.time_constant),) if self.sheath else ()

    @property
    def has_dry_friction(self) -> bool:
        """Whether there is a sheath, which has friction."""
        return self.sheath is not None

    @property
    def wire_motion_per_coordinate(self) -> Float[Array, "..."]:
        """Motion of the wire's end in m per rad: the pulley's radius over the ratio."""
        return self.pulley.radius / self.transmission.ratio

    @property
    def parallel_wires(self) -> Float[Array, "..."]:
        """Number of wires that pull in parallel."""
        return self.transmission.count

    def fractions(
        self,
        material: AbstractMaterial,
        temperature: Float[Array, " wires"],
        prescribed: dict[str, Any],
        context: MechanismContext,
    ) -> Fractions:
        """Compute the fractions after a stretch to the prestrain, the rest twinned, and then under the limb's load."""
        prestrain = jnp.broadcast_to(context.wire.prestrain, temperature.shape)
        stretched = detwinned_fractions(material, temperature, prestrain)
        load = self.stress(self.initial_unknowns(prescribed, context), prescribed, context)
        return material.evolve(stretched, (temperature, temperature), (jnp.zeros_like(load), load))

    def initial_unknowns(self, prescribed: dict[str, Any], context: MechanismContext) -> Float[Array, " unknowns"]:
        """Compute the stress under the load at angle 0, or zero where the load does not pull."""
        moment = self.limb.moment(jnp.zeros(()), context.environment.gravity)
        return maximum(self._stress_under(moment, context), 0.0)[None]

    def stress(
        self, unknown: Float[Array, " unknowns"], prescribed: dict[str, Any], context: MechanismContext
    ) -> Float[Array, " wires"]:
        """Return the unknown, or zero for slack wires."""
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
        """Evaluate the pull of the wires at the joint less the limb's moments; in a step of 0 s the limb is at rest."""
        after = self.update_motion(unknown, strain, motion, context, step)
        moment = self.pulley.moment(motion[3:], after[3:], self.pulley.inertia) + self.limb.moment(
            after[3], context.environment.gravity
        )
        ratio = self.sheath.tension_ratio(after[2]) if self.sheath else 1.0
        pull = maximum(unknown, 0.0) * ratio - self._stress_under(moment, context)
        standing = (
            context.modulus * (motion[3] - after[3]) * self.wire_motion_per_coordinate / context.wire.motion_per_strain
        )
        return jnp.where(step > 0, pull, standing)

    def complete_motion(
        self, unknown: Float[Array, " unknowns"], strain: Float[Array, " wires"], motion: Any, context: MechanismContext
    ) -> tuple[Any, ...]:
        """Compute the acceleration under the pull of the wires without friction, the damping, and M."""
        installed, _, z, angle, rate, _ = motion
        pull = maximum(unknown[0], 0.0) / self._stress_under(jnp.ones(()), context)
        moment = pull - self.limb.moment(angle, context.environment.gravity)
        return installed, strain[0], z, angle, rate, self.pulley.acceleration(rate, moment, self.pulley.inertia)

    def motion_rates(self, motion: Any) -> tuple[Any, ...]:
        """Return the rates of angle and rate; other entries are constant, or follow from strain and stress."""
        zero, (*_, rate, acceleration) = jnp.zeros(()), motion
        return zero, zero, zero, rate, acceleration, zero

    def initial_motion(self, strain: Float[Array, " wires"]) -> tuple[Any, ...]:
        """Return the strain at angle 0, the strain, and zeros: presliding state, angle, rate, acceleration."""
        return strain[0], strain[0], *(jnp.zeros(()) for _ in range(4))

    def update_motion(
        self,
        unknown: Float[Array, " unknowns"],
        strain: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
        step: Float[Array, ""],
    ) -> tuple[Any, ...]:
        """Compute the motion at the end of a step; a slack wire does not move the limb."""
        installed, before, z, *rotation = motion
        slack = minimum(unknown[0], 0.0) / context.modulus
        angle = (installed - strain[0] - slack) * context.wire.motion_per_strain / self.wire_motion_per_coordinate
        return (
            installed,
            strain[0],
            presliding_state(z, before - strain[0]),
            *self.pulley.step(tuple(rotation), angle, step),
        )

    def channels(
        self,
        strain: Float[Array, " wires"],
        stress: Float[Array, " wires"],
        motion: Any,
        context: MechanismContext,
    ) -> dict[str, Float[Array, ""]]:
        """Compute the angle in rad, and the moment in N m that turns the limb."""
        _, _, _, angle, rate, acceleration = motion
        inertial = self.pulley.inertia * acceleration + self.pulley.damping * rate
        return {"angle": angle, "torque": inertial + self.limb.moment(angle, context.environment.gravity)}

    def _stress_under(self, moment: jax.Array, context: MechanismContext) -> jax.Array:
        """Stress of each wire at the joint that balances a moment."""
        return moment / (self.transmission.count * context.wire.force_per_stress * self.wire_motion_per_coordinate)
