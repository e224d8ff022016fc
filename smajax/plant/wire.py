"""The wire's geometry, its surroundings, and the state it starts from: what several stages share.

Material laws know one stress and one strain, those of a wire in tension. What a geometry makes of them is ``force_per_stress`` (m^2) and
``motion_per_strain`` (m), and how elastic it is beside Young's modulus, ``modulus_factor``. Heat and electricity see the wire itself, with
its ``length`` and its ``area``. So every law, mechanism and effect works with every geometry.
"""

import math

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter

_MISES = math.sqrt(3.0)  # tension that von Mises holds equivalent to a shear stress, over that stress


class AbstractWire(eqx.Module):
    """Base class of the geometries of a round wire. Where a rig has several wires, they are alike."""

    diameter: eqx.AbstractVar[jax.Array]
    length: eqx.AbstractVar[jax.Array]
    prestrain: eqx.AbstractVar[jax.Array]

    @property
    def area(self) -> jax.Array:
        """Cross-section that a current flows through, in m^2."""
        return jnp.pi / 4 * self.diameter**2

    @property
    def force_per_stress(self) -> jax.Array:
        """Force at the end over the stress that the material law knows, in m^2."""
        raise NotImplementedError

    @property
    def motion_per_strain(self) -> jax.Array:
        """Motion of the end over the strain that the material law knows, in m."""
        raise NotImplementedError

    @property
    def modulus_factor(self) -> jax.Array | float:
        """Elastic modulus between that stress and that strain over Young's modulus."""
        raise NotImplementedError


class Wire(AbstractWire):
    """A straight wire, in tension: stress and strain are its own."""

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    length: jax.Array = parameter("m", "wire length", 1e-4, 100.0)
    prestrain: jax.Array = parameter("1", "strain of the wire as installed, where the mechanism's coordinate is zero", -0.02, 0.12, 0.0)

    @property
    def force_per_stress(self) -> jax.Array:
        """See ``AbstractWire``: the cross-section."""
        return self.area

    @property
    def motion_per_strain(self) -> jax.Array:
        """See ``AbstractWire``: the length."""
        return self.length

    @property
    def modulus_factor(self) -> float:
        """See ``AbstractWire``."""
        return 1.0


class Coil(AbstractWire):
    """A helical spring, its wire in torsion, or several alike side by side that pull together.

    With R the coil's mean radius, r the wire's, N turns, a force F and a stretch y, the shear stress and strain at the wire's surface are

        tau = 2 F R / (pi r^3)        gamma = r y / (2 pi R^2 N)        (knee-ankle paper, eq. 7 to 10)

    The material law sees them as the tension that von Mises holds equivalent, sigma = sqrt(3) tau and eps = gamma / sqrt(3): the same work,
    so a coil follows any law with C and eps_L as measured in tension. Elastically tau = G gamma with G = E / (2 (1 + nu)), thus
    sigma = 3 G eps, and the stiffness is F / y = G r^4 / (4 R^3 N). The stress is taken as elastic across the wire, and the coil's
    curvature as slight (no Wahl factor). Of a bundle, forces, powers and resistances are those of all its springs.
    """

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    coil_diameter: jax.Array = parameter("m", "mean diameter of the coil, from wire centre to wire centre", 1e-5, 1.0)
    turns: jax.Array = parameter("1", "active turns of one spring", 0.25, 1e4)
    poisson_ratio: jax.Array = parameter("1", "Poisson's ratio, from Young's to the shear modulus", 0.0, 0.5, 0.33)
    prestretch: jax.Array = parameter("m", "stretch of the spring as installed, where the mechanism's coordinate is zero", -0.1, 10.0, 0.0)
    springs: jax.Array = parameter("1", "springs side by side that pull together", 1.0, 1e3, 1.0, whole=True)
    paths: jax.Array = parameter(
        "1", "ways side by side for the current: 1 where all springs of a bundle are in series", 1.0, 1e3, 1.0, whole=True
    )
    free_length: jax.Array | None = parameter("m", "length of the spring without load; its turns have to fit in", 1e-5, 10.0, math.nan)

    @property
    def prestrain(self) -> jax.Array:
        """Strain as installed, as the material law knows it."""
        return self.prestretch / self.motion_per_strain

    @property
    def area(self) -> jax.Array:
        """See ``AbstractWire``: of all paths together."""
        return self.paths * jnp.pi / 4 * self.diameter**2

    @property
    def length(self) -> jax.Array:
        """Length of wire along one path, in m."""
        return self.springs / self.paths * jnp.pi * self.coil_diameter * self.turns

    @property
    def force_per_stress(self) -> jax.Array:
        """See ``AbstractWire``: pi r^3 / (2 sqrt(3) R), times the springs."""
        return self.springs * jnp.pi * self.diameter**3 / (8.0 * _MISES * self.coil_diameter)

    @property
    def motion_per_strain(self) -> jax.Array:
        """See ``AbstractWire``: 2 sqrt(3) pi R^2 N / r."""
        return _MISES * jnp.pi * self.coil_diameter**2 * self.turns / self.diameter

    @property
    def modulus_factor(self) -> jax.Array:
        """See ``AbstractWire``: 3 G / E."""
        return 1.5 / (1.0 + self.poisson_ratio)

    @property
    def solid_length(self) -> jax.Array:
        """Length of the spring with its turns side by side, in m."""
        return self.turns * self.diameter

    @property
    def fits(self) -> jax.Array:
        """Whether there is room for the wire: inside the coil, and for the turns in the free length, if that is known."""
        room = self.diameter < self.coil_diameter
        return room if self.free_length is None else room & (self.solid_length <= self.free_length)


class Environment(eqx.Module):
    """The air around the wire, and gravity."""

    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 20.0)
    gravity: jax.Array = parameter("m/s^2", "gravitational acceleration", 0.0, 30.0, 9.81)


class Initial(eqx.Module):
    """The state in which a recording starts. What is ``None`` follows from the rig: at rest, at ambient, as installed."""

    temperature: jax.Array | None = parameter("degC", "temperature of the wires at the first row", -150.0, 800.0, jnp.nan)
    detwinned: jax.Array | None = parameter("1", "detwinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
    twinned: jax.Array | None = parameter("1", "twinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
