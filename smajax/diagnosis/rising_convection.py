"""Convection that does not fall with the temperature, where a base fit without this overheats under another input.

A large missing effect can bend the fitted h(T) so far that it falls. With the training input the wire may stay below
the temperature at which its convection no longer carries the heat away; with another one it runs away, and nothing that
is compared with that fit means anything. The coefficients of T in h(T) are then bounded at 0. Only the inputs of the
selection and holdout recordings have a part in this, not what was measured.
"""

import dataclasses

import numpy as np

from smajax.diagnosis.base_fit import BaseFit, fit_base
from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import HOLDOUT, SELECT, TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.simulation.status import SimulationStatus

# Coefficients of T and of its power in h(T).
_COEFFICIENTS = ("heat.h1", "heat.h2")
# How a simulation ends whose wire heats up without limit.
_RUNAWAY = (SimulationStatus.overheated, SimulationStatus.diverged)


def repeat_if_overheating(problem: DiagnosisProblem, base: BaseFit, seed: int, starts: int) -> BaseFit:
    """Repeat a base fit with rising convection, where the fit overheats with the input of another recording.

    Args:
        problem: The diagnosis problem; if the fit is repeated, all later searches keep the bounds.
        base: The base fit.
        seed: Seed of the start points.
        starts: Least number of starts.

    Returns:
        The base fit, or that with rising convection, which names the parameters that were bounded.
    """
    if not _overheats(problem, base.point) or not (bounded := _bound_coefficients(problem)):
        return base
    return fit_base(problem, seed, starts)._replace(rising_convection=bounded)


def _overheats(problem: DiagnosisProblem, point: np.ndarray) -> bool:
    """Whether a fit has a falling h(T), and the wire melts with the input of the selection or holdout split."""
    unknowns = problem.problems[TRAIN].unknowns
    if not any(u.name in _COEFFICIENTS and value < 0.0 for u, value in zip(unknowns, point, strict=True)):
        return False
    fit = Refit(EffectSet(), point, np.zeros(0), np.zeros((0, 0)), SolverStatus.converged)
    return any(problem.report(fit, split)[1] in _RUNAWAY for split in (SELECT, HOLDOUT))


def _bound_coefficients(problem: DiagnosisProblem) -> tuple[str, ...]:
    """Bound the free coefficients of h(T) at 0, but not those whose own value in the rig is negative.

    Later searches have the same bounds, also those with another law or a structure, which take the settings.

    Returns:
        The names of the parameters that were bounded.
    """
    unknowns, (lower, upper) = problem.base_problem.unknowns, problem.bounds
    bounded = {u.name: u for u in unknowns if u.name in _COEFFICIENTS and u.lower < 0.0 <= u.nominal}
    bounds = dict(problem.settings.bounds) | {name: (0.0, u.upper) for name, u in bounded.items()}
    problem.settings = dataclasses.replace(problem.settings, bounds=bounds)  # pyright: ignore[reportArgumentType]
    raised = tuple(dataclasses.replace(u, lower=0.0) if u.name in bounded else u for u in unknowns)
    problem.base_problem = dataclasses.replace(problem.base_problem, unknowns=raised)
    is_bounded = np.array([u.name in bounded for u in problem.problems[TRAIN].unknowns])
    problem.bounds = (np.where(is_bounded, 0.0, lower), upper)
    return tuple(bounded)
