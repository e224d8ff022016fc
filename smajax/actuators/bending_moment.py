"""Bending of a round wire that yields: moment, and work stored by yielding, in closed form.

The stress-strain curve is bilinear and odd: slope E up to the yield stress, the tangent modulus B beyond. Across a wire
of radius R bent to the curvature k the strain is k y. With u the elastic share of the radius, y_yield = u R = sigma_Y /
(E k), everything follows from three moments of the part that yields, the two caps beyond u,

    A_n(u) = integral of 4 y^n sqrt(1 - y^2) from u to 1,        A_n' = -4 u^n sqrt(1 - u^2)

    M_elastic = E k R^4 (A_2(0) - A_2(u))                                                                  (equation 2)
    M_plastic = (1 - B/E) sigma_Y R^3 A_1(u) + B k R^4 A_2(u)                                              (equation 3)

Source: dauksher2021, equations 1 to 3, with factors collected. Below yield u stays at 1, where the published equations
contain the arcsine of a number above 1.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.materials.brinson import Brinson


def _half_width(share: jax.Array | float) -> jax.Array:
    """sqrt(1 - u^2), with derivative 0 at u = 1 instead of an infinite one."""
    is_inside = share < 1.0
    return jnp.where(is_inside, jnp.sqrt(jnp.where(is_inside, 1.0 - share**2, 1.0)), 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def cap_moment(order: int, share: jax.Array | float) -> jax.Array:
    """Return the cap moment A_n(u) of order n = 0, 1 or 2 for shares u of 0..1, elementwise."""
    half_width = _half_width(share)
    if order == 1:
        return 4.0 / 3.0 * half_width**3
    angle = jnp.arccos(share)
    if order == 0:
        return 2.0 * (angle - share * half_width)
    return 0.5 * (angle + share * half_width * (1.0 - 2.0 * share**2))


@cap_moment.defjvp
def _cap_moment_jvp(order: int, primals: tuple, tangents: tuple) -> tuple:
    (share,), (tangent,) = primals, tangents
    return cap_moment(order, share), -4.0 * share**order * _half_width(share) * tangent


class BilinearStressStrain(eqx.Module):
    """Bilinear stress-strain curve of the wire while it is bent: elastic, then hardening.

    All methods work elementwise on arrays of one shape: diameters in m, curvatures in 1/m. Moments have the sign of the
    curvature. Source: dauksher2021, equation 1.
    """

    modulus: jax.Array = parameter("Pa", "Young's modulus E before yield", 1e9, 3e11)
    tangent_modulus: jax.Array = parameter("Pa", "slope B of the curve beyond yield", 0.0, 3e11)
    yield_stress: jax.Array = parameter("Pa", "stress at which detwinning begins", 1e6, 3e9)

    @classmethod
    def from_brinson(cls, material: Brinson, temperature: float | jax.Array) -> "BilinearStressStrain":
        """Return the curve of an austenitic wire at a temperature (degC) above the martensite start temperature.

        It is straight from the start of the stress-induced transformation to its end. Source: brinson1993.
        """
        rise = material.clausius_clapeyron_martensite * (temperature - material.forward_start)
        start, finish = material.detwinning_start_stress + rise, material.detwinning_finish_stress + rise
        stretch = (
            finish / material.modulus_martensite
            + material.max_transformation_strain
            - start / material.modulus_austenite
        )
        return cls(material.modulus_austenite, (finish - start) / stretch, start)

    @property
    def softens(self) -> jax.Array:
        """Whether the curve is no steeper beyond yield than before."""
        return self.tangent_modulus <= self.modulus

    def yield_diameter(self, curvature: jax.Array | float) -> jax.Array:
        """Return the largest diameter that stays elastic at a curvature, m: 2 sigma_Y / (E k)."""
        return 2.0 * self.yield_stress / (self.modulus * jnp.abs(curvature))

    def elastic_share(self, diameter: jax.Array | float, curvature: jax.Array | float) -> jax.Array:
        """Return u, the share of the radius that stays elastic: 1 up to yield; NaN for a curve that does not soften."""
        yield_strain, surface_strain = self.yield_stress / self.modulus, 0.5 * diameter * jnp.abs(curvature)
        yields = surface_strain > yield_strain
        share = jnp.where(yields, yield_strain / jnp.where(yields, surface_strain, 1.0), 1.0)
        return jnp.where(self.softens, share, jnp.nan)

    def elastic_moment(self, diameter: jax.Array | float, curvature: jax.Array | float) -> jax.Array:
        """Return the part of the moment that the elastic core carries, N m.

        Source: dauksher2021, equation 2.
        """
        caps = cap_moment(2, self.elastic_share(diameter, curvature))
        return self.modulus * curvature * (0.5 * diameter) ** 4 * (0.25 * jnp.pi - caps)

    def plastic_moment(self, diameter: jax.Array | float, curvature: jax.Array | float) -> jax.Array:
        """Return the part of the moment that the yielding caps carry, N m.

        Source: dauksher2021, equation 3.
        """
        share, radius = self.elastic_share(diameter, curvature), 0.5 * diameter
        constant = (1.0 - self.tangent_modulus / self.modulus) * self.yield_stress * radius**3 * cap_moment(1, share)
        return jnp.sign(curvature) * constant + self.tangent_modulus * curvature * radius**4 * cap_moment(2, share)

    def moment(self, diameter: jax.Array | float, curvature: jax.Array | float) -> jax.Array:
        """Return the bending moment of one wire, N m."""
        return self.elastic_moment(diameter, curvature) + self.plastic_moment(diameter, curvature)

    def plastic_work(self, diameter: jax.Array | float, curvature: jax.Array | float) -> jax.Array:
        """Return the work per length of wire that bending has put into yielding, J/m, without the elastic part.

        Beyond yield, at a strain e = k (y - y_yield) above the yield strain, the density of the whole work less that of
        the elastic stress is (1 - B/E) (sigma_Y e + B e^2 / 2), here integrated over the caps.
        """
        share, radius, bend = self.elastic_share(diameter, curvature), 0.5 * diameter, jnp.abs(curvature)
        area, first, second = (cap_moment(order, share) for order in (0, 1, 2))
        strain = bend * radius**3 * (first - share * area)
        squared = bend**2 * radius**4 * (second - 2.0 * share * first + share**2 * area)
        return (1.0 - self.tangent_modulus / self.modulus) * (
            self.yield_stress * strain + 0.5 * self.tangent_modulus * squared
        )
