"""Rows of the cycles of a recording: branches between turning points of the temperature, in pairs."""

import itertools

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from smajax.errors import InputError

# Share of the temperature range by which the temperature has to turn back to begin another branch: minor loops turn
# back by less. Chosen by trial; tests/unit/properties/test_properties.py holds it.
_TURN_SHARE = 0.35
# Rows on a branch: three lines have six coefficients, and as many rows again tell their scatter.
_MIN_ROWS = 12
# A branch covers more than this share of the temperature range: anything less is no whole transformation.
_MIN_SPAN_SHARE = 0.5
# Least temperature range (K): narrower than any hysteresis of a shape-memory alloy with its transformation.
_MIN_RANGE = 5.0
# Rows of the running median from which the noise of a thermometer is estimated.
_NOISE_ROWS = 5
# Standard deviation of a normal variable over its median absolute deviation.
_NORMAL_MAD = 1.4826


def turning_points(temperature: np.ndarray) -> list[int]:
    """Find the rows (in order) at which temperatures (n,) turn; the ends of the recording count as turning points."""
    prominence = _TURN_SHARE * float(np.ptp(temperature))
    peaks = []
    for sign in (1.0, -1.0):
        padded = np.pad(sign * temperature, 1, constant_values=-np.inf)
        peaks += [(int(k) - 1, sign) for k in find_peaks(padded, prominence=prominence)[0]]
    # Equal temperatures with a dip between them are two peaks to SciPy, and one turning point.
    return [next(same)[0] for _, same in itertools.groupby(sorted(peaks), key=lambda peak: peak[1])]


def temperature_noise(temperature: np.ndarray) -> float:
    """Estimate the standard deviation (K) of temperatures (n,) about the median of their neighbours."""
    deviations = np.abs(temperature - median_filter(temperature, _NOISE_ROWS, mode="nearest"))
    return _NORMAL_MAD * float(np.median(deviations))


def find_cycles(name: str, temperature: np.ndarray, *, smooth: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find the rows of the cooling and of the heating branch of each cycle.

    A heating before the first cooling, of a specimen that may just have been loaded, counts only where there is no
    other whole cycle.

    Args:
        name: The recording, for messages.
        temperature: Temperatures (n,), degC.
        smooth: Rows of the running median with which the temperatures are smoothed.

    Raises:
        InputError: If there is no cycle, or if ``smooth`` is even: a median without a middle row shifts everything
            by a row.
    """
    branches, cools = _find_branches(name, temperature, smooth)
    successive = [
        k for k in range(len(branches) - 1) if branches[k + 1][0] - branches[k][-1] <= 1 and cools[k] != cools[k + 1]
    ]
    cooling_first = [(branches[k], branches[k + 1]) for k in successive if cools[k]]
    pairs = cooling_first or [(branches[k + 1], branches[k]) for k in successive]
    if not pairs:
        raise InputError(
            f"{name}: no whole cycle is in it: a cooling and a heating branch of {_MIN_ROWS} rows or more, over most "
            "of the temperatures"
        )
    return pairs


def unpaired_branches(name: str, temperature: np.ndarray, *, smooth: int = 1) -> list[tuple[int, int, bool]]:
    """Find the branches that are in no cycle of ``find_cycles``.

    Args:
        name: The recording, for messages.
        temperature: Temperatures (n,), degC.
        smooth: Rows of the running median with which the temperatures are smoothed.

    Returns:
        First row, last row, and whether it cools, of each such branch.

    Raises:
        InputError: As ``find_cycles``.
    """
    paired = {int(branch[0]) for pair in find_cycles(name, temperature, smooth=smooth) for branch in pair}
    branches, cools = _find_branches(name, temperature, smooth)
    return [(int(b[0]), int(b[-1]), cool) for b, cool in zip(branches, cools, strict=True) if int(b[0]) not in paired]


def _find_branches(name: str, temperature: np.ndarray, smooth: int) -> tuple[list[np.ndarray], list[bool]]:
    """Rows of each branch over most of the temperatures, and whether it cools."""
    if smooth % 2 == 0:
        raise InputError(
            f"{name}: temperatures are smoothed over an odd number of rows, and {smooth} is even: give {smooth + 1}"
        )
    smoothed = median_filter(temperature, smooth, mode="nearest")
    span = float(np.ptp(smoothed))
    if span < _MIN_RANGE <= float(np.ptp(temperature)):
        raise InputError(
            f"{name}: smoothed over {smooth} rows the temperature moves by {span:.3g} K: smooth over fewer"
        )
    if span < _MIN_RANGE:
        raise InputError(f"{name}: the temperature moves by {span:.3g} K: heat and cool through the transformation")
    parts = [np.arange(a, b + 1) for a, b in itertools.pairwise(turning_points(smoothed))]
    branches = [
        rows
        for rows in parts
        if len(rows) >= _MIN_ROWS and abs(smoothed[rows[-1]] - smoothed[rows[0]]) > _MIN_SPAN_SHARE * span
    ]
    return branches, [bool(smoothed[rows[-1]] < smoothed[rows[0]]) for rows in branches]
