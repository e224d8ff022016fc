"""Helical spring of shape-memory wire, as a geometry of the wire."""

import math

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.parameters import parameter
from smajax.plant.wire import AbstractWire

# Equivalent tension over shear stress, by von Mises.
_MISES = math.sqrt(3.0)


class Coil(AbstractWire):
    """Helical spring with its wire in torsion, or a bundle of equal springs that pull in parallel.

    With R the mean radius of the coil, r the radius of the wire, N turns, a force F and a stretch y, the shear stress
    and strain at the surface of the wire are

        tau = 2 F R / (pi r^3)        gamma = r y / (2 pi R^2 N)

    The material law takes the equivalent tension by von Mises, sigma = sqrt(3) tau and eps = gamma / sqrt(3). The work
    is the same, so a coil follows any law with the Clausius-Clapeyron slopes and eps_L measured in tension. In the
    elastic range tau = G gamma with G = E / (2 (1 + nu)), thus sigma = 3 G eps, and the stiffness is F / y = G r^4 / (4
    R^3 N). The stress across the wire is assumed elastic, and the curvature of the coil small (no Wahl factor). Forces,
    powers and resistances of a bundle are those of all its springs together.

    Source: hybrid_knee_ankle_orthosis, equations 7 to 10.
    """

    diameter: jax.Array = parameter("m", "wire diameter", 1e-6, 0.02)
    coil_diameter: jax.Array = parameter("m", "mean diameter of the coil, from wire centre to wire centre", 1e-5, 1.0)
    turns: jax.Array = parameter("1", "active turns of one spring", 0.25, 1e4)
    poisson_ratio: jax.Array = parameter("1", "Poisson's ratio, from Young's to the shear modulus", 0.0, 0.5, 0.33)
    prestretch: jax.Array = parameter(
        "m", "stretch of the spring as installed, where the mechanism's coordinate is zero", -0.1, 10.0, 0.0
    )
    springs: jax.Array = parameter("1", "springs side by side that pull together", 1.0, 1e3, 1.0, whole=True)
    paths: jax.Array = parameter(
        "1",
        "ways side by side for the current: 1 where all springs of a bundle are in series",
        1.0,
        1e3,
        1.0,
        whole=True,
    )
    free_length: jax.Array | None = parameter(
        "m", "length of the spring without load; its turns have to fit in", 1e-5, 10.0, math.nan
    )

    @property
    def prestrain(self) -> Float[Array, "..."]:
        """Strain of the material law as installed."""
        return self.prestretch / self.motion_per_strain

    @property
    def area(self) -> Float[Array, "..."]:
        """Cross-section of all current paths together, in m^2."""
        return self.paths * jnp.pi / 4 * self.diameter**2

    @property
    def length(self) -> Float[Array, "..."]:
        """Length of wire along one current path, in m."""
        return self.springs / self.paths * jnp.pi * self.coil_diameter * self.turns

    @property
    def length_between_clamps(self) -> Float[Array, "..."]:
        """Length of the wire of one spring, in m."""
        return jnp.pi * self.coil_diameter * self.turns

    @property
    def force_per_stress(self) -> Float[Array, "..."]:
        """Force of all springs over the equivalent tension, in m^2: springs times pi r^3 / (2 sqrt(3) R)."""
        return self.springs * jnp.pi * self.diameter**3 / (8.0 * _MISES * self.coil_diameter)

    @property
    def motion_per_strain(self) -> Float[Array, "..."]:
        """Stretch over the equivalent strain, in m: 2 sqrt(3) pi R^2 N / r."""
        return _MISES * jnp.pi * self.coil_diameter**2 * self.turns / self.diameter

    @property
    def modulus_factor(self) -> Float[Array, "..."]:
        """Elastic modulus between equivalent tension and strain over Young's modulus: 3 G / E."""
        return 1.5 / (1.0 + self.poisson_ratio)

    @property
    def solid_length(self) -> Float[Array, "..."]:
        """Length of the spring with its turns in contact, in m."""
        return self.turns * self.diameter

    @property
    def fits(self) -> Bool[Array, "..."]:
        """Whether there is room for the wire: inside the coil and, where the free length is given, for its turns."""
        room = self.diameter < self.coil_diameter
        return room if self.free_length is None else room & (self.solid_length <= self.free_length)
