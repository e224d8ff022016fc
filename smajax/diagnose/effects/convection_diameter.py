"""Convection that depends on the wire's diameter: to be seen across wires only."""

import jax
import jax.numpy as jnp

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class ConvectionDiameter(HeatEffect):
    """h (d / 0.25 mm)^(-s), to first order in s; with one wire it is a factor of h."""

    strength: jax.Array = parameter("1", "exponent with which h falls with the diameter", -0.5, 1.0, 0.0)
    key = "convection-diameter"
    typical = 0.6
    source = "h = 147, 71, 43 W/m^2/K at 0.1, 0.25, 0.5 mm by Churchill and Chu's correlation"
    confused_with = ()

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        cooling = where.heat.conductance(now.temperature, where.wire) * (now.temperature - where.environment.ambient)
        return self.strength * jnp.log(where.wire.diameter / 0.25e-3) * cooling
