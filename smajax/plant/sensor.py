"""Sensors: from what a channel is to what its column says, gain times value plus offset."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.kinks import larger
from smajax.parameters import Declaration
from smajax.units import CHANNELS, channel_of


class Sensor(eqx.Module):
    """Gain and offset of each observed channel. Their parameters are ``sensor.CHANNEL_gain`` and ``sensor.CHANNEL_offset``."""

    gain: dict[str, jax.Array]
    offset: dict[str, jax.Array]

    @classmethod
    def identity(cls, channels: tuple[str, ...]) -> "Sensor":
        """Sensors that tell the truth."""
        return cls({c: jnp.asarray(1.0) for c in channels}, {c: jnp.asarray(0.0) for c in channels})

    def declarations(self) -> dict[str, Declaration]:
        """The declared parameters by key."""
        table = {}
        for channel in self.gain:
            unit = CHANNELS[channel_of(channel) or channel].unit
            table[f"{channel}_gain"] = Declaration("1", f"gain of the {channel} sensor", 0.1, 10.0, 1.0)
            offset_unit = "K" if unit == "degC" else unit
            table[f"{channel}_offset"] = Declaration(offset_unit, f"offset of the {channel} sensor", -jnp.inf, jnp.inf, 0.0)
        return table

    def leaf(self, key: str) -> Any:
        """The leaf behind a parameter key."""
        channel, kind = key.rsplit("_", 1)
        return getattr(self, kind)[channel]

    def read(self, channel: str, value: jax.Array) -> jax.Array:
        """What the column of ``channel`` says."""
        if channel not in self.gain:
            return value
        return self.gain[channel] * value + self.offset[channel]


_INSTANT = 1e-9  # s; samples no further apart are one, as fillings are


def slopes(series: jax.Array, time: jax.Array) -> jax.Array:
    """How fast a series, shape ``(n,)``, changes at its samples, per second: as it does between the samples beside each."""
    return jnp.asarray(jnp.gradient(series)) / larger(jnp.asarray(jnp.gradient(time)), _INSTANT)


def lagged(series: jax.Array, time: jax.Array, constant: jax.Array) -> jax.Array:
    """A series, shape ``(n,)``, behind a first-order lag of time constant ``constant`` s.

    Exact for what is, between samples, a cubic with the series' ``slopes``. Differentiable at 0, where it is the series itself.
    """
    gap, slope = jnp.diff(time), slopes(series, time)
    share = constant / larger(gap, _INSTANT)
    decays = share > 0.02  # below, what is left of the last sample is under rounding
    stays = jnp.where(decays, jnp.exp(-1.0 / jnp.where(decays, share, 1.0)), 0.0)
    # x = x_0 + b u + c u^2 + d u^3 from one sample to the next one; behind the lag each power loses so much of what it has come to.
    rise, first, last = jnp.diff(series), slope[:-1] * gap, slope[1:] * gap
    linear = share * (1.0 - stays)
    quadratic = 2.0 * share * (1.0 - linear)
    cubic = 3.0 * share * (1.0 - quadratic)
    lost = first * linear + (3.0 * rise - 2.0 * first - last) * quadratic + (first + last - 2.0 * rise) * cubic
    apart = gap > _INSTANT
    stays, towards = jnp.where(apart, stays, 1.0), jnp.where(apart, series[1:] - lost, series[:-1])

    def follow(y: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
        before, towards, stays = row
        y = towards + stays * (y - before)
        return y, y

    _, rest = jax.lax.scan(follow, series[0], (series[:-1], towards, stays), unroll=8)
    return jnp.append(series[:1], rest)
