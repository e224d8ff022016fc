"""Least-squares fits of three connected straight lines to a branch of a thermal cycle.

The lines are those of the cold plateau, the transformation and the hot plateau (in ASTM E3097 they are drawn by hand):

    strain(T) = c_0 + c_1 T + c_2 max(T - b_1, 0) + c_3 max(T - b_2, 0)

Both breakpoints b are free, so that no row has to be assigned to a plateau or to the transformation beforehand. All
bootstrap samples of a branch are fitted at once: arrays have the shape (samples, rows).

Source: astm_e3097.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

# Breakpoints are searched between these quantiles of the temperature, since a plateau needs rows. Chosen by trial.
_CANDIDATE_RANGE = (0.04, 0.96)
# Number of breakpoint candidates along a branch; chosen by trial, tests/unit/properties/test_properties.py holds the
# accuracy that results.
_CANDIDATES = 64
# The same with a start from another fit, for which a coarser grid is enough; chosen by trial, held by the same tests.
_CANDIDATES_WITH_START = 24
# Number of Gauss-Newton steps after the search over the candidates; the sum of squares is constant after fewer. Chosen
# by trial.
_GAUSS_NEWTON_STEPS = 8
# Largest Gauss-Newton step of a breakpoint, as a share of the temperature range: keeps a step from leaving the branch.
_LARGEST_STEP = 0.1
# Ridge of the normal equations, relative to columns of norm 1: above rounding (1e-16), far below any real curvature.
_RIDGE = 1e-13
# Two candidates whose columns are parallel to this relative accuracy are left out: their determinant is rounding.
_PARALLEL = 1e-9
# Keeps divisions by norms finite where a column vanishes.
_TINY = 1e-300


class PiecewiseLinearFit(NamedTuple):
    """Three connected lines for each sample.

    Attributes:
        breakpoints: Temperatures (samples, 2) at which the lines meet, degC.
        coefficients: Coefficients (samples, 4) of the columns of ``design_matrix``.
        sum_of_squares: Sum of squared strain residuals (samples,).
    """

    breakpoints: np.ndarray
    coefficients: np.ndarray
    sum_of_squares: np.ndarray

    def strain(self, temperature: Float[np.ndarray, "samples rows"]) -> Float[np.ndarray, "samples rows"]:
        """Return the strain on the lines.

        Args:
            temperature: Temperatures (samples, rows), degC.

        Returns:
            The strain (samples, rows).
        """
        return np.einsum("drk,dk->dr", design_matrix(temperature, self.breakpoints), self.coefficients)

    @property
    def slopes(self) -> Float[np.ndarray, "samples 3"]:
        """Slopes (samples, 3) of the cold plateau, the transformation and the hot plateau, 1/K."""
        return np.cumsum(self.coefficients[:, 1:], axis=1)


def fit_three_lines(
    temperature: Float[np.ndarray, "samples rows"],
    strain: Float[np.ndarray, "samples rows"],
    start: Float[np.ndarray, "2"] | None = None,
) -> PiecewiseLinearFit:
    """Fit three connected lines to each sample by least squares in the strain.

    Args:
        temperature: Temperatures (samples, rows), degC.
        strain: Strains (samples, rows).
        start: Breakpoints (2,) in degC from which a second search begins; the better of the two results is returned.

    Returns:
        The lines of each sample.
    """
    coldest, span = np.min(temperature, axis=1)[:, None], np.ptp(temperature, axis=1)[:, None]
    scaled = (temperature - coldest) / span
    count = _CANDIDATES if start is None else _CANDIDATES_WITH_START
    fit = _refine(scaled, strain, _best_candidates(scaled, strain, count))
    if start is not None:
        fit = _better(fit, _refine(scaled, strain, np.clip((start - coldest) / span, 0.0, 1.0)))
    slopes = fit.coefficients[:, 1:] / span
    level = fit.coefficients[:, :1] - slopes[:, :1] * coldest
    return PiecewiseLinearFit(coldest + span * fit.breakpoints, np.hstack([level, slopes]), fit.sum_of_squares)


def design_matrix(
    temperature: Float[np.ndarray, "samples rows"], breakpoints: Float[np.ndarray, "samples 2"]
) -> Float[np.ndarray, "samples rows 4"]:
    """Return the columns 1, T, max(T - b_1, 0) and max(T - b_2, 0).

    Args:
        temperature: Temperatures T (samples, rows).
        breakpoints: Breakpoints b (samples, 2), in the same unit.

    Returns:
        The columns (samples, rows, 4).
    """
    hinges = np.maximum(temperature[:, :, None] - breakpoints[:, None, :], 0.0)
    return np.concatenate([np.ones_like(hinges[:, :, :1]), temperature[:, :, None], hinges], axis=2)


def _better(first: PiecewiseLinearFit, second: PiecewiseLinearFit) -> PiecewiseLinearFit:
    """For each sample the fit with the smaller sum of squares; the first one where they are equal."""
    better = second.sum_of_squares < first.sum_of_squares
    return PiecewiseLinearFit(
        *(np.where(better[:, None] if a.ndim > 1 else better, b, a) for a, b in zip(first, second, strict=True))
    )


def _refine(temperature: np.ndarray, strain: np.ndarray, breakpoints: np.ndarray) -> PiecewiseLinearFit:
    """Improve breakpoints by Gauss-Newton steps and return the best fit of all steps."""
    best = PiecewiseLinearFit(breakpoints, *_solve_coefficients(temperature, strain, breakpoints))
    # At least two rows stay on each plateau.
    limits = np.partition(temperature, (1, -2), axis=1)[:, [1, -2]]
    current = best
    for _ in range(_GAUSS_NEWTON_STEPS):
        lines = design_matrix(temperature, current.breakpoints)
        derivatives = -current.coefficients[:, None, 2:] * (temperature[:, :, None] > current.breakpoints[:, None, :])
        residual = strain - np.einsum("drk,dk->dr", lines, current.coefficients)
        step = _least_squares(np.concatenate([lines, derivatives], axis=2), residual)[:, 4:]
        breakpoints = current.breakpoints + np.clip(step, -_LARGEST_STEP, _LARGEST_STEP)
        breakpoints = np.sort(np.clip(breakpoints, limits[:, :1], limits[:, 1:]), axis=1)
        current = PiecewiseLinearFit(breakpoints, *_solve_coefficients(temperature, strain, breakpoints))
        best = _better(best, current)
    return best


def _solve_coefficients(
    temperature: np.ndarray, strain: np.ndarray, breakpoints: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Return the least-squares coefficients for these breakpoints and their sums of squared residuals."""
    lines = design_matrix(temperature, breakpoints)
    coefficients = _least_squares(lines, strain)
    return coefficients, np.sum((strain - np.einsum("drk,dk->dr", lines, coefficients)) ** 2, axis=1)


def _least_squares(matrix: np.ndarray, right: np.ndarray) -> np.ndarray:
    """Solve a stack of least-squares problems by normal equations of scaled columns.

    The ridge keeps the equations regular where a column vanishes; the second solve removes the error by the ridge and
    by rounding.
    """
    norms = np.sqrt(np.sum(matrix**2, axis=1)) + _TINY
    scaled = matrix / norms[:, None, :]
    transposed = np.swapaxes(scaled, 1, 2)
    gram = transposed @ scaled + _RIDGE * np.eye(matrix.shape[2])
    solution = np.linalg.solve(gram, transposed @ right[:, :, None])
    correction = np.linalg.solve(gram, transposed @ (right[:, :, None] - scaled @ solution))
    return (solution + correction)[:, :, 0] / norms


def _best_candidates(temperature: np.ndarray, strain: np.ndarray, count: int) -> np.ndarray:
    """Return the best pair of breakpoints (samples, 2) among ``count`` quantiles of the temperature.

    The sum of squares that a pair explains has a closed form: strain and hinge columns are projected onto the
    complement of straight lines, and the coefficients of two hinges follow from a system of two equations.
    """
    candidates = np.quantile(temperature, np.linspace(*_CANDIDATE_RANGE, count), axis=1).T
    hinges = np.maximum(temperature[:, :, None] - candidates[:, None, :], 0.0)
    base, _ = np.linalg.qr(np.stack([np.ones_like(temperature), temperature], axis=2))
    transposed = np.swapaxes(base, 1, 2)
    residual = strain[:, :, None] - base @ (transposed @ strain[:, :, None])
    bends = hinges - base @ (transposed @ hinges)
    gram, projections = np.swapaxes(bends, 1, 2) @ bends, (np.swapaxes(bends, 1, 2) @ residual)[:, :, 0]
    first, second = np.triu_indices(count, 1)
    a, b, c = gram[:, first, first], gram[:, first, second], gram[:, second, second]
    determinant = a * c - b * b
    u, v = projections[:, first], projections[:, second]
    explained = np.where(
        determinant > _PARALLEL * a * c,
        (c * u**2 - 2 * b * u * v + a * v**2) / np.maximum(determinant, _TINY),
        -1.0,
    )
    best = np.argmax(explained, axis=1)
    samples = np.arange(len(temperature))
    return np.stack([candidates[samples, first[best]], candidates[samples, second[best]]], axis=1)
