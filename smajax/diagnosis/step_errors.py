"""Errors of a residual by the length of the time steps: longer steps for searches, and the default steps."""

import math

import numpy as np
from jaxtyping import Float

from smajax.diagnosis.candidates import Refit
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.step_lengths import with_halved_steps
from smajax.fitting.problem import Problem


def stride_error(problem: DiagnosisProblem, refit: Refit, stride: int) -> float:
    """Compute the mean square error by the longer steps of ``strided_problem``.

    Args:
        problem: The diagnosis problem.
        refit: A refit of the training split.
        stride: Distance of the samples.

    Returns:
        The mean square over the noise; infinite if there are no such steps.
    """
    strided = problem.strided_problem(stride)
    return math.inf if strided is problem.problems[TRAIN] else step_length_error(problem, refit, strided, stride)


def step_length_error(problem: DiagnosisProblem, refit: Refit, longer: Problem, stride: int = 1) -> float:
    """Compute the mean square change of a residual, over the noise, by longer steps.

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


def estimate_step_error(problem: DiagnosisProblem, refit: Refit) -> Float[np.ndarray, " scored"]:
    """Estimate the error of the training residual by the finite length of the steps (Richardson extrapolation).

    For a method of second order, the error of the residual r is 4/3 (r - r_half), with r_half from steps half as long.
    These run on the same program and therefore cover the first half of each recording only: its samples
    count twice, and the later ones are 0.

    Args:
        problem: The diagnosis problem.
        refit: A refit of the training split.

    Returns:
        The error over the noise at the scored samples, shape ``(scored,)``.
    """
    halved, covered = with_halved_steps(problem.problems[TRAIN])
    finer = problem.predict_on(halved, refit.effect_set, refit.base)
    difference = (refit.residual - finer).reshape(len(covered), len(problem.channels), -1)
    for k, samples in enumerate(covered):
        difference[k, :, samples:] = 0.0
    return 2.0 * 4.0 / 3.0 * problem.counted_samples(difference.ravel())
