"""What every constitutive law has and answers.

A law is written in increments: given the state at the start of a step and temperature and stress at both ends, it gives the state at the
end. Stress is the argument and strain the answer, so that a wire under a known load needs no solving, and the mechanism's balance is a
monotone equation in the stress. Temperatures are in degC, stresses in Pa (tension positive), strains and fractions are pure numbers. All
methods work elementwise on arrays of any shape.
"""

import dataclasses
from typing import NamedTuple

import equinox as eqx
import jax

from smajax.kinks import within
from smajax.parameters import parameter


class Fractions(NamedTuple):
    """Detwinned (stress-induced) and twinned (temperature-induced) martensite fractions; the rest is austenite."""

    detwinned: jax.Array
    twinned: jax.Array

    @property
    def martensite(self) -> jax.Array:
        """The whole martensite fraction."""
        return self.detwinned + self.twinned


class AbstractMaterial(eqx.Module):
    """Base class of the constitutive laws (temperatures in degC): the parameters that all of them have, and what follows from these alone.

    A law of its own says how the fractions ``evolve``, which strain grows under a stress, and how the phases share the modulus.
    """

    martensite_start: jax.Array = parameter("degC", "martensite start temperature at zero stress", -200.0, 600.0)
    martensite_finish: jax.Array = parameter("degC", "martensite finish temperature at zero stress", -200.0, 600.0)
    austenite_start: jax.Array = parameter("degC", "austenite start temperature at zero stress", -200.0, 600.0)
    austenite_finish: jax.Array = parameter("degC", "austenite finish temperature at zero stress", -200.0, 600.0)
    clausius_clapeyron_austenite: jax.Array = parameter("Pa/K", "stress per kelvin of the reverse transformation, C_A", 1e5, 5e7)
    clausius_clapeyron_martensite: jax.Array = parameter("Pa/K", "stress per kelvin of the forward transformation, C_M", 1e5, 5e7)
    modulus_austenite: jax.Array = parameter("Pa", "Young's modulus of austenite", 1e9, 2e11)
    modulus_martensite: jax.Array = parameter("Pa", "Young's modulus of martensite", 1e9, 2e11)
    max_strain: jax.Array = parameter("1", "largest transformation strain, eps_L", 1e-4, 0.12)
    resistivity_austenite: jax.Array = parameter("ohm m", "resistivity of austenite", 1e-8, 1e-5, 1.0e-6)
    resistivity_martensite: jax.Array = parameter("ohm m", "resistivity of martensite", 1e-8, 1e-5, 0.8e-6)
    thermal_expansion_austenite: jax.Array = parameter("1/K", "thermal expansion of austenite", -1e-3, 1e-3, 0.0)
    thermal_expansion_martensite: jax.Array = parameter("1/K", "thermal expansion of martensite", -1e-3, 1e-3, 0.0)
    austenite_shift: jax.Array = parameter("K", "shift of austenite start and finish together", -200.0, 200.0, 0.0)
    martensite_shift: jax.Array = parameter("K", "shift of martensite start and finish together", -200.0, 200.0, 0.0)

    def stiffened(self, factor: jax.Array | float) -> "AbstractMaterial":
        """The law with both phases' moduli multiplied by a factor."""
        moduli = {"modulus_austenite": factor * self.modulus_austenite, "modulus_martensite": factor * self.modulus_martensite}
        return dataclasses.replace(self, **moduli)

    def evolve(self, fractions: Fractions, temperature: tuple, stress: tuple) -> Fractions:
        """The fractions after a step in which temperature and stress go from the first to the second of each pair, monotonically."""
        raise NotImplementedError

    def grown_strain(self, stress: jax.Array) -> jax.Array:
        """Transformation strain of martensite that grows under a stress."""
        raise NotImplementedError

    @property
    def forward_start(self) -> jax.Array:
        """Temperature at which the forward transformation starts at zero stress, degC."""
        return self.martensite_start + self.martensite_shift

    def strain_of(self, fractions: Fractions) -> jax.Array:
        """Transformation strain of the fractions alone: eps_L xi_s."""
        return self.max_strain * fractions.detwinned

    def strain(self, fractions: Fractions, temperature: jax.Array, stress: jax.Array, reference: jax.Array) -> jax.Array:
        """Elastic, transformation and thermal strain: sigma / E(xi) + eps_L xi_s + alpha(xi) (T - reference)."""
        expansion = mix(fractions.martensite, self.thermal_expansion_austenite, self.thermal_expansion_martensite)
        return stress / self.modulus(fractions) + self.strain_of(fractions) + expansion * (temperature - reference)

    def modulus(self, fractions: Fractions) -> jax.Array:
        """Young's modulus in Pa."""
        raise NotImplementedError

    def resistivity(self, fractions: Fractions) -> jax.Array:
        """Electrical resistivity, linear in the martensite fraction, Ohm m."""
        return mix(fractions.martensite, self.resistivity_austenite, self.resistivity_martensite)

    def installed(self, strain: jax.Array) -> Fractions:
        """The fractions of a cold, stress-free wire that was drawn out to ``strain``: detwinned as far as needed, the rest twinned."""
        detwinned = within(strain / self.max_strain, 0.0, 1.0)
        return Fractions(detwinned, 1.0 - detwinned)


def mix(martensite: jax.Array, austenite_value: jax.Array, martensite_value: jax.Array) -> jax.Array:
    """A property of the phases, linear in the martensite fraction."""
    return austenite_value + martensite * (martensite_value - austenite_value)
