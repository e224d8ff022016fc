"""Drives: from the electrical input to the Joule heat in the wire, with the resistance R(xi) of the phases.

    Joule heat per volume = rho_e(xi) (I / A)^2        R(xi) = rho_e(xi) L / A

with the resistivity rho_e of the material, which depends on the martensite fraction xi, the current I, the length L and
the cross-section A. ``control`` names the recorded input: current, voltage, power, or the duty of a pulsed supply.
Length and diameter are those of the rig file: 4 % of strain change the resistance by less than the uncertainty of a
resistivity.

Source of the Joule heat: fast_rotary_actuator, equation 7.
"""

import abc

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import CheckedModule, parameter
from smajax.plant.wire import AbstractWire


class AbstractDrive(CheckedModule):
    """Base class of the drives. All methods work elementwise on arrays of any shape."""

    control: eqx.AbstractClassVar[str]

    @abc.abstractmethod
    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the Joule heat per volume of wire in W/m^3.

        Args:
            signal: The input that ``control`` names, in SI.
            resistivity: Resistivity rho_e of the wire, ohm m.
            wire: The wire.
        """

    @abc.abstractmethod
    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the current in A; for a pulsed supply its mean.

        Args:
            signal: The input that ``control`` names, in SI.
            resistivity: Resistivity rho_e of the wire, ohm m.
            wire: The wire.
        """


class CurrentDrive(AbstractDrive):
    """Current source: Joule heat rho_e (gain I / A)^2."""

    gain: jax.Array = parameter("1", "current in the wire over current in the file", 0.0, 100.0, 1.0)
    control = "current"

    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the Joule heat of the current, rho_e (gain I / A)^2, in W/m^3."""
        return resistivity * (self.gain * signal / wire.area) ** 2

    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the current in A: the input times the gain."""
        return self.gain * signal


class VoltageDrive(AbstractDrive):
    """Voltage source with leads of constant resistance in series: the wire takes V R / (R + R_lead)."""

    gain: jax.Array = parameter("1", "voltage at the terminals over voltage in the file", 0.0, 100.0, 1.0)
    lead_resistance: jax.Array = parameter(
        "ohm", "resistance of leads and contacts in series with the wire", 0.0, 1e3, 0.0
    )
    control = "voltage"

    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the current in A through wire and leads: V / (R + R_lead)."""
        return self.gain * signal / (resistance(resistivity, wire) + self.lead_resistance)

    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the Joule heat of that current in the wire alone, in W/m^3."""
        return resistivity * (self.current(signal, resistivity, wire) / wire.area) ** 2


class PowerDrive(AbstractDrive):
    """Measured electrical power, which heats the wire completely."""

    gain: jax.Array = parameter("1", "heat in the wire over power in the file", 0.0, 1e6, 1.0)
    control = "power"

    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the power per volume of wire in W/m^3."""
        return self.gain * signal / (wire.area * wire.length)

    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the current sqrt(P / R) in A, with a derivative of 0 at zero power instead of NaN."""
        square = self.gain * signal / resistance(resistivity, wire)
        positive = square > 0
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


class DutyDrive(AbstractDrive):
    """Pulsed supply of constant voltage, fast compared with the heating: the mean heat is linear in the duty."""

    supply: jax.Array = parameter("V", "supply voltage while the switch is on", 0.0, 1e3)
    lead_resistance: jax.Array = parameter("ohm", "resistance of leads, switch and contacts", 0.0, 1e3, 0.0)
    control = "duty"

    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the mean current in A: the duty times that of the closed switch."""
        return signal * self.supply / (resistance(resistivity, wire) + self.lead_resistance)

    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Compute the mean Joule heat in W/m^3: the duty times that of the closed switch."""
        on = self.supply / (resistance(resistivity, wire) + self.lead_resistance)
        return signal * resistivity * (on / wire.area) ** 2


class NoDrive(AbstractDrive):
    """No electrical input: the temperature is prescribed instead."""

    control = ""

    def joule(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Return zero heat."""
        return jnp.zeros_like(resistivity)

    def current(
        self, signal: Float[Array, "..."], resistivity: Float[Array, "..."], wire: AbstractWire
    ) -> Float[Array, "..."]:
        """Return zero current."""
        return jnp.zeros_like(resistivity)


def resistance(resistivity: Float[Array, "..."], wire: AbstractWire) -> Float[Array, "..."]:
    """Compute the resistance of the wire, R = rho_e L / A.

    Args:
        resistivity: Resistivity rho_e, ohm m.
        wire: The wire.

    Returns:
        Resistance in ohm.
    """
    return resistivity * wire.length / wire.area


DRIVES: dict[str, type[AbstractDrive]] = {d.control: d for d in (CurrentDrive, VoltageDrive, PowerDrive, DutyDrive)}
