"""Mechanisms: what the wires pull on, and the balance that their stresses must keep.

A mechanism states its balance as equations in a few unknowns at the end of a step, all in Pa, each rising with its unknown; ``stress``
turns the unknowns into the wires' stresses. A wire cannot push. An unknown stress may go below zero all the same: the wire's own stress
is then zero, and the negative part measures how slack it hangs, as the stress that would be needed to take the slack up elastically. So
slack and taut are one equation. Contraction is positive displacement; strains and stresses are positive in tension.
"""

import math
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger, smaller
from smajax.parameters import parameter
from smajax.plant.effect import AbstractEffect
from smajax.plant.material.base import AbstractMaterial, Fractions
from smajax.plant.wire import AbstractWire, Environment


class Load(eqx.Module):
    """A mass that hangs on the wire."""

    mass: jax.Array = parameter("kg", "hanging mass", 0.0, 1e4)


class Spring(eqx.Module):
    """A linear spring that the wire stretches further as it contracts."""

    stiffness: jax.Array = parameter("N/m", "stiffness of the bias spring", 0.0, 1e7)
    preload: jax.Array = parameter("N", "force of the spring at the start", 0.0, 1e5)


class Pulley(eqx.Module):
    """A pulley on which two wires pull against each other."""

    radius: jax.Array = parameter("m", "radius at which the wires act", 1e-5, 1.0)
    inertia: jax.Array = parameter("kg m^2", "moment of inertia of all that turns", 0.0, 100.0, 0.0)
    damping: jax.Array = parameter("N m s/rad", "viscous damping of the rotation", 0.0, 1e4, 0.0)

    def turned(self, motion: tuple, angle: jax.Array, step: jax.Array) -> tuple:
        """Angle, its rate and the rule's acceleration after a step that ends at ``angle``, ``motion`` being those at its start.

        The generalised-alpha rule with alpha_m = -1, alpha_f = 0, beta = 1, gamma = 3/2.
        """
        before, rate, acceleration = motion
        moving = step > 0
        safe = jnp.where(moving, step, 1.0)
        new = (angle - before - safe * rate + 0.5 * safe**2 * acceleration) / safe**2
        new = jnp.where(moving, new, acceleration)
        return angle, rate + step * (1.5 * new - 0.5 * acceleration), new

    def moment(self, before: tuple, after: tuple, inertia: jax.Array) -> jax.Array:
        """I theta'' + c theta' in N m at the end of a step between two motions, by the same rule; ``inertia`` is all that turns, kg m^2."""
        return inertia * (2.0 * after[2] - before[2]) + self.damping * after[1]


class Surroundings(NamedTuple):
    """What a mechanism needs of the other parts of the plant: wire, surroundings, and the modulus that scales its equations (Pa)."""

    wire: AbstractWire
    environment: Environment
    modulus: jax.Array


class AbstractMechanism(eqx.Module):
    """Base class of the mechanisms: ``wires`` wires, ``unknowns`` unknowns, and the recorded channels ``prescribed`` that it follows.

    What can be measured at it is its ``coordinate`` and the channels ``beside``.
    """

    wires: eqx.AbstractClassVar[int]
    unknowns: eqx.AbstractClassVar[int]
    prescribed: eqx.AbstractClassVar[tuple[str, ...]]
    coordinate: eqx.AbstractClassVar[str]
    beside: ClassVar[tuple[str, ...]] = ()

    @property
    def effects(self) -> tuple[AbstractEffect, ...]:
        """The effects that the mechanism always has, such as the warmth of a sheath."""
        return ()

    @property
    def sticks(self) -> bool:
        """Whether it has dry friction of its own: the last equation then turns from flat (sliding) to steep (sticking) and back."""
        return False

    @property
    def metres(self) -> jax.Array | float:
        """Motion of the wire's end in m per unit of the coordinate."""
        return 1.0

    @property
    def parallel(self) -> jax.Array | float:
        """How many wires, each like the one that the plant has, pull side by side; channels are those of one."""
        return 1.0

    def longest_step(self, around: Surroundings) -> jax.Array | float:
        """The longest step in s that resolves the mechanism's own motion; infinite where it follows the forces at once."""
        return math.inf

    def contraction(self, strain: jax.Array) -> jax.Array:
        """The motion that a drag works against, as a strain: of wire 1, or of wire 1 against wire 2; scalar."""
        return -strain[0] if self.wires == 1 else 0.5 * (strain[1] - strain[0])

    def dragged(self, stress: jax.Array, drag: jax.Array) -> jax.Array:
        """The wires' stresses if a drag of ``drag`` Pa works against the contraction; a wire cannot push."""
        share = jnp.ones(1) if self.wires == 1 else jnp.array([0.5, -0.5])
        return larger(stress + share * drag, 0.0)

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """Fractions of the wires (each of shape ``(wires,)``) as installed, at their start temperature."""
        raise NotImplementedError

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """Stress of each wire, shape ``(wires,)``."""
        raise NotImplementedError

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """Residual of the equilibrium in Pa, shape ``(unknowns,)``, zero where the step ends."""
        raise NotImplementedError

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """The unknowns at the start, shape ``(unknowns,)``."""
        raise NotImplementedError

    def start(self, strain: jax.Array) -> Any:
        """What the mechanism remembers from step to step (a pytree), from the wires' strain at the start."""
        raise NotImplementedError

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> Any:
        """What the mechanism remembers at the end of a step."""
        raise NotImplementedError

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """What can be measured at the mechanism, by channel name, scalars; its ``coordinate`` is among them."""
        raise NotImplementedError


def detwinned(material: AbstractMaterial, temperature: jax.Array, strain: jax.Array) -> Fractions:
    """Cold, stress-free and drawn out to ``strain``, then brought to ``temperature``."""
    cold, slack = jnp.full_like(temperature, -1e4), jnp.zeros_like(temperature)
    return material.evolve(material.installed(strain), (cold, temperature), (slack, slack))


class DeadWeight(AbstractMechanism):
    """One vertical wire lifting a hanging mass; it starts as detwinned martensite, and displacement is counted from there."""

    load: Load
    wires, unknowns, prescribed, coordinate = 1, 0, (), "displacement"

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: as grown under its load."""
        return detwinned(material, temperature, material.grown_strain(self.stress(temperature, prescribed, around)))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((0,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``: m g / A."""
        return (self.load.mass * around.environment.gravity / around.wire.force_per_stress)[None]

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: nothing to solve."""
        return jnp.zeros((0,))

    def start(self, strain: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the strain from which displacement is counted."""
        return strain[0]

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``."""
        return motion

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: the contraction in m."""
        return {"displacement": around.wire.motion_per_strain * (motion - strain[0])}


class BiasSpring(AbstractMechanism):
    """One wire pulling on a linear spring, F = preload + stiffness x; it starts as detwinned martensite under the preload."""

    spring: Spring
    wires, unknowns, prescribed, coordinate = 1, 1, (), "displacement"

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``: as grown under the preload."""
        return detwinned(material, temperature, material.grown_strain(self.unloaded(prescribed, around)))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``: the preload over the cross-section."""
        return (self.spring.preload / around.wire.force_per_stress)[None]

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return larger(unknown, 0.0)

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: the wire's stress against the spring's."""
        contraction = around.wire.motion_per_strain * (motion - strain)
        return unknown - (self.spring.preload + self.spring.stiffness * contraction) / around.wire.force_per_stress

    def start(self, strain: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``: the strain from which displacement is counted."""
        return strain[0]

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> jax.Array:
        """See ``AbstractMechanism``."""
        return motion

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: the contraction in m."""
        return {"displacement": around.wire.motion_per_strain * (motion - strain[0])}


class TestingMachine(AbstractMechanism):
    """One wire whose strain is prescribed (counted from ``wire.prestrain``); it starts stress-free, drawn out to its first strain."""

    __test__ = False
    wires, unknowns, prescribed, coordinate = 1, 1, ("strain",), "strain"

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``."""
        return detwinned(material, temperature, around.wire.prestrain + prescribed["strain"][None])

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((1,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return larger(unknown, 0.0)

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: the wire's strain against the prescribed one."""
        return around.modulus * (strain - around.wire.prestrain - prescribed["strain"]) + smaller(unknown, 0.0)

    def start(self, strain: jax.Array) -> tuple:
        """See ``AbstractMechanism``: nothing."""
        return ()

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> tuple:
        """See ``AbstractMechanism``."""
        return ()

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: the prescribed strain (a slack wire's own may be larger)."""
        return {"strain": strain[0] - around.wire.prestrain}


class StressPath(AbstractMechanism):
    """A material point led along a prescribed stress; it starts as if cooled from austenite under its first stress."""

    wires, unknowns, prescribed, coordinate = 1, 0, ("stress",), "strain"

    def fractions(self, material: AbstractMaterial, temperature: jax.Array, prescribed: dict, around: Surroundings) -> Fractions:
        """See ``AbstractMechanism``."""
        hot, nothing = jnp.full_like(temperature, 1e4), jnp.zeros_like(temperature)
        stress = jnp.broadcast_to(prescribed["stress"], temperature.shape)
        return material.evolve(Fractions(nothing, nothing), (hot, temperature), (stress, stress))

    def unloaded(self, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return jnp.zeros((0,))

    def stress(self, unknown: jax.Array, prescribed: dict, around: Surroundings) -> jax.Array:
        """See ``AbstractMechanism``."""
        return prescribed["stress"][None]

    def balance(
        self, unknown: jax.Array, strain: jax.Array, motion: Any, prescribed: dict, around: Surroundings, step: jax.Array
    ) -> jax.Array:
        """See ``AbstractMechanism``: nothing to solve."""
        return jnp.zeros((0,))

    def start(self, strain: jax.Array) -> tuple:
        """See ``AbstractMechanism``: nothing."""
        return ()

    def move(self, unknown: jax.Array, strain: jax.Array, motion: Any, around: Surroundings, step: jax.Array) -> tuple:
        """See ``AbstractMechanism``."""
        return ()

    def channels(self, strain: jax.Array, stress: jax.Array, motion: Any, around: Surroundings) -> dict[str, jax.Array]:
        """See ``AbstractMechanism``: the strain."""
        return {"strain": strain[0] - around.wire.prestrain}
