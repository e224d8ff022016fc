"""A driver at its limit: large currents, or those that need a large voltage, come out smaller than recorded."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import DriveEffect


class CurrentLimit(DriveEffect):
    """i_wire = i (1 + ((1 - s)^-n - 1) x^n)^(-1/n), where x = i / reference (R / R_austenite)^m.

    At n = 2 large currents are compressed, i (1 - s x^2) for small s; at large n the driver is linear up to its limit and saturates there.
    Its limit is one of current (m = 0) or of voltage (m = 1). At one level of current alone the heat coefficients absorb it.
    """

    strength: jax.Array = parameter("1", "share of the current lost at the reference current, in austenite", -0.1, 0.4, 0.0)
    sharpness: jax.Array = parameter("1", "exponent n: 2 compresses, a large one saturates", 1.0, 300.0, 2.0)
    by_voltage: jax.Array = parameter("1", "exponent m: 0 limits the current, 1 the voltage", 0.0, 1.0, 0.5)
    reference: jax.Array = parameter("A", "current to which the strength refers", 1e-3, 100.0, 1.0)
    key = "current-limit"
    typical = 0.05
    source = "estimate: current sources lose 1 to 10 % near their limit"
    confused_with = ("convection-temperature", "radiation")
    shapes = (("sharpness", (2.0, 12.0)), ("by_voltage", (0.5,)))
    needs = ("current",)

    def signal(self, signal: jax.Array, resistance: jax.Array) -> jax.Array:
        """See ``DriveEffect``."""
        load = jnp.abs(signal) / self.reference * resistance**self.by_voltage
        flows = load > 0.0
        power = jnp.where(flows, jnp.where(flows, load, 1.0) ** self.sharpness, 0.0)
        lost = (1.0 + ((1.0 - self.strength) ** -self.sharpness - 1.0) * power) ** (-1.0 / self.sharpness) - 1.0
        return signal * lost
