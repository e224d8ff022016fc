"""Start, finish and strains of one branch of a thermal cycle, with bootstrap deviations from which intervals follow.

Three lines are fitted to the branch (``segmented_lines``). Start and finish are their breakpoints, or the points
where the tangent at the steepest point of the transformation meets the plateau lines (``steepest_tangent``).
Bootstrap samples of the branch are drawn about the curve that the definition uses, with the scatter and the
autocorrelation of the rows, and temperatures about their smoothed values; each sample is smoothed and fitted like
the measured branch.
"""

from typing import Literal

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter

from smajax.errors import InputError
from smajax.properties.bootstrap import MISFIT_RATIO, SAMPLES, bootstrap_residuals
from smajax.properties.minor_loops import noise_of_averages
from smajax.properties.segmented_lines import PiecewiseLinearFit, fit_three_lines
from smajax.properties.steepest_tangent import (
    Line,
    fit_smooth_curve,
    fit_steepest_tangent,
    require_rows_on_transformation,
)
from smajax.properties.transformation_checks import MIN_PLATEAU_ROWS, check_transformation

Tangent = Literal["lines", "steepest"]

# Most rows of a branch that are fitted; of more, means of neighbours are fitted: the same information, in seconds
# instead of minutes.
_MAX_ROWS = 2000
# Coefficients of three connected lines: level, three slopes and two breakpoints.
_LINE_COEFFICIENTS = 6
# Largest uncertainty of start and finish to either side, as a share of the branch's temperature range: beyond it the
# transformation is hidden in the noise. Chosen by trial; tests/unit/properties/test_properties.py holds it.
_MAX_UNCERTAINTY = 0.25
# Share of the bootstrap samples within this uncertainty: that of a 95 % interval.
_PROBABILITY = 0.95
# Keeps the slope of a plateau finite where its rows have one temperature.
_TINY = 1e-300


def branch_properties(
    temperature: Float[np.ndarray, " n"],
    strain: Float[np.ndarray, " n"],
    branch: str,
    smooth: int,
    tangent: Tangent,
    rng: np.random.Generator,
) -> tuple[Float[np.ndarray, "1 4"], Float[np.ndarray, "samples 4"]]:
    """Estimate the properties of a branch, and the deviations of bootstrap samples from them.

    Args:
        temperature: Temperatures (n,) of the branch, degC.
        strain: Strains (n,).
        branch: ``cooling`` or ``heating``, for messages.
        smooth: Rows of the running median of the temperatures, an odd number.
        tangent: The line along the transformation: that of three lines ("lines") or the steepest tangent ("steepest").
        rng: Random stream of the bootstrap.

    Returns:
        The lower and the upper transformation temperature (degC), the strain between them and the strain between the
        coldest and the hottest row, (1, 4); and the deviations (samples, 4) of the same properties of the bootstrap
        samples from those of the curve about which the samples are drawn.

    Raises:
        InputError: The branch has no complete transformation, too few rows, or noise that hides the transformation.

    Source: astm_e3097.
    """
    size = -(-len(strain) // _MAX_ROWS)
    temperature, strain = _block_means(temperature, size), _block_means(strain, size)
    smooth = smooth // size | 1
    smoothed = median_filter(temperature, smooth, mode="nearest")[None]
    lines = fit_three_lines(smoothed, strain[None])
    check_transformation(smoothed[0], strain, lines, branch)
    if tangent == "steepest":
        require_rows_on_transformation(smoothed, lines, branch)
    if tangent == "lines":
        curve, coefficients = lines.strain(smoothed), _LINE_COEFFICIENTS
    else:
        curve, coefficients = fit_smooth_curve(smoothed, strain[None], lines)
    drawn_t, drawn_e = _bootstrap_branch(temperature, strain, smoothed, lines, curve, coefficients, rng)
    drawn_t = median_filter(drawn_t, (1, smooth), mode="nearest")
    drawn_lines = fit_three_lines(drawn_t, drawn_e, lines.breakpoints[0])
    deviations = _measure(drawn_t, drawn_e, drawn_lines, tangent) - _measure(smoothed, curve, lines, tangent)
    _check_uncertainty(deviations, smoothed[0], strain, lines, branch)
    return _measure(smoothed, strain[None], lines, tangent), deviations


def _bootstrap_branch(
    temperature: np.ndarray,
    strain: np.ndarray,
    smoothed: np.ndarray,
    lines: PiecewiseLinearFit,
    curve: np.ndarray,
    coefficients: int,
    rng: np.random.Generator,
) -> tuple[np.ndarray, np.ndarray]:
    """Draw temperatures and strains (samples, rows) about the smoothed temperatures and the curve."""
    rows = len(strain)
    # Temperature residuals are drawn row by row: those of a running median have no slow noise, so that drawing them in
    # blocks would not add it.
    drawn_t = smoothed + (temperature - smoothed[0])[rng.integers(0, rows, (SAMPLES, rows))]
    line_index = np.searchsorted(lines.breakpoints[0], smoothed[0])
    drawn_e = curve + bootstrap_residuals(line_index, strain - curve[0], coefficients, rng)
    return drawn_t, drawn_e


def _check_uncertainty(
    deviations: np.ndarray, temperature: np.ndarray, strain: np.ndarray, lines: PiecewiseLinearFit, branch: str
) -> None:
    """Raise ``InputError`` where start or finish is too uncertain, or NaN in a bootstrap sample."""
    uncertainty = float(np.max(np.quantile(np.abs(deviations[:, :2]), _PROBABILITY, axis=0)))
    if uncertainty <= _MAX_UNCERTAINTY * float(np.ptp(temperature)):
        return
    finding = f"on {branch} start and finish are uncertain by {uncertainty:.2g} K:"
    residual = strain - lines.strain(temperature[None])[0]
    if float(np.std(residual)) > MISFIT_RATIO * noise_of_averages(strain, 1):
        raise InputError(
            f"{finding} the strain bends where three straight lines do not, as in a transformation in two steps (an "
            "R-phase); give only the part of the branch with one of the steps",
            code="two-steps",
            branch=branch,
        )
    raise InputError(
        f"{finding} the transformation is hidden in the noise; apply more load, or measure with less noise",
        code="hidden-in-noise",
        branch=branch,
    )


def _block_means(values: np.ndarray, size: int) -> np.ndarray:
    """Means of blocks of ``size`` neighbouring values (n,); the last block may be shorter."""
    starts = np.arange(0, len(values), size)
    return np.asarray(np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values))))


def _measure(temperature: np.ndarray, strain: np.ndarray, lines: PiecewiseLinearFit, tangent: Tangent) -> np.ndarray:
    """Both transformation temperatures, the strain between them and between the extreme temperatures: (samples, 4)."""
    cold, hot = (_plateau(temperature, strain, lines, side) for side in (0, 1))
    low, high = lines.breakpoints.T
    if tangent == "steepest":
        steepest = fit_steepest_tangent(temperature, strain, lines)
        low, high = steepest.intersection(cold), steepest.intersection(hot)
    actuation = cold.evaluate(temperature.min(axis=1)) - hot.evaluate(temperature.max(axis=1))
    return np.column_stack([low, high, cold.evaluate(low) - hot.evaluate(high), actuation])


def _plateau(temperature: np.ndarray, strain: np.ndarray, lines: PiecewiseLinearFit, side: int) -> Line:
    """Fit a line to the outer half of the rows below the lower breakpoint (side 0) or above the upper one (side 1).

    The inner half may belong to a transformation that ends slowly. Where the outer half has too few rows, the plateau
    of the three lines is returned.
    """
    breakpoints = lines.breakpoints[:, side, None]
    end = temperature.min(axis=1, keepdims=True) if side == 0 else temperature.max(axis=1, keepdims=True)
    outer = np.abs(temperature - end) <= 0.5 * np.abs(breakpoints - end)
    count = np.maximum(outer.sum(axis=1, keepdims=True), 1)
    middle, level = (np.sum(np.where(outer, v, 0.0), axis=1, keepdims=True) / count for v in (temperature, strain))
    offset = np.where(outer, temperature - middle, 0.0)
    slope = np.sum(offset * strain, axis=1, keepdims=True) / np.maximum(np.sum(offset**2, axis=1, keepdims=True), _TINY)
    fitted, fallback = (middle, level, slope), (breakpoints, lines.strain(breakpoints), lines.slopes[:, 2 * side, None])
    return Line(*(np.where(count >= MIN_PLATEAU_ROWS, a, b)[:, 0] for a, b in zip(fitted, fallback, strict=True)))
