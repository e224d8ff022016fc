"""Heat balance of a wire thin enough for one temperature across it (Biot number of a few thousandths).

    C dT/dt = joule - (4 / d) h(T) (T - T_ambient)

C is the heat capacity per volume (J/m^3/K), d the wire's diameter; the convection coefficient h takes the wire's
temperature in degC (``smajax.plant.convection``). Latent heat and other stored heat enter the balance of a step as
``stored`` (J/m^3): they are subtracted from the net heat of the step. Latent heat itself is an effect
(``smajax.plant.effects.latent_heat``), as are further thermal nodes.

Over a step the balance is integrated by the Hermite-Simpson rule. With q the net heat at the two ends and in the middle
of the step, where the temperature follows from a cubic through both ends,

    T_half = (T_0 + T_1) / 2 + step / 8 (q_0 - q_1) / C        C (T_1 - T_0) = step / 6 (q_0 + 4 q_half + q_1) - stored

The rule is of fourth order, with the resistivity of the phases included. The trapezoidal rule, of second order, would
shift estimated parameters by a standard error at practical step sizes.

Source of the balance: fast_rotary_actuator, equation 7.
"""

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.plant.wire import AbstractWire, Environment


class AbstractHeat(eqx.Module):
    """Base class of the heat stages. All methods work elementwise on arrays of any shape."""

    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the convection coefficient h in W/m^2/K at a temperature in degC."""
        raise NotImplementedError

    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the heat capacity per volume in J/m^3/K at a martensite fraction."""
        raise NotImplementedError

    def net_heat(
        self,
        joule: Float[Array, "..."],
        temperature: Float[Array, "..."],
        wire: AbstractWire,
        environment: Environment,
    ) -> Float[Array, "..."]:
        """Compute the net heat into the wire per volume in W/m^3.

        Args:
            joule: Joule heat per volume in W/m^3.
            temperature: Temperature of the wire in degC.
            wire: The wire.
            environment: Its surroundings.
        """
        return joule - self.conductance(temperature, wire) * (temperature - environment.ambient)

    def conductance(self, temperature: Float[Array, "..."], wire: AbstractWire) -> Float[Array, "..."]:
        """Compute the heat given off to the surroundings per volume of wire and kelvin in W/m^3/K: 4 h(T) / d."""
        return 4.0 / wire.diameter * self.convection(temperature)

    def midpoint_temperature(
        self, temperature: tuple, capacity: tuple, net_heat: tuple, step: Float[Array, ""]
    ) -> Float[Array, "..."]:
        """Compute the temperature in the middle of a step, by the cubic through both ends.

        Args:
            temperature: Temperatures in degC at start and end.
            capacity: Heat capacities in J/m^3/K at start and end.
            net_heat: Net heat in W/m^3 at start and end.
            step: Duration in s.
        """
        mean = 0.5 * (capacity[0] + capacity[1])
        return 0.5 * (temperature[0] + temperature[1]) + 0.125 * step * (net_heat[0] - net_heat[1]) / mean

    def residual(
        self,
        temperature: tuple,
        capacity: tuple,
        net_heat: tuple,
        stored: Float[Array, "..."] | float,
        step: Float[Array, ""],
    ) -> Float[Array, "..."]:
        """Evaluate the residual of the heat balance over a step in K, by the Hermite-Simpson rule.

        Args:
            temperature: Temperatures in degC at start and end.
            capacity: Heat capacities in J/m^3/K at start, middle and end.
            net_heat: Net heat in W/m^3 at start, middle and end.
            stored: Heat in J/m^3 that does not warm the wire, such as latent heat.
            step: Duration in s.
        """
        mean = (capacity[0] + 4.0 * capacity[1] + capacity[2]) / 6.0
        heat = step / 6.0 * (net_heat[0] + 4.0 * net_heat[1] + net_heat[2])
        return temperature[1] - temperature[0] - (heat - stored) / mean

    def trapezoidal_residual(
        self,
        temperature: tuple,
        capacity: tuple,
        net_heat: tuple,
        stored: Float[Array, "..."] | float,
        step: Float[Array, ""],
    ) -> Float[Array, "..."]:
        """Evaluate the residual in K by the trapezoidal rule: arguments as of ``residual``, at start and end alone."""
        mean = 0.5 * (capacity[0] + capacity[1])
        return temperature[1] - temperature[0] - (0.5 * step * (net_heat[0] + net_heat[1]) - stored) / mean


class PrescribedTemperature(AbstractHeat):
    """The temperature is an input; there is no heat balance."""

    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return zero."""
        return jnp.zeros_like(temperature)

    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return one, so that nothing divides by zero."""
        return jnp.ones_like(martensite)
