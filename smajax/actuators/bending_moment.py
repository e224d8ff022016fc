"""Bending of a round wire that yields: bending moment and plastic work in closed form.

The stress-strain curve is bilinear and odd: its slope is Young's modulus E up to the yield stress sigma_Y, and the
tangent modulus B beyond. In a wire of radius R bent to the curvature k, the strain at the distance y from the neutral
axis is k y. The core is elastic up to y_yield = u R = sigma_Y / (E k), where u is the elastic share of the radius. The
two caps beyond it yield. Moment and work follow from the moments of the caps of a unit circle, for n = 0, 1, 2:

    A_n(u) = integral of 4 y^n sqrt(1 - y^2) dy from u to 1        A_n' = -4 u^n sqrt(1 - u^2)

    M_elastic = E k R^4 (A_2(0) - A_2(u))                                                                  (equation 2)
    M_plastic = (1 - B/E) sigma_Y R^3 A_1(u) + B k R^4 A_2(u)                                              (equation 3)

Source: dauksher2021, equations 1 to 3, with factors collected. Below yield u is limited to 1; the published equations
take the arcsine of a number above 1 there.
"""

from functools import partial
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.materials.brinson import Brinson


def _half_width(share: jax.Array | float) -> jax.Array:
    """sqrt(1 - u^2), with derivative 0 at u = 1 instead of an infinite one."""
    is_inside = share < 1.0
    return jnp.where(is_inside, jnp.sqrt(jnp.where(is_inside, 1.0 - share**2, 1.0)), 0.0)


def cap_moment(order: int, share: Float[Array, "..."] | float) -> Float[Array, "..."]:
    """Compute the moment A_n(u) of the caps of a unit circle, elementwise.

    Args:
        order: Order n: 0, 1 or 2.
        share: Elastic share u of the radius, 0..1, any shape.

    Returns:
        A_n(u), of the same shape, dimensionless.
    """
    return _cap_moment(order, share)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def _cap_moment(order: int, share: jax.Array | float) -> jax.Array:
    half_width = _half_width(share)
    if order == 1:
        return 4.0 / 3.0 * half_width**3
    angle = jnp.arccos(share)
    if order == 0:
        return 2.0 * (angle - share * half_width)
    return 0.5 * (angle + share * half_width * (1.0 - 2.0 * share**2))


@_cap_moment.defjvp
def _cap_moment_jvp(order: int, primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    (share,), (tangent,) = primals, tangents
    return _cap_moment(order, share), -4.0 * share**order * _half_width(share) * tangent


class BilinearStressStrain(CheckedModule):
    """Bilinear stress-strain curve of a wire in bending: elastic, then hardening.

    All methods work elementwise on arrays of one shape. Moments have the sign of the curvature.

    Source: dauksher2021, equation 1.
    """

    modulus: jax.Array = parameter("Pa", "Young's modulus E before yield", 1e9, 3e11)
    tangent_modulus: jax.Array = parameter("Pa", "slope B of the curve beyond yield", 0.0, 3e11)
    yield_stress: jax.Array = parameter("Pa", "stress at which detwinning begins", 1e6, 3e9)

    @classmethod
    def from_brinson(cls, material: Brinson, temperature: Float[Array, "..."] | float) -> "BilinearStressStrain":
        """Return the curve of an austenitic wire that transforms under stress by Brinson's law.

        Yielding is the stress-induced transformation: the curve is straight from its start to its end.

        Args:
            material: The law, which gives moduli, transformation stresses and transformation strain.
            temperature: Temperature of the wire, degC, above the martensite start temperature.

        Source: brinson1993.
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
    def softens(self) -> Bool[Array, "..."]:
        """Whether the slope beyond yield is at most Young's modulus."""
        return self.tangent_modulus <= self.modulus

    def yield_diameter(self, curvature: Float[Array, "..."] | float) -> Float[Array, "..."]:
        """Compute the largest wire diameter that stays elastic at a curvature: 2 sigma_Y / (E k).

        Args:
            curvature: Curvature k, 1/m.

        Returns:
            Diameter in m.
        """
        return 2.0 * self.yield_stress / (self.modulus * jnp.abs(curvature))

    def elastic_share(
        self, diameter: Float[Array, "..."] | float, curvature: Float[Array, "..."] | float
    ) -> Float[Array, "..."]:
        """Compute the elastic share u of the radius.

        Args:
            diameter: Diameter of the wire, m.
            curvature: Curvature k, 1/m.

        Returns:
            u, 0..1: 1 below yield; NaN if the curve does not soften.
        """
        yield_strain, surface_strain = self.yield_stress / self.modulus, 0.5 * diameter * jnp.abs(curvature)
        yields = surface_strain > yield_strain
        share = jnp.where(yields, yield_strain / jnp.where(yields, surface_strain, 1.0), 1.0)
        return jnp.where(self.softens, share, jnp.nan)

    def elastic_moment(
        self, diameter: Float[Array, "..."] | float, curvature: Float[Array, "..."] | float
    ) -> Float[Array, "..."]:
        """Compute the bending moment of the elastic core, M_elastic = E k R^4 (A_2(0) - A_2(u)).

        Args:
            diameter: Diameter of the wire, m.
            curvature: Curvature k, 1/m.

        Returns:
            Moment in N m.

        Source: dauksher2021, equation 2.
        """
        caps = cap_moment(2, self.elastic_share(diameter, curvature))
        return self.modulus * curvature * (0.5 * diameter) ** 4 * (0.25 * jnp.pi - caps)

    def plastic_moment(
        self, diameter: Float[Array, "..."] | float, curvature: Float[Array, "..."] | float
    ) -> Float[Array, "..."]:
        """Compute the bending moment of the yielding caps, M_plastic = (1 - B/E) sigma_Y R^3 A_1(u) + B k R^4 A_2(u).

        Args:
            diameter: Diameter of the wire, m.
            curvature: Curvature k, 1/m.

        Returns:
            Moment in N m.

        Source: dauksher2021, equation 3.
        """
        share, radius = self.elastic_share(diameter, curvature), 0.5 * diameter
        constant = (1.0 - self.tangent_modulus / self.modulus) * self.yield_stress * radius**3 * cap_moment(1, share)
        return jnp.sign(curvature) * constant + self.tangent_modulus * curvature * radius**4 * cap_moment(2, share)

    def moment(
        self, diameter: Float[Array, "..."] | float, curvature: Float[Array, "..."] | float
    ) -> Float[Array, "..."]:
        """Compute the bending moment of one wire, M_elastic + M_plastic.

        Args:
            diameter: Diameter of the wire, m.
            curvature: Curvature k, 1/m.

        Returns:
            Moment in N m.
        """
        return self.elastic_moment(diameter, curvature) + self.plastic_moment(diameter, curvature)

    def plastic_work(
        self, diameter: Float[Array, "..."] | float, curvature: Float[Array, "..."] | float
    ) -> Float[Array, "..."]:
        """Compute the plastic work of bending per length of wire: the whole work less the stored elastic energy.

        With e = k (y - y_yield) the strain above the yield strain, its density is (1 - B/E) (sigma_Y e + B e^2 / 2).
        It is integrated over the caps.

        Args:
            diameter: Diameter of the wire, m.
            curvature: Curvature k, 1/m.

        Returns:
            Work per length in J/m.
        """
        share, radius, bend = self.elastic_share(diameter, curvature), 0.5 * diameter, jnp.abs(curvature)
        area, first, second = (cap_moment(order, share) for order in (0, 1, 2))
        strain = bend * radius**3 * (first - share * area)
        squared = bend**2 * radius**4 * (second - 2.0 * share * first + share**2 * area)
        return (1.0 - self.tangent_modulus / self.modulus) * (
            self.yield_stress * strain + 0.5 * self.tangent_modulus * squared
        )
