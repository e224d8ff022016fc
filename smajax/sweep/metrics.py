"""What a design does, as numbers: read off its response over the last cycle, or off the rest after it.

Every metric is a scalar of the channels over time, differentiable wherever the extremes that it is read off stay where they are.
"""

from collections.abc import Callable, Mapping
from typing import NamedTuple

import jax
import jax.numpy as jnp

from smajax.kinks import larger, largest, swing
from smajax.plant.plant import Plant
from smajax.units import numbered

Channels = Mapping[str, jax.Array]
# The share of its excess over the surroundings that a wire has lost when it counts as cooled, and the fall that ends a bandwidth.
COOLED, FALLEN = 0.9, 2.0**-0.5
# Cycles that close to within this share of their range have settled.
SETTLED = 0.01
_STILL, _EVEN = 1e-7, 1e-3


class Response(NamedTuple):
    """A rig's response: ``time`` (n,) in s, ``channels`` by name (n,) in SI, ``coordinate`` the name of the one that moves.

    ``motion`` is that of a wire's end per strain, in m; each of the ``wires`` stands for ``parallel`` alike.
    """

    time: jax.Array
    channels: Channels
    coordinate: str
    wires: int
    motion: jax.Array
    ambient: jax.Array
    parallel: jax.Array | float

    def of(self, name: str) -> jax.Array:
        """A channel of all wires, shape ``(wires, n)``."""
        return jnp.stack([self.channels[n] for n in numbered(name, self.wires)])

    def cut(self, part: slice) -> "Response":
        """A part of it."""
        return self._replace(time=self.time[part], channels={n: v[part] for n, v in self.channels.items()})


class Metric(NamedTuple):
    """``read`` takes the response over a part of the input: the last ``cycle``, the ``rest`` after it, or ``all``. ``reads`` are channels.

    ``unit`` is empty where it is that of the rig's coordinate.
    """

    unit: str
    meaning: str
    part: str
    reads: tuple[str, ...]
    read: Callable[[Response], jax.Array]


def still(plant: Plant) -> jax.Array:
    """The stroke of a plant, in m or rad, up to which its wires count as not moving."""
    return _STILL * jnp.abs(plant.wire.motion_per_strain)


def stroke(cycle: Response) -> jax.Array:
    """Largest less smallest value of the coordinate, in m or rad."""
    return swing(cycle.channels[cycle.coordinate])


def force(whole: Response) -> jax.Array:
    """The largest pull in a wire, N."""
    return largest(whole.of("force"))


def peak_stress(whole: Response) -> jax.Array:
    """The largest stress in a wire, Pa."""
    return largest(whole.of("stress"))


def peak_temperature(whole: Response) -> jax.Array:
    """The hottest wire's highest temperature, degC."""
    return largest(whole.of("temperature"))


def energy_per_cycle(cycle: Response) -> jax.Array:
    """Electrical energy into all wires, J; the power is that at the start of each step, from which on the input is held."""
    return cycle.parallel * jnp.sum(cycle.of("power")[:, :-1] * jnp.diff(cycle.time)[None, :])


def work_per_cycle(cycle: Response) -> jax.Array:
    """Work that the wires do while they shorten, J: the integral of force over shortening, where that is positive."""
    pull, strain = cycle.of("force"), cycle.of("strain")
    shortened = -jnp.diff(strain, axis=1) * cycle.motion
    return cycle.parallel * jnp.sum(larger(0.5 * (pull[:, 1:] + pull[:, :-1]) * shortened, 0.0))


def efficiency(cycle: Response) -> jax.Array:
    """Work over electrical energy of a cycle."""
    return work_per_cycle(cycle) / energy_per_cycle(cycle)


def time_to_cool(rest: Response) -> jax.Array:
    """Seconds in which wire 1 loses 90 % of its excess over the surroundings after heating; infinite if it does not within the rest."""
    excess = rest.of("temperature")[0] - rest.ambient
    level = (1.0 - COOLED) * excess[0]
    return jnp.where(jnp.all(excess > level), jnp.inf, crossing(rest.time - rest.time[0], excess, level))


def settling(cycle: Response) -> jax.Array:
    """How far a cycle is from closing: the gap between its start and its end over its range, for motion and temperatures the largest.

    0 where the response repeats itself. A wire that still warms up by so large a share of what a cycle's heating makes has about that
    share of the way to its periodic state before it. Ranges below a strain of 1e-7 and 1 mK count as these.
    """
    closing = [_gap(cycle.channels[cycle.coordinate], _STILL * jnp.abs(cycle.motion))]
    closing += [_gap(one, jnp.asarray(_EVEN)) for one in cycle.of("temperature")]
    return largest(jnp.stack(closing))


def _gap(values: jax.Array, least: jax.Array) -> jax.Array:
    return jnp.abs(values[-1] - values[0]) / larger(swing(values), least)


def crossing(at: jax.Array, values: jax.Array, level: jax.Array) -> jax.Array:
    """Where values, shape ``(n,)``, first fall to a level, by straight lines between the points ``at``; NaN if they never do."""
    below = values <= level
    k = jnp.maximum(jnp.argmax(below), 1)
    before, after = values[k - 1], values[k]
    fall = before - after
    share = (before - level) / jnp.where(fall > 0.0, fall, 1.0)
    return jnp.where(jnp.any(below) & ~below[0], at[k - 1] + share * (at[k] - at[k - 1]), jnp.nan)


METRICS: Mapping[str, Metric] = {
    "stroke": Metric("", "largest less smallest position in a cycle", "cycle", (), stroke),
    "force": Metric("N", "largest pull in a wire", "all", ("force",), force),
    "peak_stress": Metric("Pa", "largest stress in a wire", "all", ("stress",), peak_stress),
    "peak_temperature": Metric("degC", "highest temperature of a wire", "all", ("temperature",), peak_temperature),
    "energy_per_cycle": Metric("J", "electrical energy of a cycle", "cycle", ("power",), energy_per_cycle),
    "work_per_cycle": Metric("J", "work of the wires while they shorten, in a cycle", "cycle", ("force", "strain"), work_per_cycle),
    "efficiency": Metric("1", "work over electrical energy of a cycle", "cycle", ("force", "strain", "power"), efficiency),
    "time_to_cool": Metric(
        "s", "time after heating in which a wire loses 90 % of its excess temperature", "rest", ("temperature",), time_to_cool
    ),
    "settling": Metric("1", "gap between start and end of the last cycle over its range", "cycle", ("temperature",), settling),
}
BANDWIDTH = Metric("Hz", "frequency at which the stroke has fallen to 0.71 of that at the wave's own", "", (), stroke)


def bandwidth(frequencies: jax.Array, strokes: jax.Array) -> jax.Array:
    """Frequency in Hz at which the stroke, shape ``(n,)``, has fallen to 1 / sqrt(2) of the first one; infinite if it never does."""
    found = crossing(jnp.log(frequencies), strokes, FALLEN * strokes[0])
    return jnp.where(jnp.all(strokes > FALLEN * strokes[0]), jnp.inf, jnp.exp(found))
