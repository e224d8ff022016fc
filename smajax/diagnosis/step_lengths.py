"""A split's problem on longer steps, with fewer samples, and on shorter steps; all on the same compiled program."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from smajax.fitting.problem import FitData, Problem
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.step_size import default_step

# Longest step that a search may take, as a multiple of the step that resolves the plant. Up to there the error of a
# step falls with its length; whether it matters is measured (``step_errors``).
_LONGEST = 4.0


def steps_per_sample(problem: Problem, recordings: Sequence[Recording]) -> int:
    """Return the median number of steps from one sample to the next."""
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
    """Return the problem at every ``stride``-th sample, on longer steps; ``None`` if these were too long for its plant.

    Args:
        problem: The problem of a split.
        recordings: Its recordings.
        stride: Distance of the samples that are used.
        interpolation: How inputs are interpolated (``discretise``).
        step: Length of the usual steps, s; ``None`` for the default.
        pieces: How many of the usual steps one step within a sample replaces.
    """
    grids = [discretise(problem.plant, r, interpolation=interpolation, step=step) for r in recordings]
    usual = max(float(np.median(np.diff(grid.time))) for grid in grids)
    if pieces * stride * usual > _LONGEST * default_step(problem.plant):
        return None
    coarse = [grid.coarsen(stride, held=interpolation == "hold", pieces=pieces) for grid in grids]
    coarse += coarse[-1:] * (len(problem.data.measured) - len(coarse))
    points, samples = problem.data.inputs.time.shape[1], problem.data.inputs.sample_indices.shape[1]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(grid.pad(points, samples) for grid in coarse))
    measured, weight = (np.zeros(problem.data.measured.shape) for _ in range(2))
    kept = -(-samples // stride)
    measured[:, :, :kept], weight[:, :, :kept] = (
        np.asarray(a)[:, :, ::stride] for a in (problem.data.measured, problem.data.weight)
    )
    data = FitData(inputs, jnp.asarray(measured), jnp.asarray(weight), jnp.max(inputs.sample_indices))
    return dataclasses.replace(problem, data=data)


def with_halved_steps(problem: Problem) -> tuple[Problem, list[int]]:
    """Return the problem on steps half as long, and how many samples of each recording they cover.

    The grid keeps its length, so that the steps cover the first half of each recording.
    """
    halves = [
        jax.tree.map(lambda leaf, k=k: leaf[k], problem.data.inputs).halve() for k in range(len(problem.data.measured))
    ]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(inputs for inputs, _ in halves))
    data = dataclasses.replace(problem.data, inputs=inputs, end_index=jnp.max(inputs.sample_indices))
    return dataclasses.replace(problem, data=data), [samples for _, samples in halves]
