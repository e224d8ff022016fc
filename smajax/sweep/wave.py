"""The input of a sweep: a wave that heats the wires in turn, laid on a grid of steps whose lengths are traced.

A wave has ``cycles`` cycles. Its grid has the same number of steps in every cycle and its edges fall on grid points, so that amplitude and
frequency may vary from design to design, and be differentiated through, in one compiled program. Two wires are heated half a cycle apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax
import jax.numpy as jnp
import numpy as np

from smajax.simulate import Inputs

SHAPES = ("square", "sine", "triangle")
# A rest after the last cycle, in time constants of the slowest part and in steps, of which the first is a share of the fastest part's.
REST, REST_STEPS, _FIRST = 20.0, 240, 0.3


@dataclass(frozen=True)
class Wave:
    """A periodic input: its ``shape``, ``amplitude`` (the top, SI; the bottom is 0), ``frequency`` in Hz, and how many cycles it has.

    ``duty`` is the share of a cycle in which a square wave is on.
    """

    shape: str
    amplitude: float
    frequency: float
    duty: float = 0.5
    cycles: int = 4

    def edges(self, wires: int) -> np.ndarray:
        """Where in a cycle (0 to 1) its pieces begin and end; a held input is constant on each piece."""
        if self.shape != "square":
            return np.array([0.0, 0.5, 1.0])
        starts = [k / wires for k in range(wires)]
        return np.unique(np.round([0.0, 1.0, *((s + d) % 1.0 for s in starts for d in (0.0, self.duty))], 12))

    def pieces(self, wires: int, steps: int) -> np.ndarray:
        """Steps in each piece of a cycle of about ``steps`` steps, at least one each."""
        return np.maximum(1, np.rint(steps * np.diff(self.edges(wires))).astype(int))

    def level(self, phase: jax.Array, wires: int) -> jax.Array:
        """The wave (0 to 1) at points of a cycle, shape ``(n,)``, for each wire: ``(n, wires)``."""
        shifted = (phase[:, None] - jnp.arange(wires)[None, :] / wires) % 1.0
        if self.shape == "square":
            return (shifted < self.duty) * 1.0
        if self.shape == "sine":
            return 0.5 - 0.5 * jnp.cos(2.0 * jnp.pi * shifted)
        return 1.0 - jnp.abs(2.0 * shifted - 1.0)


@dataclass(frozen=True)
class Span:
    """Where what is on a wave's grid: the grid points of the last cycle, and of the rest after it (empty without one)."""

    cycle: slice
    rest: slice


def span(wave: Wave, wires: int, steps: int, rest: bool) -> Span:
    """Where the last cycle and the rest lie on the grid of ``lay``."""
    pieces = wave.pieces(wires, steps)
    per_cycle, heating = int(pieces.sum()), _heating(wave, wires, steps)
    end = wave.cycles * per_cycle
    after = end + heating
    return Span(slice(end - per_cycle, end + 1), slice(after, after + REST_STEPS + 1) if rest else slice(0, 0))


def lay(
    wave: Wave, wires: int, steps: int, values: Mapping[str, jax.Array], modes: tuple[jax.Array, jax.Array] | None = None
) -> Inputs:  # fmt: skip
    """The wave on its grid with about ``steps`` steps a cycle; ``values`` may hold another ``amplitude`` and ``frequency``, scalars.

    With ``modes``, the fastest and the slowest time constant (s) of what cools, the wave begins once more after its last cycle, is
    switched off at the end of wire 1's heating, and stays so for ``REST`` of the slowest.
    """
    amplitude = jnp.asarray(values.get("amplitude", wave.amplitude), jnp.float64)
    period = 1.0 / jnp.asarray(values.get("frequency", wave.frequency), jnp.float64)
    edges, pieces = wave.edges(wires), wave.pieces(wires, steps)
    fractions = np.concatenate([[0.0], *(a + (b - a) * np.arange(1, n + 1) / n for a, b, n in zip(edges, edges[1:], pieces, strict=False))])
    middle = jnp.asarray(0.5 * (fractions[1:] + fractions[:-1]))
    if wave.shape == "square":
        first = last = wave.level(middle, wires)
    else:
        at = wave.level(jnp.asarray(fractions), wires)
        first, last = at[:-1], at[1:]
    durations = jnp.tile(jnp.asarray(np.diff(fractions)), wave.cycles) * period
    before, after = jnp.tile(first, (wave.cycles, 1)), jnp.tile(last, (wave.cycles, 1))
    if modes is not None:
        heating = _heating(wave, wires, steps)
        off = jnp.zeros((REST_STEPS, wires))
        # Cooling is fast at first: the rest's steps grow by equal factors, so that each is as small a share of the time that has passed.
        first_scale = _FIRST * modes[0]
        growth = jnp.log1p(REST * modes[1] / first_scale)
        resting = first_scale * jnp.expm1(growth * jnp.linspace(0.0, 1.0, REST_STEPS + 1))
        durations = jnp.concatenate([durations, jnp.asarray(np.diff(fractions)[:heating]) * period, jnp.diff(resting)])
        before = jnp.concatenate([before, first[:heating], off])
        after = jnp.concatenate([after, last[:heating], off])
    before, after = amplitude * before, amplitude * after
    time = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)])
    sampled = jnp.concatenate([before, after[-1:]])
    return Inputs(time, before, after, jnp.arange(len(time)), sampled)


def _heating(wave: Wave, wires: int, steps: int) -> int:
    """Steps of a cycle until wire 1 is at the end of its heating: where a square wave is switched off, else the top."""
    top = wave.duty if wave.shape == "square" else 0.5
    return int(wave.pieces(wires, steps)[: np.searchsorted(wave.edges(wires), top - 1e-9)].sum())
