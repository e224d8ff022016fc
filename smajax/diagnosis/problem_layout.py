"""The recordings of a diagnosis on grids of one shape: one fit problem, divided into one for each split."""

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple

import equinox as eqx
import jax
import numpy as np
from jaxtyping import Float

from smajax import parameters
from smajax.diagnosis.data_split import TRAIN, DataSplit
from smajax.diagnosis.step_lengths import steps_per_sample, with_longer_steps
from smajax.fitting.problem import Problem, build_problem
from smajax.fitting.unknowns import Settings
from smajax.plant.plant import Plant
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise


class VectorBounds(NamedTuple):
    """Nominal values and bounds of a split's base parameters, each of shape ``(p,)``.

    Attributes:
        nominal: The rig's own values.
        lower: Lower bounds.
        upper: Upper bounds; equal to the lower ones where a parameter is held.
    """

    nominal: np.ndarray
    lower: np.ndarray
    upper: np.ndarray


class JointPrior(NamedTuple):
    """Base parameters that only fits to training and selection split together free, and their prior.

    Attributes:
        free: Whether only such a fit frees the parameter, shape ``(p,)``.
        deviations: Standard deviation of each parameter about the rig's own value, in units of its scale; infinite
            without a prior, shape ``(p,)``.
    """

    free: np.ndarray
    deviations: np.ndarray


def divide_problem(whole: Problem, splits: Sequence[DataSplit]) -> tuple[list[Problem], list[VectorBounds]]:
    """Divide a problem of all recordings into one of the same shapes for each split.

    Splits with fewer recordings than the largest are padded with copies of their last one, whose own parameters are
    held.

    Args:
        whole: The problem of all recordings, split after split.
        splits: The splits.

    Returns:
        The problem of each split, and the bounds of its base vector: shared parameters, then own ones by recording.
    """
    shared, own = len(whole.shared), len(whole.per_recording)
    size, first = max(len(split.recordings) for split in splits), 0
    problems: list[Problem] = []
    bounds: list[VectorBounds] = []
    unknowns: tuple[Any, ...] = ()
    for split in splits:
        count = len(split.recordings)
        recordings = first + np.minimum(np.arange(size), count - 1)
        own_entries = shared + (recordings[:, None] * own + np.arange(own)).ravel()
        entries = np.concatenate([np.arange(shared), own_entries]).astype(int)
        # The first split's unknowns serve all, as static data of one program.
        unknowns = unknowns or tuple(whole.unknowns[i] for i in entries)
        data = jax.tree.map(lambda leaf, at=recordings: _rows_of(leaf, at), whole.data)
        scales = _rows_of(whole.scales, entries)
        problems.append(dataclasses.replace(whole, data=data, scales=scales, unknowns=unknowns))
        nominal, (lower, upper) = whole.nominal[entries], (side[entries] for side in whole.bounds)
        held = np.arange(len(entries)) >= shared + own * count
        bounds.append(VectorBounds(nominal, np.where(held, nominal, lower), np.where(held, nominal, upper)))
        first += count
    return problems, bounds


def _rows_of(leaf: jax.Array, rows: np.ndarray) -> jax.Array:
    """Rows of an array, by NumPy: with JAX each shape would be compiled; a number is returned as it is."""
    return jax.device_put(np.asarray(leaf)[rows]) if leaf.ndim else leaf


def with_weights(problem: Problem, rows: Sequence[np.ndarray], noise: Mapping[str, float]) -> Problem:
    """Return the problem in which only the scored rows have a weight, the inverse of the noise.

    Args:
        problem: The problem of a split.
        rows: Indices of the scored rows of each recording; padding recordings, which have no entry, get no weight.
        noise: Standard deviation of the noise by channel, SI.
    """
    weight = np.zeros(problem.data.weight.shape)
    inverse = np.array([1.0 / noise[c] for c in problem.channels])
    for k, scored in enumerate(rows):
        weight[k][:, scored] = inverse[:, None]
    return dataclasses.replace(problem, data=eqx.tree_at(lambda d: d.weight, problem.data, jax.device_put(weight)))


class GriddedSplits:
    """The splits of a diagnosis, each as a fit problem of the same shapes, with the noise of their channels.

    Attributes:
        splits: Training, selection and holdout split.
        channels: The observed channels.
        noise: Standard deviation of the noise by channel, SI.
        problems: The fit problem of each split.
        shared_count: Number of base parameters that all recordings share.
        own_count: Number of own parameters of each recording.
        settings: The fit settings of the rig file.
        nominal: The base vector with the rig's own values, shape ``(p,)``.
        bounds: Lower and upper bounds of the base vector, each of shape ``(p,)``, in fits to the training split.
        grid_options: ``interpolation`` and ``step`` of ``discretise``.
        joint_prior: What a fit to training and selection split together (``joint_refit``) frees and assumes in
            addition; ``None`` for nothing.

    Args:
        plant: The plant of all problems.
        splits: Training, selection and holdout split, in this order.
        settings: The fit settings of the rig file.
        grid_options: ``interpolation`` and ``step`` of ``discretise``; ``None`` for those of the plant.
    """

    def __init__(self, plant: Plant, splits: Sequence[DataSplit], settings: Settings, grid_options: dict[str, Any]):
        self.splits: list[DataSplit] = list(splits)
        self.channels: tuple[str, ...] = tuple(settings.observe)
        self.settings: Settings = settings
        interpolation = grid_options["interpolation"] or plant.interpolation
        self.grid_options: dict[str, Any] = grid_options | {"interpolation": interpolation}
        self._pieces = 1  # default steps that one step of the problems replaces
        self._rows = [split.rows() for split in self.splits]
        self._has_clock = all(r.has_clock for r in self.splits[TRAIN].recordings)
        # Built together, so that all grids have the length of the longest.
        everything = [r for split in self.splits for r in split.recordings]
        whole = build_problem(plant, everything, settings, **grid_options)
        end = jax.device_put(np.max(np.asarray(whole.data.inputs.sample_indices)))
        whole = dataclasses.replace(whole, data=dataclasses.replace(whole.data, end_index=end))
        largest_weight = np.max(np.asarray(whole.data.weight), axis=(0, 2))
        self.noise: dict[str, float] = dict(zip(self.channels, 1.0 / largest_weight, strict=True))
        self.shared_count: int = len(whole.shared)
        self.own_count: int = len(whole.per_recording)
        self.problems, self._vector_bounds = divide_problem(whole, self.splits)
        nominal, *bounds = self._vector_bounds[TRAIN]
        self.nominal: np.ndarray = nominal
        self.bounds: tuple[np.ndarray, ...] = tuple(bounds)
        self.joint_prior: JointPrior | None = None
        self.set_noise(self.noise)

    def set_noise(self, noise: dict[str, float]) -> None:
        """Weight all recordings by the inverse of the standard deviations of the noise, SI, by channel."""
        self.noise = dict(noise)
        self.problems = [with_weights(p, rows, self.noise) for p, rows in zip(self.problems, self._rows, strict=True)]
        self._strided: dict[int, Problem] = {}

    def set_plant_values(self, values: Mapping[str, float]) -> None:
        """Set parameters of the plant that are not free, SI by name."""
        plants = [parameters.replace(p.plant, values, ordered=False) for p in self.problems]
        self.problems = [dataclasses.replace(p, plant=plant) for p, plant in zip(self.problems, plants, strict=True)]
        self._strided = {}

    @property
    def samples(self) -> int:
        """Number of scored samples of the training split."""
        return int(np.sum(np.asarray(self.problems[TRAIN].data.weight) > 0.0))

    def series(self, residual: Float[np.ndarray, " m"], split: int = TRAIN) -> dict[str, np.ndarray]:
        """Return the scored samples of each channel.

        Args:
            residual: A residual of a split, or a column of its Jacobian, shape ``(m,)``.
            split: Position of the split.

        Returns:
            One series for each channel, recording after recording.
        """
        by_recording = residual.reshape(len(self.problems[split].data.measured), len(self.channels), -1)
        return {
            c: np.concatenate([by_recording[r, i, rows] for r, rows in enumerate(self._rows[split])])
            for i, c in enumerate(self.channels)
        }

    def inputs(self, split: int = TRAIN) -> dict[str, np.ndarray]:
        """Return the driving channels of a split, SI, on the rows of ``series``."""
        pairs = list(zip(self.splits[split].recordings, self._rows[split], strict=True))
        signals = self.problems[split].plant.signals
        return {name: np.concatenate([r.channels[name][rows] for r, rows in pairs]) for name in signals}

    def counted_samples(self, residual: Float[np.ndarray, " m"], split: int = TRAIN) -> Float[np.ndarray, " scored"]:
        """Return the scored samples of a residual, channel after channel.

        Args:
            residual: A residual of a split, or a column of its Jacobian, shape ``(m,)``.
            split: Position of the split.

        Returns:
            The samples, shape ``(scored,)``.
        """
        return np.concatenate(list(self.series(residual, split).values()))

    def reduced_chi2(self, residual: Float[np.ndarray, " m"], split: int) -> float:
        """Compute the reduced chi-squared: the mean square of a residual over the noise, about 1 for noise alone.

        Args:
            residual: A residual of a split, shape ``(m,)``.
            split: Position of the split.
        """
        return float(np.mean(self.counted_samples(residual, split) ** 2))

    @property
    def joint_bounds(self) -> tuple[np.ndarray, ...]:
        """Lower and upper bounds of the base vector in fits to training and selection split together."""
        own, prior = self.bounds, self.joint_prior
        if prior is None:
            return own
        return tuple(
            np.where(prior.free, whole, side) for whole, side in zip(self._vector_bounds[TRAIN][1:], own, strict=True)
        )

    def strided_problem(self, stride: int) -> Problem:
        """Return the training split at every ``stride``-th sample, on steps ``stride`` times as long.

        A training split without a clock, or whose steps would become too long, is returned as it is.
        """
        if stride > 1 and stride not in self._strided:
            longer = self._with_longer_steps(TRAIN, stride, self._pieces)
            self._strided[stride] = longer or self.problems[TRAIN]
        return self._strided[stride] if stride > 1 else self.problems[TRAIN]

    def _with_longer_steps(self, split: int, stride: int, pieces: int) -> Problem | None:
        if not self._has_clock:
            return None
        recordings = self.splits[split].recordings
        return with_longer_steps(self.problems[split], recordings, stride, pieces=pieces, **self.grid_options)

    def lengthen_steps(self, is_accurate: Callable[[Problem], bool]) -> None:
        """Replace several steps between two samples by one, if that is accurate enough.

        Args:
            is_accurate: Called with the problem of the training split on the longer steps.
        """
        pieces = steps_per_sample(self.problems[TRAIN], self.splits[TRAIN].recordings)
        if pieces > 1 and (first := self._with_longer_steps(TRAIN, 1, pieces)) and is_accurate(first):
            further = [self._with_longer_steps(k, 1, pieces) or p for k, p in enumerate(self.problems[1:], 1)]
            self._pieces = pieces
            self.problems: list[Problem] = [first, *further]
            self._strided = {}

    def problem_for_inputs(self, recording: Recording) -> Problem | None:
        """Return a problem of the training split's shapes under a recording's inputs.

        Args:
            recording: A recording with the driving channels; its rows are weighted, its outputs are not used.

        Returns:
            The problem; ``None`` if the inputs need a longer grid.
        """
        train = self.problems[TRAIN]
        surroundings = train.data.inputs.surroundings
        inputs = discretise(train.plant, recording, **self.grid_options, surroundings=surroundings)
        if self._pieces > 1:
            inputs = inputs.coarsen(1, held=self.grid_options["interpolation"] == "hold", pieces=self._pieces)
        count, points = train.data.inputs.time.shape
        samples = train.data.inputs.sample_indices.shape[1]
        if len(inputs.time) > points or len(inputs.sample_indices) > samples:
            return None
        padded = inputs.pad(points, samples)
        inputs = jax.tree.map(lambda leaf: np.repeat(np.asarray(leaf)[None], count, axis=0), padded)
        end = np.max(inputs.sample_indices)
        data = dataclasses.replace(train.data, **jax.device_put({"inputs": inputs, "end_index": end}))
        return with_weights(dataclasses.replace(train, data=data), [np.arange(len(recording))], self.noise)
