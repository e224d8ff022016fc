"""Periodic input of a sweep, on a time grid whose step lengths are traced.

The grid has the same number of steps in every cycle, and the edges of the input are grid points. So amplitude, offset,
frequency and duty can differ between designs, and be differentiated through, in one compiled program; the shape can
differ, too. Two wires are heated half a cycle apart.
"""

from collections.abc import Mapping
from dataclasses import dataclass

import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.simulation.inputs import Inputs

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
    """Periodic input: an offset, and a wave between 0 and an amplitude that is added to it.

    Attributes:
        shape: ``square``, ``sine`` or ``triangle``.
        amplitude: Largest value of the wave in the unit of the rig's control (SI).
        frequency: Frequency in Hz.
        duty: Fraction of a cycle in which a square wave is on.
        cycles: Number of cycles.
        offset: Input between the waves, in the unit of the amplitude.
        duties: Lowest and highest duty where it differs between designs; ``None`` where all have ``duty``.
        shapes: Shapes where they differ between designs, which choose one by its index; empty where all have ``shape``.
    """

    shape: str
    amplitude: float
    frequency: float
    duty: float = 0.5
    cycles: int = 4
    offset: float = 0.0
    duties: tuple[float, float] | None = None
    shapes: tuple[str, ...] = ()

    @property
    def all_shapes(self) -> tuple[str, ...]:
        """Shapes of the designs."""
        return self.shapes or (self.shape,)

    def fixed_phases(self, wires: int) -> set[float]:
        """Return the phases, 0 to 1, of edges and reversals that are the same in all designs."""
        fixed = {0.0, 1.0}
        if "square" in self.all_shapes:
            fixed |= {k / wires for k in range(wires)}
        if set(self.all_shapes) != {"square"}:
            fixed.add(0.5)
        return fixed

    def edges(self, wires: int) -> Float[np.ndarray, " edges"]:
        """Return the phases (0 to 1) that divide a cycle into pieces; a square wave is constant on each piece.

        Where the duty differs between designs they are those of the middle of its range.
        """
        phases = sorted(self.fixed_phases(wires))
        if "square" in self.all_shapes:
            middle = self.duty if self.duties is None else 0.5 * (self.duties[0] + self.duties[1])
            phases += [(k / wires + middle) % 1.0 for k in range(wires)]
        return np.unique(np.round(phases, 12))

    def edges_at(self, duty: Float[Array, ""] | float, wires: int) -> Float[Array, " edges"]:
        """Return the edges at a duty of ``duties``, in the order of ``edges``, which no duty in this range changes."""
        edges, middle, moving = self._moving_edges(wires)
        return jnp.asarray(edges) + jnp.asarray(moving) * (duty - middle)

    def _moving_edges(self, wires: int) -> tuple[np.ndarray, float, np.ndarray]:
        """Edges in the middle of ``duties``, that middle, and 1 for each edge that moves with the duty, else 0."""
        low, high = self.duties or (self.duty, self.duty)
        edges = self.edges(wires)
        fixed = np.round(sorted(self.fixed_phases(wires)), 12)
        return edges, 0.5 * (low + high), np.where(np.isin(edges, fixed), 0.0, 1.0)

    def pieces(self, wires: int, steps: int) -> Int[np.ndarray, " pieces"]:
        """Return the number of steps in each piece of a cycle.

        Args:
            wires: Number of wires.
            steps: Approximate number of steps in a cycle, by which the longest piece of all designs is divided.

        Returns:
            Numbers of steps, at least 1 each, shape ``(edges - 1,)``.
        """
        edges, middle, moving = self._moving_edges(wires)
        lengths = np.diff(edges)
        if self.duties is not None:
            # Lengths are linear in the duty, so that the longest is at an end of the range.
            lengths = np.max([np.diff(edges + moving * (end - middle)) for end in self.duties], axis=0)
        return np.maximum(1, np.rint(steps * lengths).astype(int))

    def level(
        self, phase: Float[Array, " points"], wires: int, shape: str, duty: Float[Array, ""] | float
    ) -> Float[Array, "points wires"]:
        """Return the wave of each wire, relative to the amplitude.

        Args:
            phase: Phases of a cycle, 0 to 1, shape ``(points,)``.
            wires: Number of wires.
            shape: Shape of the wave.
            duty: Fraction of a cycle in which a square wave is on.

        Returns:
            Values from 0 to 1, shape ``(points, wires)``.
        """
        shifted = (phase[:, None] - jnp.arange(wires)[None, :] / wires) % 1.0
        if shape == "square":
            return (shifted < duty) * 1.0
        if shape == "sine":
            return 0.5 - 0.5 * jnp.cos(2.0 * jnp.pi * shifted)
        return 1.0 - jnp.abs(2.0 * shifted - 1.0)

    def step_levels(
        self, fractions: Float[Array, " points"], wires: int, values: Mapping[str, Float[Array, ""]]
    ) -> tuple[Float[Array, "steps wires"], Float[Array, "steps wires"]]:
        """Return the wave at the start and at the end of each step of a cycle, relative to the amplitude.

        Args:
            fractions: Phases of the grid points of a cycle, shape ``(points,)``.
            wires: Number of wires.
            values: Values of the design, of which ``duty`` and ``wave`` are used.
        """
        duty, pairs = values.get("duty", self.duty), []
        for shape in self.all_shapes:
            if shape == "square":
                held = self.level(0.5 * (fractions[1:] + fractions[:-1]), wires, shape, duty)
                pairs.append((held, held))
            else:
                levels = self.level(fractions, wires, shape, duty)
                pairs.append((levels[:-1], levels[1:]))
        if not self.shapes:
            return pairs[0]
        chosen = jnp.asarray(values["wave"]).astype(int)
        return jnp.stack([pair[0] for pair in pairs])[chosen], jnp.stack([pair[1] for pair in pairs])[chosen]


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
        values: Other values of ``amplitude`` and ``offset`` (SI unit), ``frequency`` (Hz), ``duty``, and ``wave``, the
            index of a shape, scalars; may be empty.
        modes: Fastest and slowest thermal time constant in s, scalars. With them a rest follows the last cycle: wire 1
            is heated once more, then the input is off for ``REST_LENGTH`` slowest time constants.

    Returns:
        The input on its grid, with samples at all grid points.
    """
    amplitude = jnp.asarray(values.get("amplitude", excitation.amplitude), jnp.float64)
    period = 1.0 / jnp.asarray(values.get("frequency", excitation.frequency), jnp.float64)
    fractions = _cycle_fractions(excitation, wires, steps, values)
    first, last = excitation.step_levels(jnp.asarray(fractions), wires, values)
    shares = fractions[1:] - fractions[:-1]
    durations = jnp.tile(jnp.asarray(shares), excitation.cycles) * period
    before, after = jnp.tile(first, (excitation.cycles, 1)), jnp.tile(last, (excitation.cycles, 1))
    if modes is not None:
        heating = _heating_steps(excitation, wires, steps)
        off = jnp.zeros((REST_STEPS, wires))
        # Cooling slows down: the steps of the rest grow geometrically, so that each is about the same share of the
        # elapsed time.
        first_scale = _FIRST_STEP * modes[0]
        growth = jnp.log1p(REST_LENGTH * modes[1] / first_scale)
        resting = first_scale * jnp.expm1(growth * jnp.linspace(0.0, 1.0, REST_STEPS + 1))
        durations = jnp.concatenate([durations, jnp.asarray(shares[:heating]) * period, jnp.diff(resting)])
        before = jnp.concatenate([before, first[:heating], off])
        after = jnp.concatenate([after, last[:heating], off])
    before, after = amplitude * before, amplitude * after
    offset = values.get("offset", excitation.offset)
    if "offset" in values or excitation.offset:
        on = jnp.arange(len(before))[:, None] < len(before) - (REST_STEPS if modes is not None else 0)
        before, after = before + on * offset, after + on * offset
    time = jnp.concatenate([jnp.zeros(1), jnp.cumsum(durations)])
    sampled = jnp.concatenate([before, after[-1:]])
    return Inputs(time, before, after, jnp.arange(len(time)), sampled)


def _cycle_fractions(
    excitation: Excitation, wires: int, steps: int, values: Mapping[str, Float[Array, ""]]
) -> Float[np.ndarray, " points"] | Float[Array, " points"]:
    """Phases of the grid points of a cycle, 0 to 1; traced only where the duty differs between designs."""
    pieces = excitation.pieces(wires, steps)
    if excitation.duties is None:
        edges = excitation.edges(wires)
        ends = zip(edges, edges[1:], pieces, strict=False)
        return np.concatenate([[0.0], *(a + (b - a) * np.arange(1, n + 1) / n for a, b, n in ends)])
    edges = excitation.edges_at(values.get("duty", excitation.duty), wires)
    ends = zip(edges[:-1], edges[1:], pieces, strict=True)
    return jnp.concatenate([jnp.zeros(1), *(a + (b - a) * jnp.arange(1, n + 1) / n for a, b, n in ends)])


def _heating_steps(excitation: Excitation, wires: int, steps: int) -> int:
    """Steps of a cycle until the heating of wire 1 ends: at a square wave's switch-off, else at the largest value."""
    edges, end = excitation.edges(wires), 0.5
    if excitation.shape == "square":
        end = excitation.duty if excitation.duties is None else 0.5 * (excitation.duties[0] + excitation.duties[1])
    last = np.searchsorted(edges, end - _EDGE_TOLERANCE)
    return int(excitation.pieces(wires, steps)[:last].sum())
