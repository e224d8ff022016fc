"""What every constitutive law answers.

A law is written in increments: given the state at the start of a step and temperature and stress at both ends, it gives the state at the
end. Stress is the argument and strain the answer, so that a wire under a known load needs no solving, and the mechanism's balance is a
monotone equation in the stress. Temperatures are in degC, stresses in Pa (tension positive), strains and fractions are pure numbers. All
methods work elementwise on arrays of any shape.
"""

from typing import NamedTuple

import equinox as eqx
import jax


class Fractions(NamedTuple):
    """Detwinned (stress-induced) and twinned (temperature-induced) martensite fractions; the rest is austenite."""

    detwinned: jax.Array
    twinned: jax.Array

    @property
    def martensite(self) -> jax.Array:
        """The whole martensite fraction."""
        return self.detwinned + self.twinned


class AbstractMaterial(eqx.Module):
    """Base class of the constitutive laws (temperatures in degC)."""

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """The fractions after a step in which temperature and stress go from the first to the second of each pair, monotonically."""
        raise NotImplementedError

    def grown_strain(self, stress: jax.Array) -> jax.Array:
        """Transformation strain of martensite that grows under a stress."""
        raise NotImplementedError

    @property
    def forward_start(self) -> jax.Array:
        """Temperature at which the forward transformation starts at zero stress, degC."""
        raise NotImplementedError

    def strain_of(self, fractions: Fractions) -> jax.Array:
        """Transformation strain of the fractions alone."""
        raise NotImplementedError

    def strain(self, fractions: Fractions, temperature: jax.Array, stress: jax.Array, reference: jax.Array) -> jax.Array:
        """Total strain at a stress; thermal strain is counted from the temperature ``reference``."""
        raise NotImplementedError

    def modulus(self, fractions: Fractions) -> jax.Array:
        """Young's modulus in Pa."""
        raise NotImplementedError

    def resistivity(self, fractions: Fractions) -> jax.Array:
        """Electrical resistivity in Ohm m."""
        raise NotImplementedError

    def installed(self, strain: jax.Array) -> Fractions:
        """The fractions of a cold, stress-free wire that was drawn out to ``strain``: detwinned as far as needed, the rest twinned."""
        raise NotImplementedError


def mix(martensite: jax.Array, austenite_value: jax.Array, martensite_value: jax.Array) -> jax.Array:
    """A property of the phases, linear in the martensite fraction."""
    return austenite_value + martensite * (martensite_value - austenite_value)
