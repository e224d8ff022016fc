"""A bias spring that stiffens."""

import jax

from smajax.parameters import parameter
from smajax.plant.effect import Instant, MechanismEffect, Where


class BiasNonlinearity(MechanismEffect):
    """F + s x^3."""

    strength: jax.Array = parameter("N/m^3", "cubic stiffness of the spring", -1e9, 1e10, 0.0)
    key = "bias-nonlinearity"
    typical = 1e6
    source = "estimate: 0 to 10 % at full stroke"
    confused_with = ("load-change",)
    needs = ("drag", "spring")
    drags = True

    def start(self, instant: Instant, where: Where) -> jax.Array:
        """The contraction at the first row."""
        return instant.contraction

    def drag(self, before: Instant, after: Instant, memory: jax.Array, step: jax.Array, where: Where) -> jax.Array:
        """See ``MechanismEffect``."""
        motion = where.wire.motion_per_strain * (after.contraction - memory)
        return self.strength * motion**3 / where.wire.force_per_stress
