"""A part's problem on longer steps, with fewer samples, and on shorter ones; laid out like it, for the same program."""

import dataclasses
from collections.abc import Sequence

import jax
import jax.numpy as jnp
import numpy as np

from smajax import simulate
from smajax.fit.problem import Data, Problem
from smajax.recording import Recording

_LONGEST = 4.0  # times the step that resolves the plant


def pieces(problem: Problem, recordings: Sequence[Recording]) -> int:
    """How many steps a problem usually takes from one sample to the next."""
    rows = np.asarray(problem.data.inputs.rows)
    return int(np.median(np.concatenate([np.diff(rows[k])[: len(r) - 1] for k, r in enumerate(recordings)])))


def longer(
    problem: Problem, recordings: Sequence[Recording], stride: int, *, interpolation: str, step: float | None, pieces: int = 1
) -> Problem | None:
    """The problem at every ``stride``-th sample, on steps ``pieces`` times as many times as long as those of ``lay_out``.

    ``None`` if these were too long for its plant.
    """
    laid = [simulate.lay_out(problem.plant, r, interpolation=interpolation, step=step) for r in recordings]
    usual = max(float(np.median(np.diff(one.time))) for one in laid)
    if pieces * stride * usual > _LONGEST * simulate.default_step(problem.plant):
        return None
    merged = [one.merged(stride, held=interpolation == "hold", pieces=pieces) for one in laid]
    merged += merged[-1:] * (len(problem.data.measured) - len(merged))
    grid, samples = problem.data.inputs.time.shape[1], problem.data.inputs.rows.shape[1]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(one.padded(grid, samples) for one in merged))
    measured, weight = (np.zeros(problem.data.measured.shape) for _ in range(2))
    kept = -(-samples // stride)
    measured[:, :, :kept], weight[:, :, :kept] = (np.asarray(a)[:, :, ::stride] for a in (problem.data.measured, problem.data.weight))
    data = Data(inputs, jnp.asarray(measured), jnp.asarray(weight), jnp.max(inputs.rows))
    return dataclasses.replace(problem, data=data)


def shorter(problem: Problem) -> tuple[Problem, list[int]]:
    """The problem on steps half as long, which lead through the first half of each recording only; and how many samples that is of each."""
    each = [jax.tree.map(lambda leaf, k=k: leaf[k], problem.data.inputs).halved() for k in range(len(problem.data.measured))]
    inputs = jax.tree.map(lambda *leaves: jnp.stack(leaves), *(inputs for inputs, _ in each))
    data = dataclasses.replace(problem.data, inputs=inputs, until=jnp.max(inputs.rows))
    return dataclasses.replace(problem, data=data), [samples for _, samples in each]
