"""Geometry of the wire, its surroundings, and its initial state.

A material law relates the stress and the strain of a wire in tension. A geometry converts them: ``force_per_stress``
(m^2) gives the force at the end, ``motion_per_strain`` (m) the motion of the end, and ``modulus_factor`` the elastic
modulus relative to Young's modulus. Heat balance and drive use the ``length`` and ``area`` of the wire itself. So every
law, mechanism and effect works with every geometry.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter


class AbstractWire(CheckedModule):
    """Base class of the geometries of a round wire. If a rig has several wires, all have the same geometry."""

    diameter: eqx.AbstractVar[jax.Array]
    length: eqx.AbstractVar[jax.Array]
    prestrain: eqx.AbstractVar[jax.Array]

    @property
    def area(self) -> Float[Array, "..."]:
        """Cross-section through which the current flows, in m^2."""
        return jnp.pi / 4 * self.diameter**2

    @property
    def length_between_clamps(self) -> Float[Array, "..."]:
        """Length of wire between two clamps, in m."""
        return self.length

    @property
    @abc.abstractmethod
    def force_per_stress(self) -> Float[Array, "..."]:
        """Force at the end over the stress of the material law, in m^2."""

    @property
    @abc.abstractmethod
    def motion_per_strain(self) -> Float[Array, "..."]:
        """Motion of the end over the strain of the material law, in m."""

    @property
    @abc.abstractmethod
    def modulus_factor(self) -> Float[Array, "..."] | float:
        """Elastic modulus between that stress and that strain over Young's modulus."""


class Wire(AbstractWire):
    """Straight wire in tension: stress and strain are those of the material law."""

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    length: jax.Array = parameter("m", "wire length", 1e-4, 100.0)
    prestrain: jax.Array = parameter(
        "1", "strain of the wire as installed, where the mechanism's coordinate is zero", -0.02, 0.12, 0.0
    )

    @property
    def force_per_stress(self) -> Float[Array, "..."]:
        """Cross-section in m^2."""
        return self.area

    @property
    def motion_per_strain(self) -> Float[Array, "..."]:
        """Length in m."""
        return self.length

    @property
    def modulus_factor(self) -> float:
        """One: Young's modulus itself."""
        return 1.0


class Environment(CheckedModule):
    """Air around the wire, and gravity."""

    ambient: jax.Array = parameter("degC", "temperature of the surroundings", -100.0, 300.0, 20.0)
    gravity: jax.Array = parameter("m/s^2", "gravitational acceleration", 0.0, 30.0, 9.81)


class Initial(CheckedModule):
    """State at the start of a recording; values of ``None`` are those of the rig as installed, at rest, at ambient."""

    temperature: jax.Array | None = parameter(
        "degC", "temperature of the wires at the first row", -150.0, 800.0, jnp.nan
    )
    detwinned: jax.Array | None = parameter("1", "detwinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
    twinned: jax.Array | None = parameter("1", "twinned martensite fraction at the first row", 0.0, 1.0, jnp.nan)
