"""Base class of the constitutive laws: their common parameters, strain and resistivity.

    strain                eps = sigma / E(xi) + eps_L xi_s + alpha(xi) (T - T_ref)
    Clausius-Clapeyron    A_s + sigma / C_A,  A_f + sigma / C_A,  M_s + sigma / C_M,  M_f + sigma / C_M
    resistivity           rho_e(xi) = rho_A + xi (rho_M - rho_A)

A law is written in increments: it maps the martensite fractions at the start of a step, and temperature and stress at
both ends, to the fractions at the end. Stress is the argument and strain the result: the state of a wire under a
prescribed load is explicit, and the balance of a mechanism is a monotone equation in the stress. Temperatures are in
degC, stresses in Pa (tension positive); strains and fractions are dimensionless. All methods work elementwise on arrays
of any shape.
"""

import abc
import math
from dataclasses import KW_ONLY
from typing import Any, ClassVar, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip
from smajax.parameters import CheckedModule, parameter

# Share of a transformation's band. If its progress over a step is less, it counts as constant: where nothing changes
# over a step, rounding would otherwise select the branch, possibly another one for the derivative than for the value.
# Far above rounding (1e-16), far below any effect on a fraction.
NO_PROGRESS = 1e-12


# Standard deviation sqrt(1/4 - 2/pi^2) of cosine kinetics, whose rate over the progress is pi/2 sin(pi p).
COSINE_DEVIATION = math.sqrt(0.25 - 2.0 / math.pi**2)
# Least-squares fit to the rate in the middle of normally distributed grains with cosine kinetics, with an error below
# 3e-4; tests/unit/plant/test_grains.py computes it by quadrature.
COSINE_TANGENT_FACTOR = (0.2576225, 0.16020331, -0.43259304, 0.18204334)


class Fractions(NamedTuple):
    """Martensite fractions; the rest is austenite.

    Attributes:
        detwinned: Detwinned (stress-induced) martensite xi_s, which carries transformation strain.
        twinned: Twinned (temperature-induced) martensite xi_t, without strain.
    """

    detwinned: jax.Array
    twinned: jax.Array

    @property
    def martensite(self) -> jax.Array:
        """Total martensite fraction xi = xi_s + xi_t."""
        return self.detwinned + self.twinned


class AbstractMaterial(CheckedModule):
    """Base class of the constitutive laws: their common parameters, and the quantities that follow from these alone.

    A law adds the evolution of the fractions (``evolve``), and its own parameters as further fields. It may replace the
    transformation strain of martensite that grows under a stress (``current_transformation_strain``) and the mixing
    rule of Young's modulus (``modulus``). A law with one martensite fraction is easier to derive from
    ``AbstractOneFraction``: it adds its kinetics alone.

    The Clausius-Clapeyron slopes are ``clausius_clapeyron_austenite`` C_A and ``clausius_clapeyron_martensite`` C_M:
    a stress raises the transformation temperatures of austenite by sigma / C_A, those of martensite by sigma / C_M.

    Attributes:
        obstacle_to_rates: What prevents a vector field (``smajax.simulation.vector_field``), in words that follow
            "has"; empty if there are rates.
        follows_surface: Whether the fractions change only while a driving force is at its threshold, so that they stay
            on that surface; otherwise the direction of temperature and stress decides.
        band_deviation: Standard deviation of a complete transformation over the temperature, over its width; by default
            that of cosine kinetics.
        tangent_factor: Coefficients of the powers of phi^2 in c(phi) - 1 (``smajax.plant.grains``); by default those of
            cosine kinetics.
    """

    obstacle_to_rates: ClassVar[str] = ""
    follows_surface: ClassVar[bool] = False
    band_deviation: ClassVar[float] = COSINE_DEVIATION
    tangent_factor: ClassVar[tuple[float, ...]] = COSINE_TANGENT_FACTOR
    _: KW_ONLY
    martensite_start: jax.Array = parameter("degC", "martensite start temperature at zero stress", -200.0, 600.0)
    martensite_finish: jax.Array = parameter("degC", "martensite finish temperature at zero stress", -200.0, 600.0)
    austenite_start: jax.Array = parameter("degC", "austenite start temperature at zero stress", -200.0, 600.0)
    austenite_finish: jax.Array = parameter("degC", "austenite finish temperature at zero stress", -200.0, 600.0)
    clausius_clapeyron_austenite: jax.Array = parameter(
        "Pa/K", "stress per kelvin of the reverse transformation, C_A", 1e5, 5e7
    )
    clausius_clapeyron_martensite: jax.Array = parameter(
        "Pa/K", "stress per kelvin of the forward transformation, C_M", 1e5, 5e7
    )
    modulus_austenite: jax.Array = parameter("Pa", "Young's modulus of austenite", 1e9, 2e11)
    modulus_martensite: jax.Array = parameter("Pa", "Young's modulus of martensite", 1e9, 2e11)
    max_transformation_strain: jax.Array = parameter("1", "largest transformation strain, eps_L", 1e-4, 0.12)
    resistivity_austenite: jax.Array = parameter("ohm m", "resistivity of austenite", 1e-8, 1e-5, 1.0e-6)
    resistivity_martensite: jax.Array = parameter("ohm m", "resistivity of martensite", 1e-8, 1e-5, 0.8e-6)
    thermal_expansion_austenite: jax.Array = parameter("1/K", "thermal expansion of austenite", -1e-3, 1e-3, 0.0)
    thermal_expansion_martensite: jax.Array = parameter("1/K", "thermal expansion of martensite", -1e-3, 1e-3, 0.0)
    austenite_shift: jax.Array = parameter("K", "shift of austenite start and finish together", -200.0, 200.0, 0.0)
    martensite_shift: jax.Array = parameter("K", "shift of martensite start and finish together", -200.0, 200.0, 0.0)

    def with_scaled_moduli(self, factor: Float[Array, "..."] | float) -> "AbstractMaterial":
        """Return the law with the moduli of both phases multiplied by a factor.

        Args:
            factor: The factor, such as ``AbstractWire.modulus_factor``.
        """
        scaled = (factor * self.modulus_austenite, factor * self.modulus_martensite)
        # Not a constructor: the modulus of a geometry may be beyond the bounds of Young's modulus.
        return eqx.tree_at(lambda law: (law.modulus_austenite, law.modulus_martensite), self, scaled)

    def with_bands(self, reverse: tuple[Any, Any], forward: tuple[Any, Any]) -> "AbstractMaterial":
        """Return the law of a grain, whose transformations are shifted and narrower (``smajax.plant.grains``).

        Args:
            reverse: Shift of the middle between A_s and A_f, and distance of the two, both over the distance of this
                law.
            forward: The same for M_f and M_s.
        """
        return eqx.tree_at(
            lambda law: (law.austenite_start, law.austenite_finish, law.martensite_finish, law.martensite_start),
            self,
            (
                *_band_ends(self.austenite_start, self.austenite_finish, *reverse),
                *_band_ends(self.martensite_finish, self.martensite_start, *forward),
            ),
        )

    @abc.abstractmethod
    def evolve(self, fractions: Fractions, temperature: tuple[Any, ...], stress: tuple[Any, ...]) -> Fractions:
        """Advance the fractions over a step in which temperature and stress change monotonically.

        Args:
            fractions: Fractions at the start.
            temperature: Temperatures at start and end, degC.
            stress: Stresses at start and end, Pa.

        Returns:
            Fractions at the end.
        """

    def current_transformation_strain(self, stress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the transformation strain H_cur of martensite that grows under a stress; by default eps_L.

        Args:
            stress: Stress, Pa.
        """
        return jnp.broadcast_to(self.max_transformation_strain, jnp.shape(stress))

    @property
    def forward_start(self) -> Float[Array, "..."]:
        """Temperature M_s at which the forward transformation starts at zero stress, in degC."""
        return self.martensite_start + self.martensite_shift

    def _reverse_progress(self, temperature: Float[Array, "..."], stress: Float[Array, "..."]) -> Float[Array, "..."]:
        """Progress of the reverse transformation through its band: (T - A_s - sigma / C_A) / (A_f - A_s)."""
        # The compiler moves reciprocals of parameters out of the loop over time steps, but not quotients by them.
        above = (
            temperature
            - self.austenite_start
            - self.austenite_shift
            - stress * (1.0 / self.clausius_clapeyron_austenite)
        )
        return above * (1.0 / (self.austenite_finish - self.austenite_start))

    def transformation_strain(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute the transformation strain eps_L xi_s of martensite fractions."""
        return self.max_transformation_strain * fractions.detwinned

    def strain(
        self,
        fractions: Fractions,
        temperature: Float[Array, "..."],
        stress: Float[Array, "..."],
        reference: Float[Array, "..."],
    ) -> Float[Array, "..."]:
        """Compute the strain sigma / E(xi) + eps_L xi_s + alpha(xi) (T - T_ref): elastic, transformation and thermal.

        Args:
            fractions: Martensite fractions.
            temperature: Temperature T, degC.
            stress: Stress sigma, Pa.
            reference: Temperature T_ref without thermal strain, degC.
        """
        expansion = mix(fractions.martensite, self.thermal_expansion_austenite, self.thermal_expansion_martensite)
        elastic = stress / self.modulus(fractions)
        return elastic + self.transformation_strain(fractions) + expansion * (temperature - reference)

    def modulus(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute Young's modulus in Pa, by default E(xi) = E_A + xi (E_M - E_A).

        Source: brinson1993, equation 8.
        """
        return mix(fractions.martensite, self.modulus_austenite, self.modulus_martensite)

    def resistivity(self, fractions: Fractions) -> Float[Array, "..."]:
        """Compute the electrical resistivity rho_e(xi) in ohm m, linear in the martensite fraction."""
        return mix(fractions.martensite, self.resistivity_austenite, self.resistivity_martensite)

    def installed_fractions(self, strain: Float[Array, "..."]) -> Fractions:
        """Compute the fractions of a cold, stress-free wire that was stretched to a strain: xi_s = strain / eps_L.

        Args:
            strain: The strain; above eps_L all martensite is detwinned.
        """
        detwinned = clip(strain / self.max_transformation_strain, 0.0, 1.0)
        return Fractions(detwinned, 1.0 - detwinned)


def _band_ends(
    low: jax.Array, high: jax.Array, shift: jax.Array | float, width: jax.Array | float
) -> tuple[jax.Array, jax.Array]:
    """The ends of a band after a shift of its middle and with a new width, both over its present width."""
    middle, present = 0.5 * (low + high), high - low
    return middle + (shift - 0.5 * width) * present, middle + (shift + 0.5 * width) * present


def mix(
    martensite: Float[Array, "..."], austenite_value: Float[Array, "..."], martensite_value: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Mix a property of the phases linearly in the martensite fraction.

    Args:
        martensite: Martensite fraction.
        austenite_value: Property of austenite.
        martensite_value: Property of martensite.
    """
    return austenite_value + martensite * (martensite_value - austenite_value)
