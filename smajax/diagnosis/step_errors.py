"""Errors of a refit's residual by the length of the steps: of longer ones, which searches may take, and of its own."""

import math

import numpy as np

from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.step_lengths import with_halved_steps
from smajax.fitting.problem import Problem


def stride_error(problem: DiagnosisProblem, refit: Refit, stride: int) -> float:
    """Return the mean square error by the longer steps of ``strided_problem``; infinite if it has no such steps."""
    strided = problem.strided_problem(stride)
    return math.inf if strided is problem.problems[TRAIN] else step_length_error(problem, refit, strided, stride)


def step_length_error(problem: DiagnosisProblem, refit: Refit, longer: Problem, stride: int = 1) -> float:
    """Return the mean square by which longer steps change a refit's residual, over the noise.

    Args:
        problem: The diagnosis problem.
        refit: A refit of the training split.
        longer: The training split at every ``stride``-th sample, on longer steps.
        stride: Distance of the samples of ``longer``.
    """
    coarse = problem.predict_on(longer, refit.effect_set, refit.base)
    shape = longer.data.weight.shape
    fine, scored = refit.residual.reshape(shape)[:, :, ::stride], np.asarray(longer.data.weight) > 0.0
    fine = np.pad(fine, ((0, 0), (0, 0), (0, shape[2] - fine.shape[2])))
    return float(np.mean((coarse.reshape(shape) - fine)[scored] ** 2))


def estimate_step_error(problem: DiagnosisProblem, refit: Refit) -> np.ndarray:
    """Estimate the error of the training residual by the steps' finite length (Richardson, second order).

    Steps half as long are simulated on the same program, so that they cover the first half of each recording only. The
    samples there count twice, and those after them nothing.

    Args:
        problem: The diagnosis problem.
        refit: A refit of the training split.

    Returns:
        The error over the noise, of the shape of ``counted_samples``.
    """
    halved, covered = with_halved_steps(problem.problems[TRAIN])
    finer = problem.predict_on(halved, refit.effect_set, refit.base)
    difference = (refit.residual - finer).reshape(len(covered), len(problem.channels), -1)
    for k, samples in enumerate(covered):
        difference[k, :, samples:] = 0.0
    return 2.0 * 4.0 / 3.0 * problem.counted_samples(difference.ravel())
