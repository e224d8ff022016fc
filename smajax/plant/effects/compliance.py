"""Compliance of frame and tendon."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import MechanismEffect


class Compliance(MechanismEffect):
    """Motion x - s (F - F_0), with F_0 the force at the first row; visible only if the force varies."""

    strength: jax.Array = parameter("m/N", "compliance of frame and tendon", 0.0, 2e-3, 0.0)
    key = "compliance"
    typical: ClassVar[float] = 1e-4
    source = "estimate: 5 to 50 N/mm"
    remedy = (
        "Stiffen frame, clamps and tendon, or measure the displacement between two points of the wire; hang two "
        "known weights on the cold wire to measure it."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("load-change",)
    other_channels: ClassVar[tuple[str, ...]] = ("force",)
    needs: ClassVar[tuple[str, ...]] = ("displacement",)

    def displacement(
        self, motion: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the added motion, in m at the wire."""
        return -self.strength * (channels["force"] - channels["force"][0])
