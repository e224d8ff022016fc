"""Recorded inputs on a grid of time steps.

Steps end at every sample, so each jump of a held input lies between two steps. Intervals between samples that are
longer than the step size are subdivided evenly. With fixed steps the objective of a fit has no noise from step-size
control, and every design of a batch costs the same.
"""

import itertools
from collections.abc import Iterable

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float, Int

from smajax.arguments import check_duration, check_interpolation, check_type
from smajax.errors import InputError, suggestion
from smajax.numerics.precision import require_double
from smajax.plant.heat import PrescribedTemperature
from smajax.plant.plant import Plant
from smajax.plant.stages import SURROUNDINGS
from smajax.recordings.recording import Recording
from smajax.simulation.argument_checks import A_RECORDING, as_array, check_plant
from smajax.simulation.step_size import default_step

# Steps per full range of a linear input: an interval between samples over which it changes by a tenth of its range gets
# 4 steps, which resolve the reversal from heating to cooling inside it. Chosen by trial; the tests with linear inputs
# in tests/unit/simulation hold it.
_STEPS_PER_RANGE = 40
# Share of an input's range from which a change between two steps is a jump that no coarser step may cover.
# Chosen by trial; test_merged_steps_heat_as_much in tests/unit/simulation/test_simulation.py holds it.
_JUMP_SHARE = 0.05
# Tolerance, as a share of a step, for the rounding of sample times, so that it does not cost an additional step: far
# above rounding (1e-16).
_ROUNDING = 1e-9
# Keeps a quotient finite for a constant input; near the smallest double-precision number, so it changes no other value.
_TINY = 1e-300


class Inputs(eqx.Module):
    """Inputs on a grid of steps.

    Attributes:
        time: Grid points, shape ``(grid,)``, s.
        before: Signals at the start of each step, shape ``(grid - 1, signals)``.
        after: Signals at the end of each step, of the same shape; where a held input jumps, they differ from ``before``
            of the next step.
        sample_indices: Indices of the samples in the grid, shape ``(samples,)``.
        sample_signals: Signals at the samples, shape ``(samples, signals)``.
        surroundings: Names of the last entries of the signals: recorded channels of the surroundings
            (``smajax.plant.stages.SURROUNDINGS``), which are not among ``Plant.signals``.
    """

    time: Float[Array, " grid"]
    before: Float[Array, "steps signals"]
    after: Float[Array, "steps signals"]
    sample_indices: Int[Array, " samples"]
    sample_signals: Float[Array, "samples signals"]
    surroundings: tuple[str, ...] = eqx.field(static=True, default=())

    def pad(self, grid: int, samples: int) -> "Inputs":
        """Extend the grid by steps of duration 0, in which nothing changes, and repeat the last sample.

        Args:
            grid: Number of grid points afterwards.
            samples: Number of samples afterwards.
        """
        time, before, after, indices, signals = self._as_numpy()
        more_steps, more_samples = grid - len(time), samples - len(indices)
        last = after[-1:]
        return _inputs(
            np.append(time, np.full(more_steps, time[-1])),
            np.concatenate([before, np.repeat(last, more_steps, axis=0)]),
            np.concatenate([after, np.repeat(last, more_steps, axis=0)]),
            np.append(indices, np.full(more_samples, indices[-1])),
            np.concatenate([signals, np.repeat(signals[-1:], more_samples, axis=0)]),
            surroundings=self.surroundings,
        )

    def scale(self, factor: Float[Array, ""] | Float[Array, " signals"] | float) -> "Inputs":
        """Multiply the plant's signals by a factor, such as the amplitude of the current; differentiable in it.

        Args:
            factor: One factor, or one for each signal in the order of ``Plant.signals``.

        Raises:
            InputError: If the factor is of single precision, or of another type or shape.
        """
        require_double(factor=factor)
        count = self.before.shape[-1] - len(self.surroundings)
        factors = as_array("scale", "factor", factor, "a number, or one for each signal of the plant")
        if factors.shape not in ((), (count,)):
            raise InputError(f"scale: factor has shape {factors.shape}: give a number, or an array of shape ({count},)")

        def scaled(signals: jax.Array) -> jax.Array:
            product = factors * signals[..., :count]
            return jnp.concatenate([product, signals[..., count:]], axis=-1) if self.surroundings else product

        before, after, sample_signals = map(scaled, (self.before, self.after, self.sample_signals))
        return Inputs(self.time, before, after, self.sample_indices, sample_signals, self.surroundings)

    def coarsen(self, stride: int, *, held: bool, pieces: int = 1) -> "Inputs":
        """Take every ``stride``-th sample, on fewer and longer steps.

        No step covers a jump of an input, where heating may change to cooling.

        Args:
            stride: Number of samples that become one.
            held: Whether the inputs are held between samples. Each step then has their root mean square, which gives
                the same heat; otherwise inputs are linear over a step.
            pieces: Number of steps per sample in this grid.
        """
        time, before, after, indices, signals = self._as_numpy()
        strided = indices[::stride]
        change = np.abs(before[1:] - after[:-1]) > _JUMP_SHARE * np.ptp(before, axis=0)
        jumps = 1 + np.flatnonzero(np.any(change, axis=1))
        cuts = np.union1d(strided, jumps[jumps < strided[-1]])
        # Where an input changes strongly there are more steps than usual, which resolve its reversal.
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
            mean = np.where(first == last, first, np.sign(first + last) * np.sqrt(total / size))
            electrical = np.arange(mean.shape[1]) < mean.shape[1] - len(self.surroundings)
            first, last = (np.where(electrical, mean, linear) for linear in (first, last))
        grid = np.append(starts, ends[-1])
        indices = np.searchsorted(grid, strided)
        return _inputs(time[grid], first, last, indices, signals[::stride], surroundings=self.surroundings)

    def halve(self) -> tuple["Inputs", int]:
        """Halve all steps, on a grid with the same number of points, which then ends earlier.

        Returns:
            The inputs, in which all later samples are at the end of the grid, and the number of samples that the grid
            still covers.
        """
        time, before, after, indices, signals = self._as_numpy()
        steps = (len(time) - 1) // 2
        middle = 0.5 * (before + after)[:steps]
        first, last = (
            np.stack(pair, axis=1).reshape(2 * steps, -1)
            for pair in ((before[:steps], middle), (middle, after[:steps]))
        )
        clock = np.stack([time[:steps], 0.5 * (time[:steps] + time[1 : steps + 1])], axis=1).ravel()
        at_end = np.minimum(2 * indices, 2 * steps)
        halved = _inputs(
            np.append(clock, time[steps]), first, last, at_end, signals, surroundings=self.surroundings
        ).pad(len(time), len(indices))
        return halved, int(np.sum(indices <= steps))

    def _as_numpy(self) -> tuple[np.ndarray, ...]:
        leaves = (self.time, self.before, self.after, self.sample_indices, self.sample_signals)
        return tuple(map(np.asarray, leaves))


def _inputs(*arrays: np.ndarray, surroundings: tuple[str, ...]) -> Inputs:
    # jnp.asarray would compile a program for each shape
    return Inputs(*map(jax.device_put, arrays), surroundings=surroundings)


def recorded_surroundings(plant: Plant, recordings: Iterable[Recording]) -> tuple[str, ...]:
    """Return the channels of the surroundings that a plant follows and one of the recordings has.

    Args:
        plant: The plant; one with a prescribed temperature has no heat balance and follows none.
        recordings: The recordings.

    Returns:
        The first names of ``SURROUNDINGS``, up to the last one that is recorded.
    """
    if isinstance(plant.heat, PrescribedTemperature):
        return ()
    names = {name for recording in recordings for name in recording.channels}
    count = max((i + 1 for i, name in enumerate(SURROUNDINGS) if name in names), default=0)
    return SURROUNDINGS[:count]


def discretise(
    plant: Plant,
    recording: Recording,
    *,
    interpolation: str | None = None,
    step: float | None = None,
    surroundings: tuple[str, ...] | None = None,
) -> Inputs:
    """Put a recording's inputs on a grid of time steps.

    Prescribed strain, stress and temperature are linear between samples, as is a recorded ambient temperature, which
    replaces ``environment.ambient`` in the heat balance; over rows without a value it is linear, too.

    For derivatives in the inputs, call it outside of the traced function, and there scale them (``Inputs.scale``) or
    replace their ``before``, ``after`` and ``sample_signals``, since a recording cannot be traced.

    Args:
        plant: The plant, which determines the signals.
        recording: The recording, which has a channel for each of the plant's signals. Without a clock it gets one step
            per row, since only the order of its rows matters.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; ``default_step`` if not given.
        surroundings: Channels of the surroundings in the inputs (``recorded_surroundings``), so that inputs of several
            recordings have one shape; by default those of the recording.

    Raises:
        InputError: If an argument is of another type or of single precision, the recording lacks a channel, a row
            or a value, its time decreases, the interpolation is unknown, or the step is not above 0 or depends on a
            traced plant.
    """
    check_plant("discretise", plant)
    check_type("discretise", "recording", recording, Recording, A_RECORDING)
    _check_channels(plant, recording)
    _check_rows(plant, recording)
    interpolation = _checked_interpolation(plant, interpolation)
    if step is not None:
        check_duration("discretise", "step", step)
    time = recording.time
    pieces = _steps_per_sample(plant, recording, interpolation, step)
    indices = np.concatenate([[0], np.cumsum(pieces)])
    within_sample = np.arange(indices[-1]) - np.repeat(indices[:-1], pieces)
    start = np.repeat(time[:-1], pieces) + within_sample * np.repeat(np.diff(time) / pieces, pieces)
    grid = np.append(start, time[-1])
    if surroundings is None:
        surroundings = recorded_surroundings(plant, [recording])
    names = (*plant.signals, *surroundings)
    columns = [recording.channels[name] for name in plant.signals]
    columns += [_without_gaps(recording, name) for name in surroundings]
    signals = np.column_stack(columns) if columns else np.zeros((len(time), 0))
    before, after = np.empty((2, indices[-1], len(names)))
    held = (plant.drive.control, "fan") if plant.drive.control else ("fan",)
    for i, name in enumerate(names):
        if name.startswith(held) and interpolation == "hold":
            before[:, i] = after[:, i] = np.repeat(signals[:-1, i], pieces)
        else:
            at_grid = np.interp(grid, time, signals[:, i])
            before[:, i], after[:, i] = at_grid[:-1], at_grid[1:]
            # Interpolation cannot tell rows of one time apart, which a path may have.
            before[indices[:-1], i], after[indices[1:] - 1, i] = signals[:-1, i], signals[1:, i]
    return _inputs(grid, before, after, indices, signals, surroundings=surroundings)


def _without_gaps(recording: Recording, name: str) -> np.ndarray:
    """A channel that is linear over rows in which it is NaN; NaN everywhere if the recording does not have it."""
    values = recording.channels.get(name, np.full(len(recording), np.nan))
    measured = np.isfinite(values)
    return np.interp(recording.time, recording.time[measured], values[measured]) if np.any(measured) else values


def count_steps(
    plant: Plant, recording: Recording, *, interpolation: str | None = None, step: float | None = None
) -> int:
    """Count the steps in which ``discretise`` puts a recording, without making them.

    Args:
        plant: The plant.
        recording: The recording.
        interpolation: Electrical inputs between samples: ``hold`` or ``linear``; that of the plant by default.
        step: Longest step in s; ``default_step`` if not given.
    """
    _check_channels(plant, recording)
    interpolation = _checked_interpolation(plant, interpolation)
    return int(np.sum(_steps_per_sample(plant, recording, interpolation, step)))


def _check_channels(plant: Plant, recording: Recording) -> None:
    """Check that a recording has a channel for each signal of a plant."""
    for name in plant.signals:
        if name not in recording.channels:
            columns = ", ".join(recording.channels) or "none"
            raise InputError(
                f"{recording.name}: there is no channel '{name}'{suggestion(name, recording.channels)}, "
                f"which drives the plant: add a column '{name}' (it has {columns})"
            )


def _checked_interpolation(plant: Plant, interpolation: str | None) -> str:
    """Return the interpolation that was given, else that of the plant, after a check."""
    if interpolation is None:
        return plant.interpolation
    check_interpolation(interpolation)
    return interpolation


def _check_rows(plant: Plant, recording: Recording) -> None:
    """Check that a recording has two rows, times that do not decrease, and a number for each signal in every row."""
    time = recording.time
    if len(time) < 2:
        raise InputError(f"{recording.name}: the number of rows is {len(time)}: a simulation needs at least two")
    wrong = np.flatnonzero(~(np.diff(time) >= 0.0))
    if len(wrong):
        row = int(wrong[0]) + 1
        raise InputError(
            f"{recording.name}: row {row}: time does not increase, from {time[row - 1]:g} s to {time[row]:g} s: sort "
            "the rows, and leave out what repeats"
        )
    for name in plant.signals:
        missing = np.flatnonzero(~np.isfinite(recording.channels[name]))
        if len(missing):
            raise InputError(
                f"{recording.name}: row {missing[0]}: channel '{name}', which drives the plant, is "
                f"{recording.channels[name][missing[0]]}: give a number, or leave out the row"
            )


def _concrete_step(plant: Plant) -> float:
    """``default_step`` of a plant, also where it is differentiated: the grid is no function of its parameters."""
    try:
        with jax.ensure_compile_time_eval():
            return default_step(jax.lax.stop_gradient(plant))
    except jax.errors.ConcretizationTypeError:
        raise InputError(
            "discretise: the default step depends on the plant, whose parameters are traced here: call discretise "
            "outside jit and vmap, or give step="
        ) from None


def _steps_per_sample(plant: Plant, recording: Recording, interpolation: str, step: float | None) -> np.ndarray:
    """Number of steps from each sample to the next, shape ``(samples - 1,)``."""
    gaps = np.diff(recording.time)
    pieces = np.ones(len(gaps), int)
    if recording.has_clock:
        pieces = np.maximum(1, np.ceil(gaps / (step or _concrete_step(plant)) - _ROUNDING).astype(int))
    if interpolation == "linear" and recording.has_clock:
        # Where the input changes strongly between two samples, heating may change to cooling in between: small steps
        # resolve that reversal.
        for name in plant.signals[: plant.mechanism.wires if plant.drive.control else 0]:
            signal = recording.channels[name]
            change = np.abs(np.diff(signal)) / max(float(np.ptp(signal)), _TINY)
            pieces = np.maximum(pieces, np.ceil(_STEPS_PER_RANGE * change).astype(int))
    return pieces
