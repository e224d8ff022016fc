"""Bending of a round wire that yields: moment, and work stored by yielding, in closed form.

The stress-strain curve is bilinear and odd (flexural paper, eq. 1): slope E up to the yield stress, the tangent modulus B beyond. Across
a wire of radius R bent to the curvature k the strain is k y. With u the elastic share of the radius, y_yield = u R = sigma_Y / (E k), all
follows from three moments of the part that yields, the two caps beyond u,

    A_n(u) = integral of 4 y^n sqrt(1 - y^2) from u to 1,        A_n' = -4 u^n sqrt(1 - u^2)

    M_elastic = E k R^4 (A_2(0) - A_2(u))                                                                              (eq. 2)
    M_plastic = (1 - B/E) sigma_Y R^3 A_1(u) + B k R^4 A_2(u)                                                          (eq. 3)

which are the published equations, factors collected. Below yield u stays at 1, where those contain the arcsine of a number above 1.
"""

from functools import partial

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.material.brinson import Brinson


def _root(share: jax.Array) -> jax.Array:
    """sqrt(1 - u^2), with derivative 0 at u = 1 in place of one that is infinite."""
    inside = share < 1.0
    return jnp.where(inside, jnp.sqrt(jnp.where(inside, 1.0 - share**2, 1.0)), 0.0)


@partial(jax.custom_jvp, nondiff_argnums=(0,))
def cap_moment(order: int, share: jax.Array) -> jax.Array:
    """A_n(u) for the order n = 0, 1 or 2 and a share u of 0..1, elementwise."""
    root = _root(share)
    if order == 1:
        return 4.0 / 3.0 * root**3
    angle = jnp.arccos(share)
    return 2.0 * (angle - share * root) if order == 0 else 0.5 * (angle + share * root * (1.0 - 2.0 * share**2))


@cap_moment.defjvp
def _cap_moment_jvp(order: int, primals: tuple, tangents: tuple) -> tuple:
    (share,), (moved,) = primals, tangents
    return cap_moment(order, share), -4.0 * share**order * _root(share) * moved


class BilinearLaw(eqx.Module):
    """Stress against strain of the wire while it is bent: elastic, then hardening (flexural paper, eq. 1).

    All methods work elementwise on arrays of one shape: diameters in m, curvatures in 1/m. Moments change sign with the curvature.
    """

    modulus: jax.Array = parameter("Pa", "Young's modulus E before yield", 1e9, 3e11)
    tangent_modulus: jax.Array = parameter("Pa", "slope B of the curve beyond yield", 0.0, 3e11)
    yield_stress: jax.Array = parameter("Pa", "stress at which detwinning begins", 1e6, 3e9)

    @classmethod
    def of(cls, material: Brinson, temperature: float | jax.Array) -> "BilinearLaw":
        """The curve of an austenitic wire at a temperature (degC) above martensite start: straight from the start of stress-induced
        transformation to its end (Brinson 1993)."""
        raised = material.clausius_clapeyron_martensite * (temperature - material.forward_start)
        start, finish = material.detwinning_start_stress + raised, material.detwinning_finish_stress + raised
        stretch = finish / material.modulus_martensite + material.max_strain - start / material.modulus_austenite
        return cls(material.modulus_austenite, (finish - start) / stretch, start)

    @property
    def softens(self) -> jax.Array:
        """Whether the curve is no steeper beyond yield than before."""
        return self.tangent_modulus <= self.modulus

    def yield_diameter(self, curvature: jax.Array) -> jax.Array:
        """The largest diameter that stays elastic at a curvature, m: 2 sigma_Y / (E k)."""
        return 2.0 * self.yield_stress / (self.modulus * jnp.abs(curvature))

    def elastic_share(self, diameter: jax.Array, curvature: jax.Array) -> jax.Array:
        """u, the share of the radius that stays elastic: 1 up to yield; NaN of a curve that does not soften."""
        limit, outer = self.yield_stress / self.modulus, 0.5 * diameter * jnp.abs(curvature)
        yields = outer > limit
        return jnp.where(self.softens, jnp.where(yields, limit / jnp.where(yields, outer, 1.0), 1.0), jnp.nan)

    def elastic_moment(self, diameter: jax.Array, curvature: jax.Array) -> jax.Array:
        """The share of the moment that the elastic core carries, N m (eq. 2)."""
        caps = cap_moment(2, self.elastic_share(diameter, curvature))
        return self.modulus * curvature * (0.5 * diameter) ** 4 * (0.25 * jnp.pi - caps)

    def plastic_moment(self, diameter: jax.Array, curvature: jax.Array) -> jax.Array:
        """The share of the moment that the yielding caps carry, N m (eq. 3)."""
        share, radius = self.elastic_share(diameter, curvature), 0.5 * diameter
        steady = (1.0 - self.tangent_modulus / self.modulus) * self.yield_stress * radius**3 * cap_moment(1, share)
        return jnp.sign(curvature) * steady + self.tangent_modulus * curvature * radius**4 * cap_moment(2, share)

    def moment(self, diameter: jax.Array, curvature: jax.Array) -> jax.Array:
        """The bending moment of one wire, N m."""
        return self.elastic_moment(diameter, curvature) + self.plastic_moment(diameter, curvature)

    def plastic_work(self, diameter: jax.Array, curvature: jax.Array) -> jax.Array:
        """Work per length of wire that bending has put into yielding, J/m; what springs back is left out.

        Beyond yield, at e = k (y - y_yield) of strain, the density of the whole work less that of the elastic stress is
        (1 - B/E) (sigma_Y e + B e^2 / 2), here summed over the caps.
        """
        share, radius, bend = self.elastic_share(diameter, curvature), 0.5 * diameter, jnp.abs(curvature)
        area, first, second = (cap_moment(order, share) for order in (0, 1, 2))
        strain = bend * radius**3 * (first - share * area)
        squared = bend**2 * radius**4 * (second - 2.0 * share * first + share**2 * area)
        return (1.0 - self.tangent_modulus / self.modulus) * (self.yield_stress * strain + 0.5 * self.tangent_modulus * squared)
