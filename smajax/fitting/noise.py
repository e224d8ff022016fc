"""Estimates of a column's noise: from its differences, and from the resolution of its sensor."""

import math

import numpy as np

# Median of the absolute values to standard deviation, for normal noise: 1 / Phi^-1(3/4).
MEDIAN_TO_DEVIATION = 1.4826
# Second differences of white noise have 1 + 4 + 1 times its variance.
_SECOND_DIFFERENCE_GAIN = math.sqrt(6.0)
# Least noise as a share of a column's range, so that noise-free columns have a finite weight; chosen by trial.
_MIN_RELATIVE_NOISE = 1e-5
# A column is quantised if all its levels are multiples of one step up to this share of the step: the rounding of its
# numbers in a file and by a change of units is far smaller, and the levels of an unrounded column miss it at once.
_STEP_TOLERANCE = 1e-3
# Fewest levels that show a step: the gaps between two or three levels can be multiples of the smallest one by chance.
_MIN_LEVELS = 4
# Levels closer than this share of the range are one: rounding of numbers, far below the resolution of any converter.
_MIN_LEVEL_GAP = 1e-9
# The smallest gap between levels is at most this multiple of the step; more would need a column whose levels are rarer.
_MAX_GAP = 10
# Noise below this share of a column's range has no effect. Chosen by trial, held by
# tests/unit/fitting/test_input_noise.py, as is the next one.
_MIN_NOISE = 1e-4
# Above this share of the range it is the input itself, not noise; chosen by trial.
_MAX_NOISE = 0.05
# Fourth differences of white noise have 1 + 16 + 36 + 16 + 1 times its variance.
_FOURTH_DIFFERENCE_GAIN = math.sqrt(70.0)


def difference_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a column's noise from its second differences, robustly.

    The recording need not be constant anywhere. Noise that is slower than the sampling is underestimated.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit: at least its rounding and 1e-5 of its range.
    """
    values = values[np.isfinite(values)]
    return max(second_difference_noise(values), rounding_noise(values), _MIN_RELATIVE_NOISE * float(np.ptp(values)))


def second_difference_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of white noise from second differences, without a lower limit.

    Args:
        values: The column (n,), all measured.

    Returns:
        The standard deviation in the column's unit; 0 with fewer than three rows.
    """
    second = np.diff(values, 2)
    return MEDIAN_TO_DEVIATION * float(np.median(np.abs(second))) / _SECOND_DIFFERENCE_GAIN if len(second) else 0.0


def row_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a column's scatter from row to row, from its fourth differences.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit; 0 where the scatter is negligible, or so large that it is the
        input itself.
    """
    fourth = np.diff(values, 4)
    fourth = fourth[np.isfinite(fourth)]
    noise = MEDIAN_TO_DEVIATION * float(np.median(np.abs(fourth))) / _FOURTH_DIFFERENCE_GAIN if len(fourth) else 0.0
    span = float(np.nanmax(values) - np.nanmin(values))
    return noise if _MIN_NOISE * span < noise < _MAX_NOISE * span else 0.0


def rounding_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a column's rounding: its smallest step over the root of 12.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit; 0 for a constant column.
    """
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(np.min(steps)) / math.sqrt(12.0) if len(steps) else 0.0


def quantisation_noise(values: np.ndarray) -> float:
    """Compute the standard deviation of a quantised column's rounding: the step of its levels over the root of 12.

    The rounding of a signal that changes slowly stays the same over many rows, so differences of neighbouring rows
    do not show it.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit; 0 for a column whose levels are not multiples of one step, for one
        with less than four levels, and for an even ramp, which shows no step of a sensor.

    Source: widrow1956 (variance of the rounding).
    """
    levels = np.unique(values[np.isfinite(values)])
    # Levels that differ by rounding of numbers only are one level.
    levels = levels[np.append(True, np.diff(levels) > _MIN_LEVEL_GAP * np.ptp(levels))] if len(levels) else levels
    if len(levels) < _MIN_LEVELS:
        return 0.0
    gaps = np.diff(levels)
    stays = np.any(np.diff(values[np.isfinite(values)]) == 0)
    if not stays and np.ptp(gaps) <= _STEP_TOLERANCE * np.min(gaps):
        return 0.0
    for divisor in range(1, _MAX_GAP + 1):
        step = float(np.min(gaps)) / divisor
        multiples = (levels - levels[0]) / step
        if np.max(np.abs(multiples - np.round(multiples))) <= _STEP_TOLERANCE:
            return step / math.sqrt(12.0)
    return 0.0
