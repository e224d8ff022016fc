"""Checks that a branch has a complete transformation beyond noise and thermal expansion, with enough rows."""

import math

import numpy as np
from jaxtyping import Float

from smajax.errors import InputError
from smajax.properties.segmented_lines import PiecewiseLinearFit

# Least number of rows on each plateau: a line needs two, and one more shows its scatter.
MIN_PLATEAU_ROWS = 3
# Least number of rows on the transformation, as a line needs.
_MIN_TRANSFORMATION_ROWS = 2
# Least change of the strain, as a multiple of its scatter about the lines. This and the constants below were chosen by
# trial; tests/unit/properties/test_properties.py holds them on noise, on small strains and on transformations that did
# not end.
_MIN_SIGNAL_TO_NOISE = 4.0
# Least change of the strain without noise: below it lines cannot be distinguished from rounding.
_MIN_STRAIN_CHANGE = 1e-6
# Thermal expansion (1/K) above that of any shape-memory alloy: a steeper plateau line still belongs to the
# transformation.
_MAX_EXPANSION = 5e-5
# Least slope of the transformation as a multiple of the plateaus' slopes, thermal expansion subtracted.
_MIN_SLOPE_RATIO = 2.0


def check_transformation(
    temperature: Float[np.ndarray, " n"], strain: Float[np.ndarray, " n"], lines: PiecewiseLinearFit, branch: str
) -> None:
    """Check that the three lines of a branch are a transformation with its start and its finish.

    Args:
        temperature: Smoothed temperatures (n,), degC.
        strain: Strains (n,).
        lines: The three lines of the branch.
        branch: ``cooling`` or ``heating``, for the message.

    Raises:
        InputError: No transformation is visible, its end was not reached, or too few rows are on it or on a plateau.
    """
    low, high = lines.breakpoints[0]
    scatter = math.sqrt(float(lines.sum_of_squares[0]) / len(strain))
    ends = lines.strain(lines.breakpoints)[0]
    slopes = lines.slopes[0]
    # Change of the strain in addition to that by the plateaus' slopes.
    change = float(ends[0] - ends[1]) + 0.5 * float(slopes[0] + slopes[2]) * (high - low)
    lengths = low - float(np.min(temperature)), float(np.max(temperature)) - high
    steep_plateau = any(
        abs(slope) > _MAX_EXPANSION and abs(slope) * length > _MIN_SIGNAL_TO_NOISE * scatter
        for slope, length in zip((slopes[0], slopes[2]), lengths, strict=True)
    )
    within = int(np.sum((temperature >= low) & (temperature <= high)))
    visible = abs(change) > _MIN_SIGNAL_TO_NOISE * scatter + _MIN_STRAIN_CHANGE
    if steep_plateau and (not visible or within < _MIN_TRANSFORMATION_ROWS):
        raise _end_not_reached(branch)
    if not visible:
        raise InputError(
            f"on {branch} the strain changes by {abs(change):.2g} from plateau to plateau and scatters by "
            f"{scatter:.2g}: no transformation is seen; apply more load, or heat and cool further",
            code="no-transformation",
            branch=branch,
        )
    _check_rows(temperature, (low, high), within, branch)
    # The plateaus' thermal expansion is part of all three slopes; it opposes the transformation strain in tension and
    # adds to it in compression.
    expansion = min(max(min(slopes[0], slopes[2]), 0.0), _MAX_EXPANSION)
    cold, transformation, hot = np.abs(slopes - expansion)
    if transformation < _MIN_SLOPE_RATIO * max(cold, hot):
        raise _end_not_reached(branch)


def _check_rows(temperature: np.ndarray, ends: tuple[float, float], within: int, branch: str) -> None:
    """Raise ``InputError`` where too few rows lie on the transformation or on a plateau."""
    if within < _MIN_TRANSFORMATION_ROWS:
        raise InputError(
            f"on {branch} {within} row{' lies' if within == 1 else 's lie'} on the transformation, fewer than "
            f"{_MIN_TRANSFORMATION_ROWS}: record more rows per kelvin, or heat and cool further",
            code="few-rows-on-transformation",
            branch=branch,
        )
    low, high = ends
    for plateau, side, verb in ((temperature < low, "colder", "cool"), (temperature > high, "hotter", "heat")):
        if np.sum(plateau) < MIN_PLATEAU_ROWS:
            raise InputError(
                f"on {branch} {np.sum(plateau)} rows are {side} than the transformation, fewer than "
                f"{MIN_PLATEAU_ROWS}: {verb} further, or record more rows per kelvin",
                code="few-rows-on-plateau",
                branch=branch,
                side=side,
            )


def _end_not_reached(branch: str) -> InputError:
    return InputError(
        f"on {branch} a plateau line is nearly as steep as the transformation: its end was not reached; heat and cool "
        "further",
        code="end-not-reached",
        branch=branch,
    )
