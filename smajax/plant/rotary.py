"""Two antagonistic wires on a pulley: heating wire 1 turns the angle positive.

Strains follow the angle (rotary paper eq. 9, integrated): eps_1 = prestrain - r theta / l, eps_2 = prestrain + r theta / l. Both wires
are stress-free at angle 0. A light pulley follows the balance of forces at once: both wires then carry the same stress, and the angle
between two slack wires stays where it is. With inertia or damping the rotation obeys I theta'' + c theta' = r A (sigma_1 - sigma_2) (eq.
10), held over a step by the generalised-alpha rule that damps what the step cannot resolve (Chung, Hulbert 1993, spectral radius 0 at
infinity): second order, and equal to the light pulley as I and c go to 0.
"""

from typing import Any

import jax
import jax.numpy as jnp

from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.mechanism import AbstractMechanism, Pulley, Surroundings, detwinned


class LightRotary(AbstractMechanism):
    """Two wires on a pulley without inertia or damping. The unknown is their common stress."""

    pulley: Pulley
    wires, unknowns, prescribed, coordinate = 2, 1, (), "angle"

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
        return jnp.broadcast_to(jnp.maximum(unknown, 0.0), (2,))

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: the strains add up to twice the prestrain, or both wires are slack."""
        return around.modulus * (0.5 * jnp.sum(strain) - around.wire.prestrain)[None] + jnp.minimum(unknown, 0.0)

    def start(self, strain: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the angle."""
        return jnp.zeros(())

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the angle stays between those at which wire 1 and wire 2 come taut, which are one while they are."""
        per_strain = around.wire.length / self.pulley.radius
        first = (around.wire.prestrain - strain[0]) * per_strain
        second = (strain[1] - around.wire.prestrain) * per_strain
        taut = 0.5 * (first + second)
        return jnp.where(unknown[0] < 0.0, jnp.clip(motion, first, second), taut)

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: angle in rad, and the moment of the wires in N m."""
        return {"angle": motion, "torque": (stress[0] - stress[1]) * around.wire.area * self.pulley.radius}


class Rotary(AbstractMechanism):
    """Two wires on a pulley with inertia or damping.

    The unknowns are their stresses, and the angle as the stress that it makes in a wire.
    """

    pulley: Pulley
    wires, unknowns, prescribed, coordinate = 2, 3, (), "angle"

    @property
    def metres(self) -> jax.Array:
        """See ``AbstractMechanism``: the pulley's radius."""
        return self.pulley.radius

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: detwinned by the prestrain, else twinned."""
        return detwinned(material, temperature, jnp.broadcast_to(around.wire.prestrain, temperature.shape))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((3,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.maximum(unknown[:2], 0.0)

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: both wires' strains, and the balance of moments."""
        turned = unknown[2] / around.modulus * jnp.array([-1.0, 1.0])
        wires = around.modulus * (strain - around.wire.prestrain - turned) + jnp.minimum(unknown[:2], 0.0)
        _, rate, acceleration = self.move(unknown, strain, motion, around, step)
        inertial = self.pulley.inertia * (2.0 * acceleration - motion[2]) + self.pulley.damping * rate
        pull = jnp.maximum(unknown[0], 0.0) - jnp.maximum(unknown[1], 0.0)
        return jnp.append(wires, inertial / (self.pulley.radius * around.wire.area) - pull)

    def start(self, strain: jax.Array) -> tuple:
        """See ``AbstractMechanism``: angle, its rate, and the rule's acceleration."""
        return jnp.zeros(()), jnp.zeros(()), jnp.zeros(())

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> tuple:
        """See ``AbstractMechanism``: the generalised-alpha rule with alpha_m = -1, alpha_f = 0, beta = 1, gamma = 3/2."""
        angle, rate, acceleration = motion
        turned = unknown[2] / around.modulus * around.wire.length / self.pulley.radius
        moving = step > 0
        safe = jnp.where(moving, step, 1.0)
        new = (turned - angle - safe * rate + 0.5 * safe**2 * acceleration) / safe**2
        new = jnp.where(moving, new, acceleration)
        return turned, rate + step * (1.5 * new - 0.5 * acceleration), new

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: angle in rad, and the moment of the wires in N m."""
        return {"angle": motion[0], "torque": (stress[0] - stress[1]) * around.wire.area * self.pulley.radius}
