"""Heat: the temperature of a wire that is thin enough to be at one temperature across (Biot number of a few thousandths).

    C dT/dt = joule - (4 / d) h(T) (T - T_ambient)

C is a capacity per volume (J/m^3/K). The convection coefficient h takes the wire's temperature in degC. Over a step the balance is held by
the Hermite-Simpson rule: with q the net heat at the two ends and halfway, where the temperature follows from a cubic through both ends,

    T_half = (T_0 + T_1) / 2 + step / 8 (q_0 - q_1) / C        C (T_1 - T_0) = step / 6 (q_0 + 4 q_half + q_1)

It is of fourth order, the phases' resistivity included. The trapezoidal rule would bias parameters by a standard error at steps that one
would like to take.
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.wire import AbstractWire, Environment


class AbstractHeat(eqx.Module):
    """Base class of the heat stages. All methods work elementwise on arrays of any shape."""

    def convection(self, temperature: jax.Array) -> jax.Array:
        """Convection coefficient h in W/m^2/K."""
        raise NotImplementedError

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """Heat capacity per volume in J/m^3/K."""
        raise NotImplementedError

    def rate(self, joule: jax.Array, temperature: jax.Array, wire: AbstractWire, environment: Environment) -> jax.Array:
        """Net heat into the wire per volume, W/m^3."""
        return joule - self.conductance(temperature, wire) * (temperature - environment.ambient)

    def conductance(self, temperature: jax.Array, wire: AbstractWire) -> jax.Array:
        """Heat given off to the surroundings per volume of wire and kelvin, W/m^3/K."""
        return 4.0 / wire.diameter * self.convection(temperature)

    def halfway(self, temperature: tuple, capacity: tuple, rate: tuple, step: jax.Array) -> jax.Array:
        """Temperature in the middle of a step; each pair holds the values at its start and end."""
        mean = 0.5 * (capacity[0] + capacity[1])
        return 0.5 * (temperature[0] + temperature[1]) + 0.125 * step * (rate[0] - rate[1]) / mean

    def balance(self, temperature: tuple, capacity: tuple, rate: tuple, stored: jax.Array | float, step: jax.Array) -> jax.Array:
        """Residual in K of the heat balance over ``step`` seconds.

        ``temperature`` holds the values at start and end, ``capacity`` and ``rate`` those at start, middle and end; ``stored`` is heat in
        J/m^3 that went elsewhere than into warming, such as into a transformation.
        """
        mean = (capacity[0] + 4.0 * capacity[1] + capacity[2]) / 6.0
        return temperature[1] - temperature[0] - (step / 6.0 * (rate[0] + 4.0 * rate[1] + rate[2]) - stored) / mean

    def trapezoid(self, temperature: tuple, capacity: tuple, rate: tuple, stored: jax.Array | float, step: jax.Array) -> jax.Array:
        """As ``balance``, from start and end alone: near enough to search by."""
        mean = 0.5 * (capacity[0] + capacity[1])
        return temperature[1] - temperature[0] - (0.5 * step * (rate[0] + rate[1]) - stored) / mean


class PolynomialHeat(AbstractHeat):
    """h(T) = h0 + h1 T + h2 T^2 with T in degC (rotary paper, eq. 8)."""

    h0: jax.Array = parameter("W/m^2/K", "convection coefficient at 0 degC", 0.0, 1e5)
    h1: jax.Array = parameter("W/m^2/K^2", "linear coefficient of h(T)", -100.0, 1e3, 0.0)
    h2: jax.Array = parameter("W/m^2/K^3", "quadratic coefficient of h(T)", -1.0, 10.0, 0.0)
    capacity_austenite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of austenite", 1e5, 1e8, 5.4e6)
    capacity_martensite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of martensite", 1e5, 1e8, 5.4e6)

    def convection(self, temperature: jax.Array) -> jax.Array:
        """See ``AbstractHeat``."""
        return self.h0 + (self.h1 + self.h2 * temperature) * temperature

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """See ``AbstractHeat``."""
        return self.capacity_austenite + martensite * (self.capacity_martensite - self.capacity_austenite)


class PowerHeat(AbstractHeat):
    """h(T) = h0 + h2 T^n with T in degC, T^n taken as 0 below 0 degC (hip paper, eq. 2)."""

    h0: jax.Array = parameter("W/m^2/K", "convection coefficient at 0 degC", 0.0, 1e5)
    exponent: jax.Array = parameter("1", "exponent n of h0 + h2 T^n", 0.05, 6.0)
    h2: jax.Array = parameter("W/m^2/K", "coefficient of T^n, for T as a number of degrees Celsius", -1.0, 1e3, 0.0)
    capacity_austenite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of austenite", 1e5, 1e8, 5.4e6)
    capacity_martensite: jax.Array = parameter("J/m^3/K", "heat capacity per volume of martensite", 1e5, 1e8, 5.4e6)

    def convection(self, temperature: jax.Array) -> jax.Array:
        """See ``AbstractHeat``."""
        warm = temperature > 0
        power = jnp.where(warm, jnp.where(warm, temperature, 1.0) ** self.exponent, 0.0)
        return self.h0 + self.h2 * power

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """See ``AbstractHeat``."""
        return self.capacity_austenite + martensite * (self.capacity_martensite - self.capacity_austenite)


class PrescribedTemperature(AbstractHeat):
    """The temperature is an input; there is no balance to hold."""

    def convection(self, temperature: jax.Array) -> jax.Array:
        """None."""
        return jnp.zeros_like(temperature)

    def capacity(self, martensite: jax.Array) -> jax.Array:
        """One, so that nothing divides by zero."""
        return jnp.ones_like(martensite)
