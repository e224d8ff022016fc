"""Metrics of a design: scalars of its response over the last cycle, over the whole input, or over the rest after it.

Every metric is differentiable wherever the extremes that it is read off stay at the same grid points.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.channels import numbered
from smajax.numerics.nonsmooth import largest, maximum, peak_to_peak
from smajax.plant.plant import Plant

Channels = Mapping[str, jax.Array]
# Share of its excess over the surroundings that a wire has lost when it counts as cooled: the definition of
# ``time_to_cool``.
COOLED_SHARE = 0.9
# Fall of the stroke that ends a bandwidth: half the power, -3 dB.
BANDWIDTH_DROP = 2.0**-0.5
# A last cycle whose gap is at most this share of its range has settled; docs/ and the sweep file state the same 1 %.
SETTLED_GAP = 0.01
# Strain range below which a wire does not move, and temperature range in K below which it is evenly warm: rounding
# makes gaps of such ranges meaningless. Chosen by trial; test_bandwidth_of_a_rig_against_dense_frequencies holds the
# first.
_MOTIONLESS_STRAIN = 1e-7
_EVEN_TEMPERATURE = 1e-3


class Response(NamedTuple):
    """Response of a rig to an input.

    Args:
        time: Time in s, shape ``(n,)``.
        channels: Channels by name in SI units and degC, shape ``(n,)`` each.
        coordinate: Name of the channel that moves.
        wires: Number of wires.
        motion: Motion of a wire's end per strain, m, a scalar.
        ambient: Temperature of the surroundings, degC, a scalar.
        parallel: Number of equal wires that each of the ``wires`` stands for.
    """

    time: jax.Array
    channels: Channels
    coordinate: str
    wires: int
    motion: jax.Array
    ambient: jax.Array
    parallel: jax.Array | float

    def of(self, name: str) -> Float[Array, "wires n"]:
        """Return a channel of all wires."""
        return jnp.stack([self.channels[n] for n in numbered(name, self.wires)])

    def cut(self, part: slice) -> "Response":
        """Return the response over a part of the grid points."""
        return self._replace(time=self.time[part], channels={n: v[part] for n, v in self.channels.items()})


class Metric(NamedTuple):
    """A metric of a rig.

    Args:
        unit: Internal unit; empty where it is that of the rig's coordinate.
        meaning: Description.
        part: Part of the response that is read: the last ``cycle``, the ``rest`` after it, or ``all``.
        reads: Channels that are read, next to the coordinate.
        read: Maps that part of the response to the metric, a scalar.
    """

    unit: str
    meaning: str
    part: str
    reads: tuple[str, ...]
    read: Callable[[Response], jax.Array]


def motionless_stroke(plant: Plant) -> jax.Array:
    """Return the stroke of a plant, m or rad, up to which its wires count as motionless."""
    return _MOTIONLESS_STRAIN * jnp.abs(plant.wire.motion_per_strain)


def stroke(cycle: Response) -> jax.Array:
    """Return the largest less the smallest value of the coordinate, m or rad."""
    return peak_to_peak(cycle.channels[cycle.coordinate])


def force(whole: Response) -> jax.Array:
    """Return the largest pull in a wire, N."""
    return largest(whole.of("force"))


def peak_stress(whole: Response) -> jax.Array:
    """Return the largest stress in a wire, Pa."""
    return largest(whole.of("stress"))


def peak_temperature(whole: Response) -> jax.Array:
    """Return the highest temperature of a wire, degC."""
    return largest(whole.of("temperature"))


def energy_per_cycle(cycle: Response) -> jax.Array:
    """Return the electrical energy into all wires, J, with the power at the start of each step held over the step."""
    return cycle.parallel * jnp.sum(cycle.of("power")[:, :-1] * jnp.diff(cycle.time)[None, :])


def work_per_cycle(cycle: Response) -> jax.Array:
    """Return the work of the wires while they shorten, J: the integral of force over shortening, if positive."""
    pull, strain = cycle.of("force"), cycle.of("strain")
    shortened = -jnp.diff(strain, axis=1) * cycle.motion
    return cycle.parallel * jnp.sum(maximum(0.5 * (pull[:, 1:] + pull[:, :-1]) * shortened, 0.0))


def efficiency(cycle: Response) -> jax.Array:
    """Return work over electrical energy of a cycle."""
    return work_per_cycle(cycle) / energy_per_cycle(cycle)


def time_to_cool(rest: Response) -> jax.Array:
    """Return the time in s in which wire 1 loses 90 % of its excess temperature; infinite beyond the rest."""
    excess = rest.of("temperature")[0] - rest.ambient
    level = (1.0 - COOLED_SHARE) * excess[0]
    return jnp.where(jnp.all(excess > level), jnp.inf, first_crossing(rest.time - rest.time[0], excess, level))


def settling(cycle: Response) -> jax.Array:
    """Return how far a cycle is from closing: the gap between its start and end over its range.

    The largest of coordinate and temperatures counts; it is 0 where the response repeats itself. A wire whose mean
    temperature still rises by some share of what the heating of one cycle adds has about that share of the way to its
    periodic state before it. Ranges below a strain of 1e-7 and 1 mK count as these.
    """
    gaps = [_gap(cycle.channels[cycle.coordinate], _MOTIONLESS_STRAIN * jnp.abs(cycle.motion))]
    gaps += [_gap(values, jnp.asarray(_EVEN_TEMPERATURE)) for values in cycle.of("temperature")]
    return largest(jnp.stack(gaps))


def _gap(values: jax.Array, min_range: jax.Array) -> jax.Array:
    return jnp.abs(values[-1] - values[0]) / maximum(peak_to_peak(values), min_range)


def first_crossing(points: Float[Array, " n"], values: Float[Array, " n"], level: jax.Array) -> jax.Array:
    """Return where values first fall to a level, by linear interpolation between ``points``; NaN if they never do."""
    below = values <= level
    k = jnp.maximum(jnp.argmax(below), 1)
    before, after = values[k - 1], values[k]
    fall = before - after
    share = (before - level) / jnp.where(fall > 0.0, fall, 1.0)
    crossing = points[k - 1] + share * (points[k] - points[k - 1])
    return jnp.where(jnp.any(below) & ~below[0], crossing, jnp.nan)


METRICS: Mapping[str, Metric] = {
    "stroke": Metric("", "largest less smallest position in a cycle", "cycle", (), stroke),
    "force": Metric("N", "largest pull in a wire", "all", ("force",), force),
    "peak_stress": Metric("Pa", "largest stress in a wire", "all", ("stress",), peak_stress),
    "peak_temperature": Metric("degC", "highest temperature of a wire", "all", ("temperature",), peak_temperature),
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
BANDWIDTH = Metric("Hz", "frequency at which the stroke has fallen to 0.71 of that at the input's own", "", (), stroke)


def bandwidth(frequencies: Float[Array, " n"], strokes: Float[Array, " n"]) -> jax.Array:
    """Return the frequency in Hz at which the stroke has fallen to 1 / sqrt(2) of the first; infinite if it never does.

    By linear interpolation of the stroke over the logarithm of the frequency.
    """
    crossing = first_crossing(jnp.log(frequencies), strokes, BANDWIDTH_DROP * strokes[0])
    return jnp.where(jnp.all(strokes > BANDWIDTH_DROP * strokes[0]), jnp.inf, jnp.exp(crossing))
