"""The base fit: the rig as its file describes it, without further effects, and the noise of its residual."""

import math
from typing import NamedTuple

import numpy as np

from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.residual_checks import estimate_noise
from smajax.diagnosis.screening import orthonormal_basis
from smajax.errors import NumericsError
from smajax.fitting import abstract_problem
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.multi_start import MultiStartResult, MultiStartSolver
from smajax.fitting.noise import rounding_noise
from smajax.fitting.problem import Problem
from smajax.fitting.residual_offsets import ResidualOffset, residual_offsets
from smajax.numerics.ensemble import share_among_cores

# Norm of the residual's projection on the free parameters' Jacobian, relative to the residual, up to which a fit is
# stationary. Chosen by trial.
_STATIONARY = 2e-2
# Number of starts after which a fit is accepted although no second start has the same cost: a stationary fit, and one
# that is not stationary. With a large missing effect there may be no stationary point. Chosen by trial.
_MAX_STARTS = 10
_MAX_STARTS_NOT_STATIONARY = 4
# Largest distance of the start points from the rig's own values as a share of the search box. Chosen by trial.
_START_SPREAD = 0.1
# Cost over the least one up to which two starts have found the same optimum. Chosen by trial.
_SAME_COST = 1.01
# Relative fall of the cost at which a search ends. Chosen by trial.
_RTOL = 1e-8


class BaseFit(NamedTuple):
    """The base fit.

    Attributes:
        point: The base vector, shape ``(p,)``.
        status: Status of the solver.
        noise: Standard deviation of each channel's noise, SI, and its source.
        converged: Whether the fit is stationary.
        offsets: Offsets of sensors that explain the residual above the noise, without any effect.
        rising_convection: Coefficients of h(T) that were bounded at 0 (module ``rising_convection``).
    """

    point: np.ndarray
    status: SolverStatus
    noise: dict[str, tuple[float, str]]
    converged: bool
    offsets: tuple[ResidualOffset, ...] = ()
    rising_convection: tuple[str, ...] = ()


def fit_base(problem: DiagnosisProblem, seed: int, starts: int) -> BaseFit:
    """Fit the rig as its file describes it, from its own values and from random points near them.

    Starts are added until two of them end at the same cost in a stationary point. Each search is first bounded to the
    search box around the rig's own values, because a step may leave the range in which the wire transforms and end
    where the parameters have no influence.

    Args:
        problem: The diagnosis problem.
        seed: Seed of the start points.
        starts: Least number of starts.

    Returns:
        The best fit.

    Raises:
        NumericsError: If the simulation fails at the rig's own values.
    """
    base = problem.base_problem
    near = lower, upper = base.search_bounds()
    nominal, rng = np.clip(base.nominal, lower, upper), np.random.default_rng(seed)

    def search_from(offset: np.ndarray) -> MultiStartResult:
        start = np.clip(nominal + _START_SPREAD * offset * (upper - lower), lower, upper)
        result = _solve(problem, start, near)
        on_edge = np.any((result.points[0] <= lower) | (result.points[0] >= upper))
        return _solve(problem, result.points[0], base.bounds) if on_edge else result

    ends: list[MultiStartResult] = []
    while True:
        offsets = [rng.uniform(-1, 1, len(nominal)) if ends or k else np.zeros(len(nominal)) for k in range(2)]
        ends = sorted([*ends, *share_among_cores(search_from, offsets)], key=_cost)
        same = [end for end in ends if end.costs[0] <= _SAME_COST * ends[0].costs[0]]
        best = next((end for end in same if is_stationary(base, end)), ends[0])
        converged = is_stationary(base, best)
        limit = _MAX_STARTS if converged else _MAX_STARTS_NOT_STATIONARY
        if len(ends) >= starts and ((len(same) > 1 and converged) or len(ends) >= limit):
            break
    if best.statuses[0] is SolverStatus.failed:
        raise NumericsError("the simulation fails at the rig's own values: check them with smajax simulate")
    noise = _channel_noise(problem, base, best.residuals[0])
    floor = {channel: value for channel, (value, _) in noise.items()}
    offsets = residual_offsets(base, best.residuals[0], best.jacobians[0], floor)
    return BaseFit(problem.padded(best.points[0]), best.statuses[0], noise, converged, offsets)


def is_stationary(problem: Problem, result: MultiStartResult) -> bool:
    """Return whether the cost has almost no slope along the parameters that are not on a bound.

    With Q an orthonormal basis of their Jacobian and r the residual, the criterion is |Q^T r| <= 0.02 |r|.

    Args:
        problem: The fit problem.
        result: The result of a search on it.
    """
    jacobian, residual, point = result.jacobians[0], result.residuals[0], result.points[0]
    inside = (point > problem.bounds[0]) & (point < problem.bounds[1])
    slope = np.linalg.norm(orthonormal_basis(jacobian[:, inside]).T @ residual)
    return bool(slope <= _STATIONARY * np.linalg.norm(residual))


def _cost(result: MultiStartResult) -> float:
    return result.costs[0] if result.statuses[0] is not SolverStatus.failed else math.inf


def _solve(problem: DiagnosisProblem, point: np.ndarray, bounds: tuple[np.ndarray, np.ndarray]) -> MultiStartResult:
    base = problem.base_problem
    solver = MultiStartSolver(abstract_problem.residual, base, point[None], *bounds, size=base.size, rtol=_RTOL)
    result = solver.advance().result()
    problem.count_simulations(result.simulations)
    return result


def _channel_noise(problem: DiagnosisProblem, base: Problem, residual: np.ndarray) -> dict[str, tuple[float, str]]:
    """Noise of each channel, SI: that of the residual, or that by rounding if it is larger; and its source."""
    inputs, rows = problem.inputs(), problem.splits[TRAIN].rows()
    by_recording = residual.reshape(len(rows), len(base.channels), -1)
    noise = {}
    for i, channel in enumerate(base.channels):
        series = np.concatenate([by_recording[r, i, scored] for r, scored in enumerate(rows)])
        noise[channel] = estimate_noise(series * problem.noise[channel], inputs)
        rounding = max(rounding_noise(r.channels[channel]) for r in problem.splits[TRAIN].recordings)
        if rounding > noise[channel][0]:
            noise[channel] = rounding, "rounding"
    return noise
