"""Convection laws h(T): the convection coefficient of a wire in air, T in degC, with the heat capacities of the phases.

polynomial    h(T) = h0 + h1 T + h2 T^2        (fast_rotary_actuator, equation 8)
power law     h(T) = h0 + h2 T^n               (ali2026, equation 2)
"""

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.heat import AbstractHeat
from smajax.plant.materials.base import mix


class PolynomialConvection(AbstractHeat):
    """Convection h(T) = h0 + h1 T + h2 T^2 with T in degC.

    Source: fast_rotary_actuator, equation 8.
    """

    h0: jax.Array = parameter("W/m^2/K", "convection coefficient at 0 degC", 0.0, 1e5)
    h1: jax.Array = parameter("W/m^2/K^2", "linear coefficient of h(T)", -100.0, 1e3, 0.0)
    h2: jax.Array = parameter("W/m^2/K^3", "quadratic coefficient of h(T)", -1.0, 10.0, 0.0)
    capacity_austenite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of austenite", 1e5, 1e8, 5.4e6)
    capacity_martensite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of martensite", 1e5, 1e8, 5.4e6)

    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute h0 + h1 T + h2 T^2 in W/m^2/K."""
        return self.h0 + (self.h1 + self.h2 * temperature) * temperature

    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the heat capacity per volume in J/m^3/K, linear in the martensite fraction."""
        return mix(martensite, self.capacity_austenite, self.capacity_martensite)


class PowerLawConvection(AbstractHeat):
    """Convection h(T) = h0 + h2 T^n with T in degC; T^n is 0 below 0 degC.

    Source: ali2026, equation 2.
    """

    h0: jax.Array = parameter("W/m^2/K", "convection coefficient at 0 degC", 0.0, 1e5)
    exponent: jax.Array = parameter("1", "exponent n of h0 + h2 T^n", 0.05, 6.0)
    h2: jax.Array = parameter("W/m^2/K", "coefficient of T^n, for T as a number of degrees Celsius", -1.0, 1e3, 0.0)
    capacity_austenite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of austenite", 1e5, 1e8, 5.4e6)
    capacity_martensite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of martensite", 1e5, 1e8, 5.4e6)

    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute h0 + h2 T^n in W/m^2/K; the derivative is 0, not NaN, at and below 0 degC."""
        warm = temperature > 0
        power = jnp.where(warm, jnp.where(warm, temperature, 1.0) ** self.exponent, 0.0)
        return self.h0 + self.h2 * power

    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the heat capacity per volume in J/m^3/K, linear in the martensite fraction."""
        return mix(martensite, self.capacity_austenite, self.capacity_martensite)
