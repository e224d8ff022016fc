"""A bandwidth, found: where the stroke first falls among frequencies at equal factors, then by halving the interval in which it does."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp

from smajax.sweep.metrics import FALLEN, bandwidth

# Between two of the frequencies a dip and a recovery are not seen; halvings leave an interval of 1/256 of theirs.
FREQUENCIES, HALVINGS = 8, 8


class Reached(NamedTuple):
    """What a rig does at a frequency, scalars: its stroke, how far the response is from settled, and the simulation's code."""

    stroke: jax.Array
    gap: jax.Array
    code: jax.Array


class _Ends(NamedTuple):
    """The search so far: the first point, the highest one before the fall and the lowest one after it, with their log frequencies."""

    first: tuple[jax.Array, Reached]
    low: tuple[jax.Array, Reached]
    high: tuple[jax.Array, Reached]
    fell: jax.Array
    worst: jax.Array


def find(
    at: Callable[[jax.Array], Reached],
    lowest: jax.Array,
    highest: float,
    again: Callable[[jax.Array], Reached] | None = None,
    least: jax.Array | float = 0.0,
) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Frequency in Hz at which the stroke has fallen to 1 / sqrt(2) of that at ``lowest``, infinite if it does not up to ``highest``.

    NaN where even that stroke is at most ``least``: what does not move does not fall off.
    With it the largest gap of the simulations that it is read off, and the worst code of all. ``at`` is never differentiated; derivatives
    are those of the straight line between the last interval's ends, where ``again`` gives the same as ``at``, with derivatives.
    """
    start = jnp.log(jax.lax.stop_gradient(lowest))
    places = start + (jnp.log(highest) - start) * jnp.linspace(0.0, 1.0, FREQUENCIES)

    def look(ends: _Ends, k: jax.Array) -> tuple[_Ends, None]:
        searching = k < FREQUENCIES
        place = jnp.where(searching, places[jnp.minimum(k, FREQUENCIES - 1)], 0.5 * (ends.low[0] + ends.high[0]))
        point = place, at(jnp.exp(place))
        first = _pick(k == 0, point, ends.first)
        falls = point[1].stroke <= FALLEN * first[1].stroke
        counts = ~(searching & ends.fell)
        low = _pick(counts & ~falls, point, ends.low)
        # Until it falls the interval is empty.
        high = _pick(counts & (falls | ~ends.fell), point, ends.high)
        return _Ends(first, low, high, ends.fell | falls, jnp.maximum(ends.worst, point[1].code)), None

    nothing = jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(lambda: (start, at(jnp.exp(start)))))
    empty = _Ends(nothing, nothing, nothing, jnp.asarray(False), nothing[1].code)
    ends, _ = jax.lax.scan(look, empty, jnp.arange(FREQUENCIES + HALVINGS))
    frequencies = jnp.stack([lowest, jnp.exp(ends.low[0]), jnp.exp(ends.high[0])])
    points = jax.tree.map(lambda *leaves: jnp.stack(leaves), ends.first[1], ends.low[1], ends.high[1])
    if again is not None:
        points = jax.vmap(again)(frequencies)
    found = jnp.where(points.stroke[0] > least, bandwidth(frequencies, points.stroke), jnp.nan)
    return found, jnp.max(points.gap), jnp.maximum(ends.worst, jnp.max(points.code))


def _pick(chosen: jax.Array, one: tuple[jax.Array, Reached], other: tuple[jax.Array, Reached]) -> tuple[jax.Array, Reached]:
    return jax.tree.map(lambda a, b: jnp.where(chosen, a, b), one, other)
