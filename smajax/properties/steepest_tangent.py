"""The tangent at the steepest point of a transformation, and where it meets the plateau lines (ASTM E3097).

Noise makes some slopes between neighbouring rows much steeper than the transformation, so the largest of them is not an
estimate. A cubic is fitted to the middle part of the transformation, and its steepest point is used. The result is a
weighted mean of a straight line and the cubic; the weight of the cubic is the share of the sum of squares that it
explains beyond noise, so that a straight transformation stays straight. Arrays have the shape (samples, rows), as in
``segmented_lines``.

Source: astm_e3097.
"""

from typing import NamedTuple

import numpy as np
from jaxtyping import Float

from smajax.errors import InputError
from smajax.properties.segmented_lines import PiecewiseLinearFit, design_matrix

# Share of the range between the breakpoints to which the cubic is fitted, without the rounded ends. This and the
# constants below were chosen by trial; tests/unit/properties/test_properties.py holds them on exact kinetics and the
# coverage of the intervals.
_MIDDLE_PART = 0.8
# Share of the middle part in which the steepest point is searched: the slope of a cubic is uncertain at its ends.
_SEARCH_PART = 0.6
# Least number of rows on the middle part: two degrees of freedom in addition to the cubic's four coefficients.
_MIN_ROWS = 6
# Coefficients of the cubic; a fit needs more rows than that.
_CUBIC_COEFFICIENTS = 4
# Largest number of knots of the spline of the smooth curve.
_MAX_KNOTS = 11
# Least number of rows per knot.
_ROWS_PER_KNOT = 8
# Distance of the outer knots from the breakpoints, as a share of the range between these.
_REACH = 0.75
# Relative singular values below which columns of the spline count as dependent.
_RANK_TOLERANCE = 1e-9
# Keeps divisions and triangular systems regular where a sample has too few rows; such results are not used.
_TINY = 1e-300
# Least half length of a middle part (K): a poor bootstrap sample may have coinciding breakpoints.
_MIN_HALF_LENGTH = 1e-9


class Line(NamedTuple):
    """A straight line for each sample, by a point and the slope.

    Attributes:
        temperature: Temperatures (samples,) of the points, degC.
        strain: Strains (samples,) of the points.
        slope: Slopes (samples,), 1/K.
    """

    temperature: np.ndarray
    strain: np.ndarray
    slope: np.ndarray

    def evaluate(self, temperature: Float[np.ndarray, " samples"]) -> Float[np.ndarray, " samples"]:
        """Return the strain on the line at temperatures (samples,) in degC."""
        return self.strain + self.slope * (temperature - self.temperature)

    def intersection(self, other: "Line") -> Float[np.ndarray, " samples"]:
        """Return the temperature (samples,) in degC at which the line intersects another one."""
        return other.temperature + (self.evaluate(other.temperature) - other.strain) / (other.slope - self.slope)


def require_rows_on_transformation(
    temperature: Float[np.ndarray, "1 rows"], lines: PiecewiseLinearFit, branch: str
) -> None:
    """Check that the transformation has enough rows for its steepest point.

    Args:
        temperature: Temperatures (1, rows) of a branch, degC.
        lines: Its three lines.
        branch: ``cooling`` or ``heating``, for the message.

    Raises:
        InputError: Too few rows are on the middle part of the transformation.
    """
    count = int(np.sum(np.abs(_relative_position(temperature, lines)) <= 1.0))
    if count < _MIN_ROWS:
        raise InputError(
            f"on {branch} {count} rows lie on the transformation's middle part, fewer than the {_MIN_ROWS} that its "
            "steepest tangent needs: record more rows per kelvin, or use three lines (--tangent lines)",
            code="few-rows-for-tangent",
            branch=branch,
        )


def fit_steepest_tangent(
    temperature: Float[np.ndarray, "samples rows"], strain: Float[np.ndarray, "samples rows"], lines: PiecewiseLinearFit
) -> Line:
    """Fit the tangents at the steepest points of the transformations.

    Where no cubic can be fitted, the middle one of the three lines is returned.

    Args:
        temperature: Temperatures (samples, rows), degC.
        strain: Strains (samples, rows).
        lines: The three lines of each sample, whose breakpoints are the ends of the transformation.

    Returns:
        The tangent of each sample.

    Source: astm_e3097.
    """
    middle, half = _middle_part(lines)
    position = _relative_position(temperature, lines)
    used = np.abs(position) <= 1.0
    count = used.sum(axis=1)
    powers = np.where(used[:, :, None], position[:, :, None] ** np.arange(_CUBIC_COEFFICIENTS), 0.0)
    values = np.where(used, strain, 0.0)
    line, line_squares = _fit_polynomial(powers[:, :, :2], values)
    cubic, cubic_squares = _fit_polynomial(powers, values)
    # Sum of squares that two more coefficients explain of noise alone.
    by_noise = 2.0 * cubic_squares / np.maximum(count - _CUBIC_COEFFICIENTS, 1)
    weight = np.clip(1.0 - by_noise / np.maximum(line_squares - cubic_squares, _TINY), 0.0, 1.0)[:, None]
    coefficients = line + weight * (cubic - line)
    steepest, slope = _steepest_point(coefficients, np.sign(line[:, 1:2]))
    strain_there = np.sum(coefficients * steepest[:, None] ** np.arange(_CUBIC_COEFFICIENTS), axis=1)
    tangent = middle + half * steepest, strain_there, slope / half
    fallback = middle, lines.strain(middle[:, None])[:, 0], lines.slopes[:, 1]
    return Line(*(np.where(count > _CUBIC_COEFFICIENTS, b, a) for a, b in zip(fallback, tangent, strict=True)))


def fit_smooth_curve(
    temperature: Float[np.ndarray, "1 rows"], strain: Float[np.ndarray, "1 rows"], lines: PiecewiseLinearFit
) -> tuple[Float[np.ndarray, "1 rows"], int]:
    """Fit a curve that may be smooth or have corners: three lines plus a natural cubic spline near the transformation.

    Args:
        temperature: Temperatures (1, rows), degC.
        strain: Strains (1, rows).
        lines: The three lines of the branch.

    Returns:
        The strain (1, rows) on the curve, and the number of its independent coefficients.
    """
    low, high = lines.breakpoints[0]
    knots = np.linspace(-_REACH, 1.0 + _REACH, min(_MAX_KNOTS, temperature.shape[1] // _ROWS_PER_KNOT))
    share = (temperature[0] - low) / (high - low)
    cubes = np.maximum(share[:, None] - knots, 0.0) ** 3
    bends = (cubes[:, :-1] - cubes[:, -1:]) / (knots[-1] - knots[:-1])
    columns = np.hstack([design_matrix(temperature, lines.breakpoints)[0], bends[:, :-1] - bends[:, -1:]])
    scaled = columns / (np.linalg.norm(columns, axis=0) + _TINY)
    coefficients, _, rank, _ = np.linalg.lstsq(scaled, strain[0], rcond=_RANK_TOLERANCE)
    return (scaled @ coefficients)[None], int(rank)


def _relative_position(temperature: np.ndarray, lines: PiecewiseLinearFit) -> np.ndarray:
    """Position (samples, rows) on the transformation: from -1 to 1 on its middle part."""
    middle, half = _middle_part(lines)
    return (temperature - middle[:, None]) / half[:, None]


def _middle_part(lines: PiecewiseLinearFit) -> tuple[np.ndarray, np.ndarray]:
    """Centre of the transformation and half the length of its middle part, (samples,) each, in degC and K."""
    low, high = lines.breakpoints.T
    return 0.5 * (low + high), np.maximum(0.5 * _MIDDLE_PART * (high - low), _MIN_HALF_LENGTH)


def _steepest_point(coefficients: np.ndarray, sign: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Position (samples,) and slope of a cubic where ``sign`` times its slope is largest in the search part."""
    vertex = -coefficients[:, 2] / np.where(coefficients[:, 3] == 0.0, _TINY, 3.0 * coefficients[:, 3])
    candidates = (-np.ones_like(vertex), vertex, np.ones_like(vertex))
    positions = np.stack([np.clip(at, -_SEARCH_PART, _SEARCH_PART) for at in candidates], axis=1)
    slopes = coefficients[:, 1:2] + 2.0 * coefficients[:, 2:3] * positions + 3.0 * coefficients[:, 3:] * positions**2
    best = np.argmax(slopes * sign, axis=1)[:, None]
    position, slope = (np.take_along_axis(values, best, axis=1)[:, 0] for values in (positions, slopes))
    return position, slope


def _fit_polynomial(powers: np.ndarray, strain: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (samples, 4) of the polynomials, padded by zeros, and their sums of squared residuals."""
    size = powers.shape[2]
    base, upper = np.linalg.qr(powers)
    upper = upper + _TINY * np.eye(size)
    coefficients = np.linalg.solve(upper, np.einsum("drk,dr->dk", base, strain)[:, :, None])[:, :, 0]
    residual = strain - np.einsum("drk,dk->dr", powers, coefficients)
    return np.pad(coefficients, ((0, 0), (0, _CUBIC_COEFFICIENTS - size))), np.sum(residual**2, axis=1)
