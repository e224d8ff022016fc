"""Resistance of leads and contacts in the measured voltage."""

from typing import ClassVar

import jax
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import DriveEffect


class LeadResistance(DriveEffect):
    """Measured voltage i (R + s): the voltmeter includes the leads, while only R heats the wire."""

    strength: jax.Array = parameter(
        "ohm", "resistance of leads and contacts inside the measured voltage", -1.0, 5.0, 0.0
    )
    key = "lead-resistance"
    typical: ClassVar[float] = 0.2
    source = "estimate: 0.05 to 0.5 ohm"
    remedy = (
        "Measure the voltage at the wire with separate leads (four-wire measurement), or measure the resistance "
        "of the leads."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("resistivity-temperature",)
    needs: ClassVar[tuple[str, ...]] = ("voltage observed",)

    def voltage(self, current: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the addition to the measured voltage, V: s i."""
        return self.strength * current
