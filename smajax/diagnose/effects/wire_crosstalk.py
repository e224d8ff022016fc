"""Heat that passes between neighbouring wires."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import HeatEffect, Instant, Where


class WireCrosstalk(HeatEffect):
    """s times the convection at ambient, per kelvin of difference between the two wires."""

    strength: jax.Array = parameter("1", "heat passed between the wires over convection", 0.0, 0.6, 0.0)
    key = "wire-crosstalk"
    typical = 0.05
    source = "estimate: 2 to 10 % of h at a pitch of 1 to 2 mm"
    confused_with = ("ambient-drift",)
    needs = ("two wires",)

    def power(self, now: Instant, memory: tuple, where: Where) -> jax.Array:
        """See ``HeatEffect``."""
        per_kelvin = where.heat.conductance(where.environment.ambient, where.wire)
        return -self.strength * per_kelvin * (now.temperature - now.temperature[::-1])
