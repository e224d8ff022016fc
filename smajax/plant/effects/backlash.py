"""Backlash: play between wire and sensor."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect, Shapes

# Smallest play that is simulated, as a share of the motion's range: below it the effect is proportional to the
# strength, so that the derivative at 0 exists. Chosen by trial; tests/unit/plant/test_effects.py holds it.
_SMALLEST_GAP = 0.005
# Keeps the gap positive where nothing moves; near the smallest double-precision number, so it changes no other value.
_TINY = 1e-300


class Backlash(MechanismEffect):
    """Play operator: the output x - s (z - z_0) follows only after a gap of 2 s has been crossed.

    z in -1..1 is the position within the play. It follows the motion, dz = dx / s limited to -1..1, from its start
    value z_0.
    """

    strength: jax.Array = parameter("m", "half of the play", 0.0, 5e-3, 0.0)
    begin: jax.Array = parameter(
        "1", "position in the play at the first row: -1 at one end, 1 at the other", -1.0, 1.0, 0.0
    )
    key = "backlash"
    obstacle_to_rates = "play"
    typical: ClassVar[float] = 1e-4
    source = "estimate: 0.05 to 0.3 mm"
    remedy = (
        "Preload the transmission with a spring or a weight so that it is always in contact, or measure at the "
        "wire itself."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("coulomb-friction",)
    excluded_by: ClassVar[tuple[str, ...]] = ("prescribed strain or stress",)  # its sensor is at the specimen
    shapes: ClassVar[Shapes] = (("begin", (-0.9, 0.0, 0.9)),)

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the added motion, in m at the wire."""
        gap = maximum(self.strength, jax.lax.stop_gradient(_SMALLEST_GAP * (jnp.max(motion) - jnp.min(motion))) + _TINY)

        def move_plate(z: jax.Array, change: jax.Array) -> tuple[jax.Array, jax.Array]:
            z = clip(z + change / gap, -1.0, 1.0)
            return z, z

        _, z = jax.lax.scan(move_plate, self.begin, jnp.diff(motion, prepend=motion[:1]), unroll=8)
        return -self.strength * (z - self.begin)
