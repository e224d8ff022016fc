"""Metrics of a design: scalars of its response over the last cycle, over the whole input, or over the rest after it.

A metric is differentiable while the extremes that determine it stay at the same grid points.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.channels import CHANNELS, numbered
from smajax.numerics.nonsmooth import largest, maximum, peak_to_peak
from smajax.plant.plant import Plant

Channels = Mapping[str, jax.Array]
# Share of its excess temperature that a cooled wire has lost: the definition of ``time_to_cool``.
COOLED_SHARE = 0.9
# Stroke at the bandwidth relative to that at the lowest frequency: half the power, -3 dB.
BANDWIDTH_DROP = 2.0**-0.5
# A last cycle whose gap is at most this share of its range has settled; docs/ and the sweep file state the same 1 %.
SETTLED_GAP = 0.01
# Strain range and temperature range (K) below which a response counts as constant: a gap relative to a smaller range
# would be rounding. Chosen by trial; test_bandwidth_of_a_rig_against_dense_frequencies checks the first.
_MOTIONLESS_STRAIN = 1e-7
_EVEN_TEMPERATURE = 1e-3
# Rounding error of a recording's times, relative to a cycle.
_TIME_TOLERANCE = 1e-9


class Response(NamedTuple):
    """Response of a rig to an input.

    Attributes:
        time: Time in s, shape ``(n,)``.
        channels: Channels by name in SI units and degC, shape ``(n,)`` each.
        coordinate: Name of the channel of the mechanism's coordinate, ``displacement`` or ``angle``.
        wires: Number of simulated wires.
        motion: Motion of a wire's end per strain, m, a scalar.
        ambient: Ambient temperature, degC, a scalar.
        parallel: Number of equal parallel wires that each simulated wire represents.
    """

    time: jax.Array
    channels: Channels
    coordinate: str
    wires: int
    motion: jax.Array
    ambient: jax.Array
    parallel: jax.Array | float

    def of(self, name: str) -> Float[Array, "wires n"]:
        """Return a channel, such as ``temperature``, of all wires."""
        return jnp.stack([self.channels[n] for n in numbered(name, self.wires)])

    def cut(self, part: slice) -> "Response":
        """Return the response at a slice of its grid points."""
        return self._replace(time=self.time[part], channels={n: v[part] for n, v in self.channels.items()})


class Metric(NamedTuple):
    """Definition of a metric of a rig.

    Attributes:
        unit: Internal unit; empty if it is that of the rig's coordinate.
        meaning: Description.
        part: Part of the response that determines it: the last ``cycle``, the ``rest`` after it, or ``all``.
        reads: Channels that it needs in addition to the coordinate.
        read: Maps that part of the response to the metric, a scalar.
    """

    unit: str
    meaning: str
    part: str
    reads: tuple[str, ...]
    read: Callable[[Response], jax.Array]


def response_of(plant: Plant, time: jax.Array, channels: Channels) -> Response:
    """Return the response of a plant.

    Args:
        plant: The plant.
        time: Time in s, shape ``(n,)``.
        channels: Channels by name in SI units and degC, shape ``(n,)`` each.
    """
    mechanism = plant.mechanism
    return Response(
        time,
        channels,
        mechanism.coordinate,
        mechanism.wires,
        plant.wire.motion_per_strain,
        plant.environment.ambient,
        mechanism.parallel_wires,
    )


def metrics_of_cycles(plant: Plant, time: jax.Array, channels: Channels, cycles: int) -> dict[str, tuple[float, str]]:
    """Return the metrics of a response of several equal cycles.

    Args:
        plant: The plant.
        time: Time in s, shape ``(n,)``.
        channels: All channels by name in SI units and degC, shape ``(n,)`` each.
        cycles: Number of cycles; the last one determines the metrics of a cycle.

    Returns:
        Value and internal unit by name; without those that need a rest after the last cycle.
    """
    response = response_of(plant, time, channels)
    length = float(time[-1] - time[0]) / cycles
    last = int(np.searchsorted(np.asarray(time), float(time[-1]) - length * (1.0 + _TIME_TOLERANCE)))
    parts = {"cycle": response.cut(slice(last, len(time))), "all": response}
    own = CHANNELS[plant.mechanism.coordinate].unit
    return {
        name: (float(metric.read(parts[metric.part])), metric.unit or own)
        for name, metric in METRICS.items()
        if metric.part in parts
    }


def motionless_stroke(plant: Plant) -> Float[Array, ""]:
    """Return the stroke of a plant, m or rad, up to which its wires count as motionless."""
    return _MOTIONLESS_STRAIN * jnp.abs(plant.wire.motion_per_strain)


def stroke(cycle: Response) -> Float[Array, ""]:
    """Return the largest minus the smallest value of the coordinate, m or rad."""
    return peak_to_peak(cycle.channels[cycle.coordinate])


def force(whole: Response) -> Float[Array, ""]:
    """Return the largest tension in a wire, N."""
    return largest(whole.of("force"))


def peak_stress(whole: Response) -> Float[Array, ""]:
    """Return the largest stress in a wire, Pa."""
    return largest(whole.of("stress"))


def peak_temperature(whole: Response) -> Float[Array, ""]:
    """Return the highest temperature of a wire, degC."""
    return largest(whole.of("temperature"))


def strain_range(cycle: Response) -> Float[Array, ""]:
    """Return the largest minus the smallest strain of a wire."""
    return largest(jnp.stack([peak_to_peak(strain) for strain in cycle.of("strain")]))


def energy_per_cycle(cycle: Response) -> Float[Array, ""]:
    """Return the electrical energy of all wires, J: the sum of step times power at the start of the step."""
    return cycle.parallel * jnp.sum(cycle.of("power")[:, :-1] * jnp.diff(cycle.time)[None, :])


def work_per_cycle(cycle: Response) -> Float[Array, ""]:
    """Return the work of the wires while they shorten, J: the integral of force over shortening, where positive."""
    pull, strain = cycle.of("force"), cycle.of("strain")
    shortened = -jnp.diff(strain, axis=1) * cycle.motion
    return cycle.parallel * jnp.sum(maximum(0.5 * (pull[:, 1:] + pull[:, :-1]) * shortened, 0.0))


def efficiency(cycle: Response) -> Float[Array, ""]:
    """Return the ratio of work to electrical energy of a cycle."""
    return work_per_cycle(cycle) / energy_per_cycle(cycle)


def time_to_cool(rest: Response) -> Float[Array, ""]:
    """Return the time, s, in which wire 1 loses 90 % of its excess temperature; infinite if the rest is too short."""
    excess = rest.of("temperature")[0] - rest.ambient
    level = (1.0 - COOLED_SHARE) * excess[0]
    return jnp.where(jnp.all(excess > level), jnp.inf, first_crossing(rest.time - rest.time[0], excess, level))


def settling(cycle: Response) -> Float[Array, ""]:
    """Return the settling gap of a cycle: the difference of its start and end, relative to its range.

    It is the largest over the coordinate and the temperatures of all wires, and 0 for a periodic response. Ranges below
    a strain of 1e-7 or 1 mK are replaced by these.
    """
    gaps = [_gap(cycle.channels[cycle.coordinate], _MOTIONLESS_STRAIN * jnp.abs(cycle.motion))]
    gaps += [_gap(values, jnp.asarray(_EVEN_TEMPERATURE)) for values in cycle.of("temperature")]
    return largest(jnp.stack(gaps))


def _gap(values: jax.Array, min_range: jax.Array) -> jax.Array:
    return jnp.abs(values[-1] - values[0]) / maximum(peak_to_peak(values), min_range)


def first_crossing(points: Float[Array, " n"], values: Float[Array, " n"], level: Float[Array, ""]) -> Float[Array, ""]:
    """Return the point at which values first fall to a level, by linear interpolation.

    Args:
        points: Points, ascending, shape ``(n,)``.
        values: Values at the points, shape ``(n,)``.
        level: The level, a scalar.

    Returns:
        The point, a scalar; NaN if the values never fall to the level, or begin below it.
    """
    below = values <= level
    k = jnp.maximum(jnp.argmax(below), 1)
    before, after = values[k - 1], values[k]
    fall = before - after
    share = (before - level) / jnp.where(fall > 0.0, fall, 1.0)
    crossing = points[k - 1] + share * (points[k] - points[k - 1])
    return jnp.where(jnp.any(below) & ~below[0], crossing, jnp.nan)


METRICS: Mapping[str, Metric] = {
    "stroke": Metric("", "largest minus smallest position in a cycle", "cycle", (), stroke),
    "force": Metric("N", "largest tension in a wire", "all", ("force",), force),
    "peak_stress": Metric("Pa", "largest stress in a wire", "all", ("stress",), peak_stress),
    "peak_temperature": Metric("degC", "highest temperature of a wire", "all", ("temperature",), peak_temperature),
    "strain_range": Metric(
        "1", "largest minus smallest strain of a wire in a cycle", "cycle", ("strain",), strain_range
    ),
    "energy_per_cycle": Metric("J", "electrical energy of a cycle", "cycle", ("power",), energy_per_cycle),
    "work_per_cycle": Metric(
        "J", "work of the wires while they shorten, in a cycle", "cycle", ("force", "strain"), work_per_cycle
    ),
    "efficiency": Metric(
        "1", "work over electrical energy of a cycle", "cycle", ("force", "strain", "power"), efficiency
    ),
    "time_to_cool": Metric(
        "s",
        "time after heating in which a wire loses 90 % of its excess temperature",
        "rest",
        ("temperature",),
        time_to_cool,
    ),
    "settling": Metric(
        "1", "gap between start and end of the last cycle over its range", "cycle", ("temperature",), settling
    ),
}
BANDWIDTH = Metric(
    "Hz", "frequency at which the stroke has fallen to 0.71 of the stroke at the input frequency", "", (), stroke
)


def bandwidth(frequencies: Float[Array, " n"], strokes: Float[Array, " n"]) -> Float[Array, ""]:
    """Return the frequency at which the stroke has fallen to 1 / sqrt(2) of the first stroke.

    The stroke is interpolated linearly over the logarithm of the frequency.

    Args:
        frequencies: Frequencies in Hz, ascending, shape ``(n,)``.
        strokes: Stroke at each frequency, m or rad, shape ``(n,)``.

    Returns:
        The frequency in Hz, a scalar; infinite if the stroke never falls so far.
    """
    crossing = first_crossing(jnp.log(frequencies), strokes, BANDWIDTH_DROP * strokes[0])
    return jnp.where(jnp.all(strokes > BANDWIDTH_DROP * strokes[0]), jnp.inf, jnp.exp(crossing))
