"""Estimates of a column's noise from its differences."""

import math

import numpy as np

# Median of the absolute values to standard deviation, for normal noise: 1 / Phi^-1(3/4).
MEDIAN_TO_DEVIATION = 1.4826
# Second differences of white noise have 1 + 4 + 1 times its variance.
_SECOND_DIFFERENCE_GAIN = math.sqrt(6.0)
# Least noise as a share of a column's range, so that noise-free columns have a finite weight; chosen by trial.
_MIN_RELATIVE_NOISE = 1e-5


def difference_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a column's noise from its second differences, robustly.

    The recording need not be constant anywhere. Noise that is slower than the sampling is underestimated.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit: at least its rounding and 1e-5 of its range.
    """
    values = values[np.isfinite(values)]
    second = np.diff(values, 2)
    spread = MEDIAN_TO_DEVIATION * float(np.median(np.abs(second))) / _SECOND_DIFFERENCE_GAIN if len(second) else 0.0
    return max(spread, rounding_noise(values), _MIN_RELATIVE_NOISE * float(np.ptp(values)))


def rounding_noise(values: np.ndarray) -> float:
    """Estimate the standard deviation of a column's rounding: its smallest step over the root of 12.

    Args:
        values: The column (n,); NaN where not measured.

    Returns:
        The standard deviation in the column's unit; 0 for a constant column.
    """
    steps = np.diff(np.unique(values[np.isfinite(values)]))
    return float(np.min(steps)) / math.sqrt(12.0) if len(steps) else 0.0
