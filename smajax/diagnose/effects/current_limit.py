"""A driver at its limit: large currents, or those that need a large voltage, come out smaller than recorded."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import DriveEffect, asleep_at_zero


class CurrentLimit(DriveEffect):
    """i_wire = i (1 + ((1 - s)^-n - 1) x^n)^(-1/n), where x = i / reference (1 + m (R / R_austenite - 1)).

    At n = 2 large currents are compressed, i (1 - s x^2) for small s; at large n the driver is linear up to its limit and saturates there.
    Its limit is one of current (m = 0) or of voltage (m = 1). At one level of current alone the heat coefficients absorb it.
    """

    strength: jax.Array = parameter("1", "share of the current lost at the reference current, in austenite", -0.1, 0.4, 0.0)
    sharpness: jax.Array = parameter("1", "exponent n: 2 compresses, a large one saturates", 1.0, 300.0, 2.0)
    by_voltage: jax.Array = parameter("1", "share m: 0 limits the current, 1 the voltage", 0.0, 1.0, 0.5)
    reference: jax.Array = parameter("A", "current to which the strength refers", 1e-3, 100.0, 1.0)
    key = "current-limit"
    typical = 0.05
    source = "estimate: current sources lose 1 to 10 % near their limit"
    confused_with = ("convection-temperature", "radiation")
    shapes = (("sharpness", (2.0, 12.0)), ("by_voltage", (0.5,)))
    needs = ("current",)

    @asleep_at_zero
    def signal(self, signal: jax.Array, resistance: jax.Array) -> jax.Array:
        """See ``DriveEffect``."""
        load = jnp.abs(signal) / self.reference * (1.0 + self.by_voltage * (resistance - 1.0))
        flows = load > 0.0
        # By exponentials and logarithms, whose derivatives come with them: a power's would be further ones.
        power = jnp.where(flows, jnp.exp(self.sharpness * jnp.log(jnp.where(flows, load, 1.0))), 0.0)
        bent = jnp.expm1(-self.sharpness * jnp.log1p(-self.strength)) * power
        return signal * jnp.expm1(-jnp.log1p(bent) / self.sharpness)
