"""Current or voltage limit of the driver: large currents are lower than recorded."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.parameters import parameter
from smajax.plant.effects.base import DriveEffect, Shapes
from smajax.plant.effects.skip_at_zero import skip_at_zero


class CurrentLimit(DriveEffect):
    """Smooth saturation of the current.

        i_wire = i (1 + ((1 - s)^-n - 1) x^n)^(-1/n)        x = i / reference (1 + m (R / R_austenite - 1))

    With n = 2 large currents are compressed, i (1 - s x^2) for small s; with a large n the driver is linear up to its
    limit and saturates there. The limit is one of current (m = 0) or of voltage (m = 1). If the current has a single
    level, the heat coefficients absorb the effect.
    """

    strength: jax.Array = parameter(
        "1", "share of the current lost at the reference current, for an austenitic wire", -0.1, 0.4, 0.0
    )
    sharpness: jax.Array = parameter("1", "exponent n: 2 compresses, a large one saturates", 1.0, 300.0, 2.0)
    by_voltage: jax.Array = parameter("1", "share m: 0 limits the current, 1 the voltage", 0.0, 1.0, 0.5)
    reference: jax.Array = parameter("A", "current to which the strength refers", 1e-3, 100.0, 1.0)
    key = "current-limit"
    typical: ClassVar[float] = 0.05
    source = "estimate: current sources lose 1 to 10 % near their limit"
    remedy = (
        "Record the current that flows, by a shunt or a current sensor, in place of the one that is commanded; "
        "raise the limit or the supply voltage."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("convection-temperature", "radiation")
    shapes: ClassVar[Shapes] = (("sharpness", (2.0, 12.0)), ("by_voltage", (0.5,)))
    needs: ClassVar[tuple[str, ...]] = ("current",)

    @skip_at_zero
    def signal(self, signal: Float[Array, " wires"], resistance: Float[Array, " wires"]) -> Float[Array, " wires"]:
        """Compute the addition to the current, A."""
        load = jnp.abs(signal) / self.reference * (1.0 + self.by_voltage * (resistance - 1.0))
        positive = load > 0.0
        # exp and log share their evaluations with their derivatives; a power would need additional ones.
        power = jnp.where(positive, jnp.exp(self.sharpness * jnp.log(jnp.where(positive, load, 1.0))), 0.0)
        saturation = jnp.expm1(-self.sharpness * jnp.log1p(-self.strength)) * power
        return signal * jnp.expm1(-jnp.log1p(saturation) / self.sharpness)
