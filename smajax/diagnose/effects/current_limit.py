"""Compression of the driver: large currents come out smaller than recorded."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import DriveEffect


class CurrentLimit(DriveEffect):
    """i_wire = i (1 - s (i / reference)^2); at one level of current alone the heat coefficients absorb it."""

    strength: jax.Array = parameter("1", "share of the current lost at the reference current", -0.1, 0.4, 0.0)
    reference: jax.Array = parameter("A", "current to which the strength refers", 1e-3, 100.0, 1.0)
    key = "current-limit"
    typical = 0.05
    source = "estimate: current sources lose 1 to 10 % near their limit"
    confused_with = ("convection-temperature", "radiation")
    needs = ("current",)

    def signal(self, signal: jax.Array) -> jax.Array:
        """See ``DriveEffect``."""
        return -self.strength * signal * (signal / self.reference) ** 2
