"""A frame or tendon that gives way under the force."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import MechanismEffect


class Compliance(MechanismEffect):
    """x - s (F - F at the start): to be seen only where the force varies."""

    strength: jax.Array = parameter("m/N", "compliance of frame and tendon", 0.0, 2e-3, 0.0)
    key = "compliance"
    typical = 1e-4
    source = "estimate: 5 to 50 N/mm"
    confused_with = ("load-change",)
    sees = ("force",)
    needs = ("displacement",)

    def carry(self, motion: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``MechanismEffect``."""
        return -self.strength * (seen["force"] - seen["force"][0])
