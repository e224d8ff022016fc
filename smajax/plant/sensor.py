"""Sensors: a reading is gain times value plus offset; and the derivative and the lag of a sampled series."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.channels import CHANNELS, channel_of
from smajax.numerics.nonsmooth import maximum
from smajax.parameters import Declaration

# s. Samples that are closer together count as one instant, such as repeated samples that fill up a batch; no recording
# is sampled as fast.
_SAME_INSTANT = 1e-9
# Of the time between two samples. With a shorter lag the previous sample's weight, exp(-1 / 0.02) = 2e-22, is below
# rounding.
_SHORTEST_LAG = 0.02


class Sensor(eqx.Module):
    """Gain and offset of each observed channel: parameters ``sensor.CHANNEL_gain`` and ``sensor.CHANNEL_offset``."""

    gain: dict[str, jax.Array]
    offset: dict[str, jax.Array]

    @classmethod
    def identity(cls, channels: tuple[str, ...]) -> "Sensor":
        """Make sensors with gain 1 and offset 0.

        Args:
            channels: The observed channels.
        """
        return cls({c: jnp.asarray(1.0) for c in channels}, {c: jnp.asarray(0.0) for c in channels})

    def declarations(self) -> dict[str, Declaration]:
        """Return the declared parameters by key."""
        table = {}
        for channel in self.gain:
            unit = CHANNELS[channel_of(channel) or channel].unit
            table[f"{channel}_gain"] = Declaration("1", f"gain of the {channel} sensor", 0.1, 10.0, 1.0)
            offset_unit = "K" if unit == "degC" else unit
            table[f"{channel}_offset"] = Declaration(
                offset_unit, f"offset of the {channel} sensor", -jnp.inf, jnp.inf, 0.0
            )
        return table

    def leaf(self, key: str) -> Any:
        """Return the value of a parameter by its key, such as ``angle_gain``."""
        channel, kind = key.rsplit("_", 1)
        return getattr(self, kind)[channel]

    def read(self, channel: str, value: Float[Array, "..."]) -> Float[Array, "..."]:
        """Compute the reading of a channel from its value; a channel without a sensor is read as it is."""
        if channel not in self.gain:
            return value
        return self.gain[channel] * value + self.offset[channel]


def time_derivative(series: Float[Array, " samples"], time: Float[Array, " samples"]) -> Float[Array, " samples"]:
    """Compute the derivative of a series per second, by central differences over the neighbouring samples.

    Args:
        series: Values at the samples.
        time: Times of the samples in s.
    """
    return jnp.asarray(jnp.gradient(series)) / maximum(jnp.asarray(jnp.gradient(time)), _SAME_INSTANT)


def lag_series(
    series: Float[Array, " samples"], time: Float[Array, " samples"], time_constant: Float[Array, ""]
) -> Float[Array, " samples"]:
    """Pass a series through a first-order lag; differentiable also at a time constant of 0, where nothing changes.

    Exact for an input that is, between samples, the cubic with the series' ``time_derivative`` at both ends.

    Args:
        series: Values at the samples.
        time: Times of the samples in s.
        time_constant: Time constant of the lag in s.
    """
    gap, slope = jnp.diff(time), time_derivative(series, time)
    share = time_constant / maximum(gap, _SAME_INSTANT)
    decays = share > _SHORTEST_LAG
    decay = jnp.where(decays, jnp.exp(-1.0 / jnp.where(decays, share, 1.0)), 0.0)
    # x = x_0 + b u + c u^2 + d u^3 between two samples, u in 0..1; the lag reduces each power at u = 1 by its factor
    # here.
    rise, first, last = jnp.diff(series), slope[:-1] * gap, slope[1:] * gap
    linear = share * (1.0 - decay)
    quadratic = 2.0 * share * (1.0 - linear)
    cubic = 3.0 * share * (1.0 - quadratic)
    delayed = first * linear + (3.0 * rise - 2.0 * first - last) * quadratic + (first + last - 2.0 * rise) * cubic
    distinct = gap > _SAME_INSTANT
    decay, target = jnp.where(distinct, decay, 1.0), jnp.where(distinct, series[1:] - delayed, series[:-1])

    def filter_sample(output: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
        before, target, decay = row
        output = target + decay * (output - before)
        return output, output

    _, later = jax.lax.scan(filter_sample, series[0], (series[:-1], target, decay), unroll=8)
    return jnp.append(series[:1], later)
