"""Drives: from the electrical input to the heat that it makes in the wire.

``control`` names the recorded input. ``joule`` gives watts per cubic metre of wire, ``current`` the amperes that a meter would read. The
resistance of the wire follows the resistivity of its phases; its length and diameter are those of the rig file (4 % of strain change it by
less than a resistivity is known).
"""

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.wire import AbstractWire


class AbstractDrive(eqx.Module):
    """Base class of the drives. All methods work elementwise on arrays of any shape."""

    control: eqx.AbstractClassVar[str]

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """Heat per volume in W/m^3 for an input ``signal`` in SI."""
        raise NotImplementedError

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """Current in A; for a pulsed supply its mean."""
        raise NotImplementedError


class CurrentDrive(AbstractDrive):
    """A current source: rho (I / A)^2."""

    gain: jax.Array = parameter("1", "current in the wire over current in the file", 0.0, 100.0, 1.0)
    control = "current"

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return resistivity * (self.gain * signal / wire.area) ** 2

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return self.gain * signal


class VoltageDrive(AbstractDrive):
    """A voltage source behind leads of a fixed resistance: the wire takes V R / (R + R_lead)."""

    gain: jax.Array = parameter("1", "voltage at the terminals over voltage in the file", 0.0, 100.0, 1.0)
    lead_resistance: jax.Array = parameter("ohm", "resistance of leads and contacts in series with the wire", 0.0, 1e3, 0.0)
    control = "voltage"

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return self.gain * signal / (resistance(resistivity, wire) + self.lead_resistance)

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return resistivity * (self.current(signal, resistivity, wire) / wire.area) ** 2


class PowerDrive(AbstractDrive):
    """A known electrical power, all of it turned into heat in the wire."""

    gain: jax.Array = parameter("1", "heat in the wire over power in the file", 0.0, 1e6, 1.0)
    control = "power"

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return self.gain * signal / (wire.area * wire.length)

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``; NaN-safe at zero power."""
        square = self.gain * signal / resistance(resistivity, wire)
        positive = square > 0
        return jnp.where(positive, jnp.sqrt(jnp.where(positive, square, 1.0)), 0.0)


class DutyDrive(AbstractDrive):
    """A supply of fixed voltage, pulsed fast against the wire's warming: the mean heat is linear in the duty, not in its square."""

    supply: jax.Array = parameter("V", "supply voltage while the switch is on", 0.0, 1e3)
    lead_resistance: jax.Array = parameter("ohm", "resistance of leads, switch and contacts", 0.0, 1e3, 0.0)
    control = "duty"

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        return signal * self.supply / (resistance(resistivity, wire) + self.lead_resistance)

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """See ``AbstractDrive``."""
        on = self.supply / (resistance(resistivity, wire) + self.lead_resistance)
        return signal * resistivity * (on / wire.area) ** 2


class NoDrive(AbstractDrive):
    """No electrical input: the temperature is prescribed."""

    control = ""

    def joule(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """Nothing."""
        return jnp.zeros_like(resistivity)

    def current(self, signal: jax.Array, resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
        """Nothing."""
        return jnp.zeros_like(resistivity)


def resistance(resistivity: jax.Array, wire: AbstractWire) -> jax.Array:
    """Resistance of the wire in ohm."""
    return resistivity * wire.length / wire.area


DRIVES: dict[str, type[AbstractDrive]] = {d.control: d for d in (CurrentDrive, VoltageDrive, PowerDrive, DutyDrive)}
