"""Periodic input of a sweep, on a time grid whose step lengths are traced.

The grid has the same number of steps in every cycle, and the edges of the input are grid points. So amplitude and
frequency can differ between designs, and be differentiated through, in one compiled program. Two wires are heated half
a cycle apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.simulation.inputs import Inputs

SHAPES = ("square", "sine", "triangle")
# Length of the rest after the last cycle in time constants of the slowest thermal mode: exp(-20) of the excess
# temperature is far below the 10 % at which a wire counts as cooled.
REST_LENGTH = 20.0
# Number of steps of the rest. Chosen by trial; test_metrics_agree_with_the_exact_reference of
# tests/unit/sweeps/test_sweeps.py checks the accuracy.
REST_STEPS = 240
# Scale of the first step of the rest in time constants of the fastest thermal mode; chosen with REST_STEPS.
_FIRST_STEP = 0.3
# Rounding error of the phase of an edge, which must not shift it by a step.
_EDGE_TOLERANCE = 1e-9


@dataclass(frozen=True)
class Excitation:
    """Periodic input between 0 and an amplitude.

    Attributes:
        shape: ``square``, ``sine`` or ``triangle``.
        amplitude: Largest value in the unit of the rig's control (SI).
        frequency: Frequency in Hz.
        duty: Fraction of a cycle in which a square wave is on.
        cycles: Number of cycles.
    """

    shape: str
    amplitude: float
    frequency: float
    duty: float = 0.5
    cycles: int = 4

    def edges(self, wires: int) -> Float[np.ndarray, " edges"]:
        """Return the phases (0 to 1) that divide a cycle into pieces; a square wave is constant on each piece."""
        if self.shape != "square":
            return np.array([0.0, 0.5, 1.0])
        starts = [k / wires for k in range(wires)]
        return np.unique(np.round([0.0, 1.0, *((s + d) % 1.0 for s in starts for d in (0.0, self.duty))], 12))

    def pieces(self, wires: int, steps: int) -> Int[np.ndarray, " pieces"]:
        """Return the number of steps in each piece of a cycle.

        Args:
            wires: Number of wires.
            steps: Approximate number of steps in a cycle.

        Returns:
            Numbers of steps, at least 1 each, shape ``(edges - 1,)``.
        """
        return np.maximum(1, np.rint(steps * np.diff(self.edges(wires))).astype(int))

    def level(self, phase: Float[Array, " points"], wires: int) -> Float[Array, "points wires"]:
        """Return the input of each wire, relative to the amplitude.

        Args:
            phase: Phases of a cycle, 0 to 1, shape ``(points,)``.
            wires: Number of wires.

        Returns:
            Values from 0 to 1, shape ``(points, wires)``.
        """
        shifted = (phase[:, None] - jnp.arange(wires)[None, :] / wires) % 1.0
        if self.shape == "square":
            return (shifted < self.duty) * 1.0
        if self.shape == "sine":
            return 0.5 - 0.5 * jnp.cos(2.0 * jnp.pi * shifted)
        return 1.0 - jnp.abs(2.0 * shifted - 1.0)


@dataclass(frozen=True)
class GridParts:
    """Grid points of the parts of a response.

    Attributes:
        cycle: Grid points of the last cycle.
        rest: Grid points of the rest after it; empty without a rest.
    """

    cycle: slice
    rest: slice


def grid_parts(excitation: Excitation, wires: int, steps: int, rest: bool) -> GridParts:
    """Return the grid points of the last cycle and of the rest on the grid of ``discretise_excitation``.

    Args:
        excitation: The periodic input.
        wires: Number of wires.
        steps: Approximate number of steps in a cycle.
        rest: Whether the input has a rest after its last cycle.
    """
    steps_per_cycle = int(excitation.pieces(wires, steps).sum())
    end = excitation.cycles * steps_per_cycle
    off = end + _heating_steps(excitation, wires, steps)
    return GridParts(slice(end - steps_per_cycle, end + 1), slice(off, off + REST_STEPS + 1) if rest else slice(0, 0))


def discretise_excitation(
    excitation: Excitation,
    wires: int,
    steps: int,
    values: Mapping[str, Float[Array, ""]],
    modes: tuple[Float[Array, ""], Float[Array, ""]] | None = None,
) -> Inputs:
    """Discretise a periodic input.

    Args:
        excitation: The periodic input.
        wires: Number of wires.
        steps: Approximate number of steps in a cycle.
        values: Other values of ``amplitude`` (SI unit) and ``frequency`` (Hz), scalars; may be empty.
        modes: Fastest and slowest thermal time constant in s, scalars. With them a rest follows the last cycle: wire 1
            is heated once more, then the input is off for ``REST_LENGTH`` slowest time constants.

    Returns:
        The input on its grid, with samples at all grid points.
    """
    amplitude = jnp.asarray(values.get("amplitude", excitation.amplitude), jnp.float64)
    period = 1.0 / jnp.asarray(values.get("frequency", excitation.frequency), jnp.float64)
    edges, pieces = excitation.edges(wires), excitation.pieces(wires, steps)
    fractions = np.concatenate(
        [[0.0], *(a + (b - a) * np.arange(1, n + 1) / n for a, b, n in zip(edges, edges[1:], pieces, strict=False))]
    )
    middle = jnp.asarray(0.5 * (fractions[1:] + fractions[:-1]))
    if excitation.shape == "square":
        first = last = excitation.level(middle, wires)
    else:
        levels = excitation.level(jnp.asarray(fractions), wires)
        first, last = levels[:-1], levels[1:]
    durations = jnp.tile(jnp.asarray(np.diff(fractions)), excitation.cycles) * period
    before, after = jnp.tile(first, (excitation.cycles, 1)), jnp.tile(last, (excitation.cycles, 1))
    if modes is not None:
        heating = _heating_steps(excitation, wires, steps)
        off = jnp.zeros((REST_STEPS, wires))
        # Cooling slows down: the steps of the rest grow geometrically, so that each is about the same share of the
        # elapsed time.
        first_scale = _FIRST_STEP * modes[0]
        growth = jnp.log1p(REST_LENGTH * modes[1] / first_scale)
        resting = first_scale * jnp.expm1(growth * jnp.linspace(0.0, 1.0, REST_STEPS + 1))
        durations = jnp.concatenate([durations, jnp.asarray(np.diff(fractions)[:heating]) * period, jnp.diff(resting)])
        before = jnp.concatenate([before, first[:heating], off])
        after = jnp.concatenate([after, last[:heating], off])
    before, after = amplitude * before, amplitude * after
    time = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)])
    sampled = jnp.concatenate([before, after[-1:]])
    return Inputs(time, before, after, jnp.arange(len(time)), sampled)


def _heating_steps(excitation: Excitation, wires: int, steps: int) -> int:
    """Steps of a cycle until the heating of wire 1 ends: at a square wave's switch-off, else at the largest value."""
    end = excitation.duty if excitation.shape == "square" else 0.5
    last = np.searchsorted(excitation.edges(wires), end - _EDGE_TOLERANCE)
    return int(excitation.pieces(wires, steps)[:last].sum())
