"""What the length of the steps does to a refit's residual: longer ones, by which a search may go, and its own."""

import math

import numpy as np

from smajax.diagnose.bench import Bench
from smajax.diagnose.hypothesis import Refit
from smajax.diagnose.steps import shorter
from smajax.fit.problem import Problem


def coarseness(bench: Bench, refit: Refit, stride: int) -> float:
    """Mean square of what the longer steps of ``strided`` do to a refit's residual; infinite if it has no such steps."""
    problem = bench.strided(stride)
    return math.inf if problem is bench.problems[0] else difference(bench, refit, problem, stride)


def difference(bench: Bench, refit: Refit, problem: Problem, stride: int = 1) -> float:
    """Mean square of what the steps of ``problem``, the training part at every ``stride``-th sample, do to a refit's residual."""
    coarse = bench.predict_at(problem, refit.hypothesis, refit.base)
    shape = problem.data.weight.shape
    fine, kept = refit.residual.reshape(shape)[:, :, ::stride], np.asarray(problem.data.weight) > 0.0
    return float(np.mean((coarse.reshape(shape) - np.pad(fine, ((0, 0), (0, 0), (0, shape[2] - fine.shape[2]))))[kept] ** 2))


def step_error(bench: Bench, refit: Refit) -> np.ndarray:
    """How much of the training part's residual, shape of ``flat``, comes from the finite length of the steps.

    Steps half as long are simulated on the same program, which takes them through the first half of each recording only. The
    rows there count twice, and those after them nothing.
    """
    halved, known = shorter(bench.problems[0])
    finer = bench.predict_at(halved, refit.hypothesis, refit.base)
    by = (refit.residual - finer).reshape(len(known), len(bench.channels), -1)
    for k, samples in enumerate(known):
        by[k, :, samples:] = 0.0
    return 2.0 * 4.0 / 3.0 * bench.flat(by.ravel())
