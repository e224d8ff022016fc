"""Estimates of a fit with their intervals, and the noise floor of its channels."""

import dataclasses
import math

import numpy as np

from smajax.fitting.bounds import parameters_at_bounds
from smajax.fitting.collinearity import CollinearGroup, find_collinear_groups
from smajax.fitting.intervals import confidence_half_widths, covariance_under_autocorrelation
from smajax.fitting.noise import difference_noise, quantisation_noise
from smajax.fitting.problem import Problem
from smajax.fitting.result import Estimate, Response

# Least size of a scaled parameter in the direction of a collinear group, so that one near 0 does not divide by it.
_MIN_SIZE = 1e-3


def estimates_with_intervals(
    problem: Problem, vector: np.ndarray, residual: np.ndarray, jacobian: np.ndarray
) -> tuple[list[Estimate], np.ndarray, list[CollinearGroup]]:
    """Return the estimates of a fit with their intervals.

    Args:
        problem: The problem.
        vector: The vector at which the search ended (p,).
        residual: The residual there.
        jacobian: Its Jacobian.

    Returns:
        The estimates, their covariance (p, p) in internal units, and the groups of collinear parameters.
    """
    at_bound = parameters_at_bounds(vector, *problem.bounds, residual, jacobian)
    free = np.flatnonzero(~at_bound)
    covariance, samples = _covariance(problem, free, residual, jacobian)
    half_widths = confidence_half_widths(covariance, samples, len(free))
    estimates = []
    for i, unknown in enumerate(problem.unknowns):
        value, half = float(vector[i] * unknown.scale), float(half_widths[i])
        interval = (value - half, value + half) if math.isfinite(half) else (None, None)
        bounds = (unknown.lower, unknown.upper)
        estimates.append(Estimate(unknown.label, value, *interval, unknown.unit, bool(at_bound[i]), bounds))
    names = [problem.unknowns[i].label for i in free]
    sizes = np.array([max(abs(vector[i]), _MIN_SIZE) for i in free])
    return estimates, covariance, find_collinear_groups(jacobian[:, free], names, sizes)


def widen(estimates: tuple[Estimate, ...], before: np.ndarray, after: np.ndarray) -> tuple[Estimate, ...]:
    """Widen intervals as their covariance grows.

    Args:
        estimates: Estimates with the intervals of ``before``.
        before: Covariance (p, p), internal units.
        after: Covariance (p, p) with further errors.

    Returns:
        The estimates, with no interval where the variance is no longer finite.
    """
    widened = []
    for estimate, old, new in zip(estimates, np.diag(before), np.diag(after), strict=True):
        low, high = estimate.lower95, estimate.upper95
        if low is not None and high is not None and old > 0.0:
            half = 0.5 * (high - low) * math.sqrt(new / old)
            low, high = (estimate.estimate - half, estimate.estimate + half) if math.isfinite(half) else (None, None)
        widened.append(dataclasses.replace(estimate, lower95=low, upper95=high))
    return tuple(widened)


def noise_floor(response: Response, channel: str) -> float:
    """Return the noise of a channel: that of the residual's differences, and at least the channel's rounding.

    Args:
        response: Response of the fitted plant.
        channel: The channel.
    """
    return max(difference_noise(response.residual(channel)), quantisation_noise(response.recording.channels[channel]))


def _covariance(
    problem: Problem, free: np.ndarray, residual: np.ndarray, jacobian: np.ndarray
) -> tuple[np.ndarray, int]:
    """Covariance (p, p) in internal units, NaN for parameters that are not free, and the number of samples."""
    weight = problem.data.weight
    measured = np.asarray(weight).reshape(-1, weight.shape[-1]) > 0
    series = residual.reshape(measured.shape)
    columns = jacobian.reshape(*measured.shape, -1)[..., free]
    scaled = covariance_under_autocorrelation(
        [columns[k][rows] for k, rows in enumerate(measured)],
        [series[k][rows] for k, rows in enumerate(measured)],
        len(free),
    )
    scales = np.array([u.scale for u in problem.unknowns])[free]
    covariance = np.full((len(problem.unknowns),) * 2, np.nan)
    covariance[np.ix_(free, free)] = scaled * np.outer(scales, scales)
    return covariance, int(np.sum(measured))
