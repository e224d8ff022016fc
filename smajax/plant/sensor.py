"""Sensors, whose reading is gain times value plus offset, and the derivative and the lag of a sampled series."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum
from smajax.parameters.definitions import Declaration, sensor_declarations

# s. Samples that are closer together count as simultaneous, such as repeated samples that fill up a batch; no recording
# is sampled as fast.
SAME_INSTANT = 1e-9
# Share of the time between two samples. With a shorter lag the weight of the previous sample, exp(-1 / 0.02) = 2e-22,
# is below rounding.
_SHORTEST_LAG = 0.02


class Sensor(eqx.Module):
    """Gain and offset of each observed channel: parameters ``sensor.CHANNEL_gain`` and ``sensor.CHANNEL_offset``."""

    gain: dict[str, jax.Array]
    offset: dict[str, jax.Array]

    @classmethod
    def identity(cls, channels: tuple[str, ...]) -> "Sensor":
        """Return sensors with gain 1 and offset 0.

        Args:
            channels: Names of the observed channels.
        """
        return cls({c: jnp.asarray(1.0) for c in channels}, {c: jnp.asarray(0.0) for c in channels})

    def declarations(self) -> dict[str, Declaration]:
        """Return the declarations of the parameters by key, such as ``angle_gain``."""
        return sensor_declarations(self.gain)

    def leaf(self, key: str) -> Any:
        """Return the value of a parameter by its key, such as ``angle_gain``."""
        channel, kind = key.rsplit("_", 1)
        return getattr(self, kind)[channel]

    def read(self, channel: str, value: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the reading of a channel: gain times value plus offset.

        Args:
            channel: Name of the channel; one without a sensor is read unchanged.
            value: Value of the channel, SI and degC.
        """
        if channel not in self.gain:
            return value
        return self.gain[channel] * value + self.offset[channel]


def time_derivative(series: Float[Array, " samples"], time: Float[Array, " samples"]) -> Float[Array, " samples"]:
    """Compute the time derivative of a series, by central differences over the neighbouring samples.

    Args:
        series: Values at the samples.
        time: Times of the samples, s.

    Returns:
        The derivative at the samples, per second.
    """
    return jnp.asarray(jnp.gradient(series)) / maximum(jnp.asarray(jnp.gradient(time)), SAME_INSTANT)


def lag_series(
    series: Float[Array, " samples"], time: Float[Array, " samples"], time_constant: Float[Array, ""]
) -> Float[Array, " samples"]:
    """Pass a series x through a first-order lag, time_constant dy/dt = x - y; differentiable at a time constant of 0.

    Exact for an input that is, between samples, the cubic with the ``time_derivative`` of the series at both ends.

    Args:
        series: Values x at the samples.
        time: Times of the samples, s.
        time_constant: Time constant of the lag, s; with 0 the series is unchanged.

    Returns:
        Values y at the samples; the first one is that of x.
    """
    gap, slope = jnp.diff(time), time_derivative(series, time)
    share = time_constant / maximum(gap, SAME_INSTANT)
    decays = share > _SHORTEST_LAG
    decay = jnp.where(decays, jnp.exp(-1.0 / jnp.where(decays, share, 1.0)), 0.0)
    # x = x_0 + b u + c u^2 + d u^3 between two samples, u in 0..1; the lag reduces each power at u = 1 by its factor
    # here.
    rise, first, last = jnp.diff(series), slope[:-1] * gap, slope[1:] * gap
    linear = share * (1.0 - decay)
    quadratic = 2.0 * share * (1.0 - linear)
    cubic = 3.0 * share * (1.0 - quadratic)
    delayed = first * linear + (3.0 * rise - 2.0 * first - last) * quadratic + (first + last - 2.0 * rise) * cubic
    distinct = gap > SAME_INSTANT
    decay, target = jnp.where(distinct, decay, 1.0), jnp.where(distinct, series[1:] - delayed, series[:-1])

    def filter_sample(output: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
        before, target, decay = row
        output = target + decay * (output - before)
        return output, output

    _, later = jax.lax.scan(filter_sample, series[0], (series[:-1], target, decay), unroll=8)
    return jnp.append(series[:1], later)
