"""Time skew: a channel that is recorded late or early."""

from typing import ClassVar

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum
from smajax.parameters import parameter
from smajax.plant.effects.base import SensorEffect
from smajax.plant.sensor import SAME_INSTANT, time_derivative


class TimeSkew(SensorEffect):
    """Reading y(t) = x(t - s)."""

    strength: jax.Array = parameter("s", "delay of the channel", -1.0, 1.0, 0.0)
    key = "time-skew"
    typical: ClassVar[float] = 0.03
    source = "estimate: 1 to 100 ms"
    remedy = (
        "Take all channels from one clock, with stamps at the sampling; a step of a known channel measures the delay."
    )
    confused_with: ClassVar[tuple[str, ...]] = ("sensor-lag",)
    needs: ClassVar[tuple[str, ...]] = ("clock",)

    def reading(
        self, series: Float[Array, " rows"], channels: dict[str, jax.Array], time: Float[Array, " rows"]
    ) -> Float[Array, " rows"]:
        """Compute the change of the reading."""
        return _interpolated(time - self.strength, time, series) - series


def _interpolated(instants: jax.Array, time: jax.Array, series: jax.Array) -> jax.Array:
    """The series at other instants, by cubic Hermite interpolation with continuous slopes; constant beyond its ends."""
    slope = time_derivative(series, time)
    instants = clip(instants, time[0], time[-1])
    i = jnp.clip(jnp.searchsorted(time, jax.lax.stop_gradient(instants), side="right") - 1, 0, len(time) - 2)
    gap = maximum(time[i + 1] - time[i], SAME_INSTANT)
    u = (instants - time[i]) / gap
    start = (1.0 + 2.0 * u) * (1.0 - u) ** 2 * series[i] + u * (1.0 - u) ** 2 * gap * slope[i]
    return start + u**2 * (3.0 - 2.0 * u) * series[i + 1] - u**2 * (1.0 - u) * gap * slope[i + 1]
