"""Play between wire and sensor."""

import jax
import jax.numpy as jnp

from smajax.kinks import larger, within
from smajax.parameters import parameter
from smajax.plant.effect import MechanismEffect

_LEAST = 0.005  # of the range: over this the play is crossed while its size is near 0


class Backlash(MechanismEffect):
    """The output follows only after a gap of 2 s is crossed: x - s (z - z_0), z in -1..1 following the motion from its start z_0."""

    strength: jax.Array = parameter("m", "half of the play", 0.0, 5e-3, 0.0)
    begin: jax.Array = parameter("1", "where in the play the motion starts: -1 at one end, 1 at the other", -1.0, 1.0, 0.0)
    key = "backlash"
    typical = 1e-4
    source = "estimate: 0.05 to 0.3 mm"
    confused_with = ("coulomb-friction",)
    shapes = (("begin", (-0.9, 0.0, 0.9)),)

    def carry(self, motion: jax.Array, seen: dict[str, jax.Array], time: jax.Array) -> jax.Array:
        """See ``MechanismEffect``."""
        gap = larger(self.strength, jax.lax.stop_gradient(_LEAST * (jnp.max(motion) - jnp.min(motion))) + 1e-300)

        def follow(z: jax.Array, moved: jax.Array) -> tuple[jax.Array, jax.Array]:
            z = within(z + moved / gap, -1.0, 1.0)
            return z, z

        _, z = jax.lax.scan(follow, self.begin, jnp.diff(motion, prepend=motion[:1]), unroll=8)
        return -self.strength * (z - self.begin)
