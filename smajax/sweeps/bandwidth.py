"""Bandwidth of a rig: a scan over frequencies, then bisection of the interval in which the stroke falls."""

from collections.abc import Callable
from typing import NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float, Int

from smajax.sweeps.metrics import BANDWIDTH_DROP, bandwidth

# Number of frequencies of the scan. A fall and recovery of the stroke between two neighbours is not detected.
# Chosen by trial.
FREQUENCIES = 8
# Number of bisections of the interval in which the stroke falls: they reduce it to 1/256 on the logarithmic axis.
BISECTIONS = 8


class FrequencyPoint(NamedTuple):
    """Response at one frequency.

    Attributes:
        stroke: Stroke, m or rad, a scalar.
        gap: Settling gap, see ``metrics.settling``, a scalar.
        code: Number of the ``SimulationStatus``, a scalar.
    """

    stroke: jax.Array
    gap: jax.Array
    code: jax.Array


class _Bracket(NamedTuple):
    """State of the search: the first point, the last before the fall, the first after it, with their log frequencies.

    ``fell`` is whether the stroke has fallen at any frequency so far; ``worst_code`` is the largest result code.
    """

    first: tuple[jax.Array, FrequencyPoint]
    low: tuple[jax.Array, FrequencyPoint]
    high: tuple[jax.Array, FrequencyPoint]
    fell: jax.Array
    worst_code: jax.Array


def find_bandwidth(
    evaluate: Callable[[jax.Array], FrequencyPoint],
    lowest: Float[Array, ""],
    highest: float,
    differentiable_evaluate: Callable[[jax.Array], FrequencyPoint] | None = None,
    min_stroke: Float[Array, ""] | float = 0.0,
) -> tuple[Float[Array, ""], Float[Array, ""], Int[Array, ""]]:
    """Find the frequency at which the stroke has fallen to 1 / sqrt(2) of the stroke at the lowest frequency.

    Args:
        evaluate: Maps a frequency in Hz to the response; it is never differentiated.
        lowest: Lowest frequency in Hz, a scalar.
        highest: Highest frequency of the scan in Hz.
        differentiable_evaluate: Same values as ``evaluate``, with derivatives. The bandwidth and its derivatives follow
            from linear interpolation between the ends of the last interval.
        min_stroke: Largest stroke at ``lowest`` that counts as no motion, m or rad, a scalar.

    Returns:
        The bandwidth in Hz (infinite if the stroke does not fall up to ``highest``, NaN without motion), the largest
        settling gap of the simulations that determine it, and the worst result code of all simulations; scalars.
    """
    start = jnp.log(jax.lax.stop_gradient(lowest))
    scan = start + (jnp.log(highest) - start) * jnp.linspace(0.0, 1.0, FREQUENCIES)

    def advance(bracket: _Bracket, k: jax.Array) -> tuple[_Bracket, None]:
        """Take one frequency of the scan, or one of the bisection."""
        scanning = k < FREQUENCIES
        log_frequency = jnp.where(
            scanning, scan[jnp.minimum(k, FREQUENCIES - 1)], 0.5 * (bracket.low[0] + bracket.high[0])
        )
        point = log_frequency, evaluate(jnp.exp(log_frequency))
        first = _select(k == 0, point, bracket.first)
        falls = point[1].stroke <= BANDWIDTH_DROP * first[1].stroke
        counts = ~(scanning & bracket.fell)
        low = _select(counts & ~falls, point, bracket.low)
        # Until the stroke falls the interval is empty.
        high = _select(counts & (falls | ~bracket.fell), point, bracket.high)
        return _Bracket(first, low, high, bracket.fell | falls, jnp.maximum(bracket.worst_code, point[1].code)), None

    zeros = jax.tree.map(
        lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), jax.eval_shape(lambda: (start, evaluate(jnp.exp(start))))
    )
    empty = _Bracket(zeros, zeros, zeros, jnp.asarray(False), zeros[1].code)
    bracket, _ = jax.lax.scan(advance, empty, jnp.arange(FREQUENCIES + BISECTIONS))
    frequencies = jnp.stack([lowest, jnp.exp(bracket.low[0]), jnp.exp(bracket.high[0])])
    points = jax.tree.map(lambda *leaves: jnp.stack(leaves), bracket.first[1], bracket.low[1], bracket.high[1])
    if differentiable_evaluate is not None:
        points = jax.vmap(differentiable_evaluate)(frequencies)
    result = jnp.where(points.stroke[0] > min_stroke, bandwidth(frequencies, points.stroke), jnp.nan)
    return result, jnp.max(points.gap), jnp.maximum(bracket.worst_code, jnp.max(points.code))


def _select(
    condition: jax.Array, point: tuple[jax.Array, FrequencyPoint], other: tuple[jax.Array, FrequencyPoint]
) -> tuple[jax.Array, FrequencyPoint]:
    return jax.tree.map(lambda a, b: jnp.where(condition, a, b), point, other)
