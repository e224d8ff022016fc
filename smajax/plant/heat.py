"""Heat balance of a wire that is thin enough for one temperature across it (Biot number of a few thousandths).

    C dT/dt = joule - (4 / d) h(T) (T - T_ambient)

C is the heat capacity per volume (J/m^3/K) and d the diameter of the wire. The convection coefficient h(T) takes the
temperature in degC (``smajax.plant.convection``). Latent heat (``smajax.plant.effects.latent_heat``) and other stored
heat enter the balance of a step as ``stored`` (J/m^3), which is subtracted from the net heat of the step. Further
thermal nodes are effects, too.

Over a step the balance is integrated by the Hermite-Simpson rule. With q the net heat at both ends and in the middle of
the step, where the temperature is that of a cubic through both ends,

    T_half = (T_0 + T_1) / 2 + step / 8 (q_0 - q_1) / C        C (T_1 - T_0) = step / 6 (q_0 + 4 q_half + q_1) - stored

The rule is of fourth order, also with a resistivity that depends on the phases. The trapezoidal rule, of second order,
would shift estimated parameters by a standard error at practical step sizes.

Source of the balance: fast_rotary_actuator, equation 7.
"""

import abc
from typing import Any

import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule
from smajax.plant.wire import AbstractWire, Environment


class AbstractHeat(CheckedModule):
    """Base class of the heat stages. All methods work elementwise on arrays of any shape."""

    @abc.abstractmethod
    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the convection coefficient h(T).

        Args:
            temperature: Temperature T of the wire, degC.

        Returns:
            h in W/m^2/K.
        """

    @abc.abstractmethod
    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the heat capacity C per volume.

        Args:
            martensite: Martensite fraction.

        Returns:
            C in J/m^3/K.
        """

    def net_heat(
        self,
        joule: Float[Array, "..."],
        temperature: Float[Array, "..."],
        wire: AbstractWire,
        environment: Environment,
    ) -> Float[Array, "..."]:
        """Compute the net heat into the wire per volume: joule - (4 / d) h(T) (T - T_ambient).

        Args:
            joule: Joule heat per volume, W/m^3.
            temperature: Temperature T of the wire, degC.
            wire: The wire.
            environment: Its surroundings.

        Returns:
            Net heat in W/m^3.

        Source: fast_rotary_actuator, equation 7.
        """
        return joule - self.conductance(temperature, wire) * (temperature - environment.ambient)

    def conductance(self, temperature: Float[Array, "..."], wire: AbstractWire) -> Float[Array, "..."]:
        """Compute the thermal conductance to the surroundings per volume of wire: 4 h(T) / d.

        Args:
            temperature: Temperature T of the wire, degC.
            wire: The wire.

        Returns:
            Conductance in W/m^3/K.
        """
        return 4.0 / wire.diameter * self.convection(temperature)

    def midpoint_temperature(
        self, temperature: tuple[Any, ...], capacity: tuple[Any, ...], net_heat: tuple[Any, ...], step: Float[Array, ""]
    ) -> Float[Array, "..."]:
        """Compute the temperature in the middle of a step, by the cubic through both ends.

        Args:
            temperature: Temperatures at start and end, degC.
            capacity: Heat capacities at start and end, J/m^3/K.
            net_heat: Net heat at start and end, W/m^3.
            step: Duration, s.

        Returns:
            Temperature in degC.
        """
        mean = 0.5 * (capacity[0] + capacity[1])
        return 0.5 * (temperature[0] + temperature[1]) + 0.125 * step * (net_heat[0] - net_heat[1]) / mean

    def residual(
        self,
        temperature: tuple[Any, ...],
        capacity: tuple[Any, ...],
        net_heat: tuple[Any, ...],
        stored: Float[Array, "..."] | float,
        step: Float[Array, ""],
    ) -> Float[Array, "..."]:
        """Evaluate the residual of the heat balance over a step, by the Hermite-Simpson rule.

        Args:
            temperature: Temperatures at start and end, degC.
            capacity: Heat capacities at start, middle and end, J/m^3/K.
            net_heat: Net heat at start, middle and end, W/m^3.
            stored: Heat that does not warm the wire, such as latent heat, J/m^3.
            step: Duration, s.

        Returns:
            Residual in K.
        """
        mean = (capacity[0] + 4.0 * capacity[1] + capacity[2]) / 6.0
        heat = step / 6.0 * (net_heat[0] + 4.0 * net_heat[1] + net_heat[2])
        return temperature[1] - temperature[0] - (heat - stored) / mean

    def trapezoidal_residual(
        self,
        temperature: tuple[Any, ...],
        capacity: tuple[Any, ...],
        net_heat: tuple[Any, ...],
        stored: Float[Array, "..."] | float,
        step: Float[Array, ""],
    ) -> Float[Array, "..."]:
        """Evaluate the residual of the heat balance over a step, by the trapezoidal rule.

        Args:
            temperature: Temperatures at start and end, degC.
            capacity: Heat capacities at start and end, J/m^3/K.
            net_heat: Net heat at start and end, W/m^3.
            stored: Heat that does not warm the wire, such as latent heat, J/m^3.
            step: Duration, s.

        Returns:
            Residual in K.
        """
        mean = 0.5 * (capacity[0] + capacity[1])
        return temperature[1] - temperature[0] - (0.5 * step * (net_heat[0] + net_heat[1]) - stored) / mean


class PrescribedTemperature(AbstractHeat):
    """Heat stage of a prescribed temperature: it is an input, and there is no heat balance."""

    def convection(self, temperature: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return zero."""
        return jnp.zeros_like(temperature)

    def capacity(self, martensite: Float[Array, "..."]) -> Float[Array, "..."]:
        """Return one, so that nothing divides by zero."""
        return jnp.ones_like(martensite)
