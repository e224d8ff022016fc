"""Problems of a split on longer or shorter time steps, all on the same compiled program."""

import dataclasses
import math
from collections.abc import Sequence

import jax
import numpy as np

from smajax.fitting.problem import FitData, Problem
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.step_size import default_step

# Longest step of a search as a multiple of the default step, which resolves the plant. Up to there the error falls with
# the length of the step; ``step_errors`` measures whether it matters.
_LONGEST = 4.0


def steps_per_sample(problem: Problem, recordings: Sequence[Recording]) -> int:
    """Return the median number of steps from one sample to the next.

    Args:
        problem: The problem of a split.
        recordings: Its recordings.
    """
    indices = np.asarray(problem.data.inputs.sample_indices)
    return int(np.median(np.concatenate([np.diff(indices[k])[: len(r) - 1] for k, r in enumerate(recordings)])))


def with_longer_steps(
    problem: Problem,
    recordings: Sequence[Recording],
    stride: int,
    *,
    interpolation: str,
    step: float | None,
    pieces: int = 1,
) -> Problem | None:
    """Return the problem at every ``stride``-th sample, on longer steps.

    Args:
        problem: The problem of a split.
        recordings: Its recordings.
        stride: Distance of the samples that are used.
        interpolation: How inputs are interpolated (``discretise``).
        step: Length of the usual steps, s; ``None`` for the default.
        pieces: Number of usual steps that one step replaces.

    Returns:
        The problem; ``None`` if the steps would exceed four default steps of its plant, and for a path, of which each
        row is a step.
    """
    options = {"interpolation": interpolation, "step": step, "surroundings": problem.data.inputs.surroundings}
    grids = [discretise(problem.plant, r, **options) for r in recordings]
    usual = max(float(np.median(np.diff(grid.time))) for grid in grids)
    longest = default_step(problem.plant)
    if not math.isfinite(longest) or pieces * stride * usual > _LONGEST * longest:
        return None
    coarse = [grid.coarsen(stride, held=interpolation == "hold", pieces=pieces) for grid in grids]
    coarse += coarse[-1:] * (len(problem.data.measured) - len(coarse))
    points, samples = problem.data.inputs.time.shape[1], problem.data.inputs.sample_indices.shape[1]
    inputs = jax.tree.map(lambda *leaves: np.stack(leaves), *(grid.pad(points, samples) for grid in coarse))
    measured, weight = (np.zeros(problem.data.measured.shape) for _ in range(2))
    count = -(-samples // stride)
    measured[:, :, :count], weight[:, :, :count] = (
        np.asarray(a)[:, :, ::stride] for a in (problem.data.measured, problem.data.weight)
    )
    data = FitData(*jax.device_put((inputs, measured, weight, np.max(inputs.sample_indices))))
    return dataclasses.replace(problem, data=data)


def with_halved_steps(problem: Problem) -> tuple[Problem, list[int]]:
    """Return the problem on steps half as long.

    The grid keeps its length, so that the steps cover the first half of each recording.

    Args:
        problem: The problem of a split.

    Returns:
        The problem, and the number of samples of each recording that the steps cover.
    """
    halves = [
        jax.tree.map(lambda leaf, k=k: leaf[k], problem.data.inputs).halve() for k in range(len(problem.data.measured))
    ]
    inputs = jax.tree.map(lambda *leaves: np.stack(leaves), *(inputs for inputs, _ in halves))
    end = np.max(inputs.sample_indices)
    data = dataclasses.replace(problem.data, **jax.device_put({"inputs": inputs, "end_index": end}))
    return dataclasses.replace(problem, data=data), [samples for _, samples in halves]
