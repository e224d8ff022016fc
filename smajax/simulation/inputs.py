"""Recorded inputs on a grid of time steps.

Steps end at every sample, so that each jump of a held input falls between two steps; samples that are further apart
than the step size are subdivided evenly. Fixed steps keep a fit's objective free of the noise of step-size control,
cost the same for every design of a batch, and let the material's relative update cross its bands without error.
"""

import itertools

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.step_size import default_step

# Steps per full range of a linear input: a sample over which it changes by a tenth of its range gets 4 steps, which
# place the reversal from heating to cooling inside it. Chosen by trial; the tests with linear inputs in
# tests/unit/simulation hold it.
_STEPS_PER_RANGE = 40
# Share of a held input's range from which a change between two steps is a jump that no coarser step may cover.
# Chosen by trial; test_merged_steps_heat_as_much in tests/unit/simulation/test_simulation.py holds it.
_JUMP_SHARE = 0.05
# Rounding of sample times that does not cost one more step.
_ROUNDING = 1e-9


class Inputs(eqx.Module):
    """Inputs on a grid of steps.

    Attributes:
        time: Grid points (grid,), s.
        before: Signals at the start of each step (grid - 1, signals).
        after: Signals at the end of each step; where a held input jumps, they differ from the next step's ``before``.
        sample_indices: The grid points of the samples (samples,).
        sample_signals: Signals at the samples (samples, signals).
    """

    time: Float[Array, " grid"]
    before: Float[Array, "steps signals"]
    after: Float[Array, "steps signals"]
    sample_indices: Int[Array, " samples"]
    sample_signals: Float[Array, "samples signals"]

    def pad(self, grid: int, samples: int) -> "Inputs":
        """Extend to ``grid`` points by steps of no duration, in which nothing changes, and repeat the last sample."""
        time, before, after, indices, signals = self._as_numpy()
        more_steps, more_samples = grid - len(time), samples - len(indices)
        last = after[-1:]
        return _inputs(
            np.append(time, np.full(more_steps, time[-1])),
            np.concatenate([before, np.repeat(last, more_steps, axis=0)]),
            np.concatenate([after, np.repeat(last, more_steps, axis=0)]),
            np.append(indices, np.full(more_samples, indices[-1])),
            np.concatenate([signals, np.repeat(signals[-1:], more_samples, axis=0)]),
        )

    def coarsen(self, stride: int, *, held: bool, pieces: int = 1) -> "Inputs":
        """Take every ``stride``-th sample, on steps each of which stands for up to ``pieces`` times as many.

        No step covers a jump of an input, where heating turns to cooling.

        Args:
            stride: Samples that become one.
            held: Whether the inputs are held between samples: then each step keeps their mean square, which heats as
                much; other inputs go straight.
            pieces: Steps per sample of the grid so far.
        """
        time, before, after, indices, signals = self._as_numpy()
        strided = indices[::stride]
        change = np.abs(before[1:] - after[:-1]) > _JUMP_SHARE * np.ptp(before, axis=0)
        jumps = 1 + np.flatnonzero(np.any(change, axis=1))
        cuts = np.union1d(strided, jumps[jumps < strided[-1]])
        # Where an input swings there are more steps than usual, which place its turn.
        usual = pieces * stride
        ends = [
            np.append(np.arange(a, b, usual if b - a <= usual else stride), b)[1:] for a, b in itertools.pairwise(cuts)
        ]
        ends = np.concatenate(ends)
        starts = np.append(strided[0], ends[:-1])
        first, last = before[starts], after[ends - 1]
        if held:
            weight = np.diff(time)[:, None]
            total, size = (np.add.reduceat(v[: ends[-1]], starts) for v in (weight * before**2, weight))
            first = last = np.where(first == last, first, np.sign(first + last) * np.sqrt(total / size))
        grid = np.append(starts, ends[-1])
        return _inputs(time[grid], first, last, np.searchsorted(grid, strided), signals[::stride])

    def halve(self) -> tuple["Inputs", int]:
        """Halve all steps, on a grid of the same length, which then ends earlier.

        Returns:
            The inputs, whose later samples stay at the end of the grid, and the number of samples that the grid still
            holds.
        """
        time, before, after, indices, signals = self._as_numpy()
        steps = (len(time) - 1) // 2
        middle = 0.5 * (before + after)[:steps]
        first, last = (
            np.stack(pair, axis=1).reshape(2 * steps, -1)
            for pair in ((before[:steps], middle), (middle, after[:steps]))
        )
        clock = np.stack([time[:steps], 0.5 * (time[:steps] + time[1 : steps + 1])], axis=1).ravel()
        halved = _inputs(np.append(clock, time[steps]), first, last, np.minimum(2 * indices, 2 * steps), signals).pad(
            len(time), len(indices)
        )
        return halved, int(np.sum(indices <= steps))

    def _as_numpy(self) -> tuple[np.ndarray, ...]:
        leaves = (self.time, self.before, self.after, self.sample_indices, self.sample_signals)
        return tuple(map(np.asarray, leaves))


def _inputs(*arrays: np.ndarray) -> Inputs:
    return Inputs(*map(jax.device_put, arrays))  # jnp.asarray would compile a program for each shape


def discretise(plant: Plant, recording: Recording, *, interpolation: str = "hold", step: float | None = None) -> Inputs:
    """Lay a recording's inputs on a grid of steps.

    Prescribed strain, stress and temperature are linear between samples.

    Args:
        plant: The plant, whose signals are read from the recording.
        recording: Without a clock it gets one step a row, since only the order of its rows matters.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``.
        step: Longest step in s; ``default_step`` if not given.
    """
    time = recording.time
    pieces = _steps_per_sample(plant, recording, interpolation, step)
    indices = np.concatenate([[0], np.cumsum(pieces)])
    within_sample = np.arange(indices[-1]) - np.repeat(indices[:-1], pieces)
    start = np.repeat(time[:-1], pieces) + within_sample * np.repeat(np.diff(time) / pieces, pieces)
    grid = np.append(start, time[-1])
    signals = (
        np.column_stack([recording.channels[name] for name in plant.signals])
        if plant.signals
        else np.zeros((len(time), 0))
    )
    before, after = np.empty((2, indices[-1], len(plant.signals)))
    for i, name in enumerate(plant.signals):
        if name.startswith(plant.drive.control or "\0") and interpolation == "hold":
            before[:, i] = after[:, i] = np.repeat(signals[:-1, i], pieces)
        else:
            at_grid = np.interp(grid, time, signals[:, i])
            before[:, i], after[:, i] = at_grid[:-1], at_grid[1:]
    return _inputs(grid, before, after, indices, signals)


def _steps_per_sample(plant: Plant, recording: Recording, interpolation: str, step: float | None) -> np.ndarray:
    """Number of steps from each sample to the next, shape ``(samples - 1,)``."""
    gaps = np.diff(recording.time)
    pieces = np.ones(len(gaps), int)
    if recording.has_clock:
        pieces = np.maximum(1, np.ceil(gaps / (step or default_step(plant)) - _ROUNDING).astype(int))
    if interpolation == "linear" and recording.has_clock:
        # Where the input swings within one sample, heating turns to cooling somewhere inside: small steps place that
        # reversal.
        for name in plant.signals[: plant.mechanism.wires if plant.drive.control else 0]:
            signal = recording.channels[name]
            swing = np.abs(np.diff(signal)) / max(float(np.ptp(signal)), 1e-300)
            pieces = np.maximum(pieces, np.ceil(_STEPS_PER_RANGE * swing).astype(int))
    return pieces
