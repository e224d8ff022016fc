"""Checks that a branch shows a whole transformation beyond noise and thermal expansion, with enough rows."""

import math

import numpy as np

from smajax.errors import InputError
from smajax.properties.segmented_lines import PiecewiseLinearFit

# Rows on each plateau and on the transformation that a line needs.
MIN_PLATEAU_ROWS = 3
_MIN_TRANSFORMATION_ROWS = 2
# The strain changes by more than this multiple of its scatter about the lines. This and the constants below were chosen
# by trial; tests/unit/properties/test_properties.py holds them on noise, on small strains and on transformations that
# did not end.
_MIN_SIGNAL_TO_NOISE = 4.0
# Least change of the strain: below it exact, noise-free lines are not distinguished from rounding.
_MIN_STRAIN_CHANGE = 1e-6
# Thermal expansion (1/K) above that of any shape-memory alloy: a steeper plateau line still belongs to the
# transformation.
_MAX_EXPANSION = 5e-5
# The transformation is at least so many times as steep as the plateaus, expansion aside.
_MIN_SLOPE_RATIO = 2.0


def check_transformation(temperature: np.ndarray, strain: np.ndarray, lines: PiecewiseLinearFit, branch: str) -> None:
    """Check that three lines on a branch show a transformation with its start and its finish.

    Args:
        temperature: Smoothed temperatures (n,), degC.
        strain: Strains (n,).
        lines: The three lines of the branch.
        branch: "cooling" or "heating", for the message.

    Raises:
        InputError: If no transformation is visible, if its end was not reached, or if too few rows lie on it or on a
            plateau.
    """
    low, high = lines.breakpoints[0]
    scatter = math.sqrt(float(lines.sum_of_squares[0]) / len(strain))
    ends = lines.strain(lines.breakpoints)[0]
    slopes = lines.slopes[0]
    # What the strain changes by beyond the plateaus' own slopes.
    change = float(ends[0] - ends[1]) + 0.5 * float(slopes[0] + slopes[2]) * (high - low)
    lengths = low - float(np.min(temperature)), float(np.max(temperature)) - high
    steep_plateau = any(
        abs(slope) > _MAX_EXPANSION and abs(slope) * length > _MIN_SIGNAL_TO_NOISE * scatter
        for slope, length in zip((slopes[0], slopes[2]), lengths, strict=True)
    )
    within = int(np.sum((temperature >= low) & (temperature <= high)))
    visible = abs(change) > _MIN_SIGNAL_TO_NOISE * scatter + _MIN_STRAIN_CHANGE
    if steep_plateau and (not visible or within < _MIN_TRANSFORMATION_ROWS):
        raise InputError(_end_not_reached(branch))
    if not visible:
        raise InputError(
            f"on {branch} the strain moves by {abs(change):.2g} between lines about which it scatters by "
            f"{scatter:.2g}: "
            "no transformation is seen; load more, or heat and cool further"
        )
    _check_rows(temperature, (low, high), within, branch)
    # Both plateaus' expansion is in all three slopes; in tension it opposes the transformation, in compression it adds
    # to it.
    expansion = min(max(min(slopes[0], slopes[2]), 0.0), _MAX_EXPANSION)
    cold, transformation, hot = np.abs(slopes - expansion)
    if transformation < _MIN_SLOPE_RATIO * max(cold, hot):
        raise InputError(_end_not_reached(branch))


def _check_rows(temperature: np.ndarray, ends: tuple[float, float], within: int, branch: str) -> None:
    """Raise ``InputError`` where too few rows lie on the transformation or on a plateau."""
    if within < _MIN_TRANSFORMATION_ROWS:
        raise InputError(
            f"on {branch} {within} row{'' if within == 1 else 's'} lie on the transformation, fewer than "
            f"{_MIN_TRANSFORMATION_ROWS}: record more rows per kelvin, or heat and cool further"
        )
    low, high = ends
    for plateau, side, verb in ((temperature < low, "colder", "cool"), (temperature > high, "hotter", "heat")):
        if np.sum(plateau) < MIN_PLATEAU_ROWS:
            raise InputError(
                f"on {branch} {np.sum(plateau)} rows are {side} than the transformation, fewer than "
                f"{MIN_PLATEAU_ROWS}: "
                f"heat and cool further ({verb}), or record more rows per kelvin"
            )


def _end_not_reached(branch: str) -> str:
    return (
        f"on {branch} a plateau line is nearly as steep as the transformation: "
        "its end was not reached, heat and cool further"
    )
