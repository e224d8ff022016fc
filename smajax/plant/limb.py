"""A limb turned by wires through a tendon and a pulley: an elbow, a wrist, a finger (flexible-actuator paper).

``count`` wires alike pull in parallel. Their contraction is multiplied by ``ratio`` on its way (2 behind a pulley that doubles it), and
their force divided by it:

    theta = ratio l (eps_0 - eps) / r        count A sigma_joint r / ratio = I theta'' + c theta' + M(theta)

sigma_joint is what the sheath's friction lets through of the wires' stress (``smajax.plant.sheath``), eps_0 the strain at angle 0, and
M the moment of gravity and spring. Past the height where gravity's moment is largest the load falls as the wires contract, and faster than
they relax: the limb then runs ahead of the balance, held by inertia and damping alone. So one of the two belongs into such a rig.
"""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger, smaller
from smajax.parameters import parameter
from smajax.plant.effect import AbstractEffect, engaged
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.mechanism import AbstractMechanism, Pulley, Surroundings, detwinned
from smajax.plant.sheath import Liner, Sheath


class Limb(eqx.Module):
    """What the wires lift: M(theta) = m g a sin(theta + tilt) + stiffness theta + preload, positive where it draws the wires out."""

    mass: jax.Array = parameter("kg", "mass of the limb", 0.0, 1e3)
    lever: jax.Array = parameter("m", "distance of the limb's centre of mass from the joint", 0.0, 10.0)
    tilt: jax.Array = parameter("rad", "angle between the limb and straight down at angle 0", -3.2, 3.2, 0.0)
    stiffness: jax.Array = parameter("N m/rad", "stiffness of joint and return spring", 0.0, 1e4, 0.0)
    preload: jax.Array = parameter("N m", "moment of the return spring at angle 0", 0.0, 1e4, 0.0)

    def moment(self, angle: jax.Array, gravity: jax.Array) -> jax.Array:
        """Moment in N m against the wires at an angle in rad."""
        weight = self.mass * gravity * self.lever * jnp.sin(angle + self.tilt)
        return weight + self.stiffness * angle + self.preload


class Transmission(eqx.Module):
    """How many wires pull, and how their motion reaches the pulley."""

    count: jax.Array = parameter(
        "1", "number of wires that pull in parallel, each driven as the recording says", 1e-2, 1e4, 1.0, whole=True
    )
    ratio: jax.Array = parameter("1", "motion at the pulley over contraction of the wires", 1e-3, 1e3, 1.0)


class TendonLimb(AbstractMechanism):
    """Wires that turn a limb; it starts at rest at angle 0, its wires drawn out to the prestrain and then loaded.

    The unknown is the wires' stress.
    """

    limb: Limb
    pulley: Pulley
    transmission: Transmission
    sheath: Sheath | None = None
    wires, unknowns, prescribed, coordinate, beside = 1, 1, (), "angle", ("torque",)

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        """See ``AbstractMechanism``: the sheath's heat."""
        return (Liner(self.sheath.conduction, self.sheath.time_constant),) if self.sheath else ()

    @property
    def sticks(self) -> bool:
        """See ``AbstractMechanism``: in a sheath."""
        return self.sheath is not None

    @property
    def metres(self) -> jax.Array:
        """See ``AbstractMechanism``: the pulley's radius over the ratio."""
        return self.pulley.radius / self.transmission.ratio

    @property
    def parallel(self) -> jax.Array:
        """See ``AbstractMechanism``."""
        return self.transmission.count

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: detwinned by the prestrain, else twinned, then under the limb's load."""
        drawn = detwinned(material, temperature, jnp.broadcast_to(around.wire.prestrain, temperature.shape))
        load = self.stress(self.unloaded(prescribed, around), prescribed, around)
        return material.evolve(drawn, (temperature, temperature), (jnp.zeros_like(load), load))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``: the load at angle 0."""
        return larger(self._stress_under(self.limb.moment(jnp.zeros(()), around.environment.gravity), around), 0.0)[None]

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return larger(unknown, 0.0)

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: the wires' pull against the limb's moments; in no time the limb does not move."""
        after = self.move(unknown, strain, motion, around, step)
        moment = self.pulley.moment(motion[3:], after[3:], self.pulley.inertia) + self.limb.moment(after[3], around.environment.gravity)
        passed = self.sheath.passed(after[2]) if self.sheath else 1.0
        pull = larger(unknown, 0.0) * passed - self._stress_under(moment, around)
        stands = around.modulus * (motion[3] - after[3]) * self.metres / around.wire.motion_per_strain
        return jnp.where(step > 0, pull, stands)

    def start(self, strain: jax.Array) -> tuple:
        """See ``AbstractMechanism``: strain at angle 0, strain, friction's engagement, angle, its rate, the rule's acceleration."""
        return strain[0], strain[0], *(jnp.zeros(()) for _ in range(4))

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> tuple:
        """See ``AbstractMechanism``; a slack wire lets the limb be."""
        installed, before, z, *turning = motion
        slack = smaller(unknown[0], 0.0) / around.modulus
        angle = (installed - strain[0] - slack) * around.wire.motion_per_strain / self.metres
        return installed, strain[0], engaged(z, before - strain[0]), *self.pulley.turned(tuple(turning), angle, step)

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: angle in rad, and the moment in N m that turns the limb."""
        _, _, _, angle, rate, acceleration = motion
        inertial = self.pulley.inertia * acceleration + self.pulley.damping * rate
        return {"angle": angle, "torque": inertial + self.limb.moment(angle, around.environment.gravity)}

    def _stress_under(self, moment: jax.Array, around: Surroundings) -> jax.Array:
        """Stress of each wire at the joint that balances a moment."""
        return moment / (self.transmission.count * around.wire.force_per_stress * self.metres)
