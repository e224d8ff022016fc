"""Rows of the cycles of a recording: branches between turning points of the temperature, in pairs."""

import itertools

import numpy as np
from jaxtyping import Float
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from smajax.errors import InputError
from smajax.fitting.noise import MEDIAN_TO_DEVIATION

# Least reversal of the temperature that begins another branch, as a share of its range: minor loops turn back by less.
# Chosen by trial; tests/unit/properties/test_properties.py holds it.
_TURN_SHARE = 0.35
# Least number of rows on a branch: three lines have six coefficients, and six more rows determine the scatter.
_MIN_ROWS = 12
# Least share of the temperature range that a branch covers: a shorter one has no complete transformation.
_MIN_SPAN_SHARE = 0.5
# Least temperature range (K): below the width of a whole hysteresis loop of any shape-memory alloy.
_MIN_RANGE = 5.0
# Rows of the running median from which the noise of a thermometer is estimated.
_NOISE_ROWS = 5


def turning_points(temperature: Float[np.ndarray, " n"]) -> list[int]:
    """Find the rows at which the temperature turns, the ends of the recording included.

    Args:
        temperature: Temperatures (n,), degC.

    Returns:
        The rows in increasing order.
    """
    prominence = _TURN_SHARE * float(np.ptp(temperature))
    peaks = []
    for sign in (1.0, -1.0):
        padded = np.pad(sign * temperature, 1, constant_values=-np.inf)
        peaks += [(int(k) - 1, sign) for k in find_peaks(padded, prominence=prominence)[0]]
    # For SciPy, two equal temperatures with a dip between them are two peaks; they are one turning point.
    return [next(same)[0] for _, same in itertools.groupby(sorted(peaks), key=lambda peak: peak[1])]


def temperature_noise(temperature: Float[np.ndarray, " n"]) -> float:
    """Estimate the standard deviation of the noise of temperatures, from their running median.

    Args:
        temperature: Temperatures (n,), degC.

    Returns:
        The standard deviation, K.
    """
    deviations = np.abs(temperature - median_filter(temperature, _NOISE_ROWS, mode="nearest"))
    return MEDIAN_TO_DEVIATION * float(np.median(deviations))


def find_cycles(
    name: str, temperature: Float[np.ndarray, " n"], *, smooth: int = 1
) -> list[tuple[np.ndarray, np.ndarray]]:
    """Find the rows of the cooling and of the heating branch of each cycle.

    A cycle begins with cooling: a heating branch before the first cooling, at which the specimen may just have been
    loaded, belongs to a cycle only where there is no other complete cycle.

    Args:
        name: The recording, for messages.
        temperature: Temperatures (n,), degC.
        smooth: Rows of the running median with which the temperatures are smoothed, an odd number.

    Returns:
        The rows of the cooling and of the heating branch, one pair for each cycle.

    Raises:
        InputError: There is no complete cycle, or ``smooth`` is even: a median without a middle row shifts the
            temperatures by a row.
    """
    branches, cools = _find_branches(name, temperature, smooth)
    successive = [
        k for k in range(len(branches) - 1) if branches[k + 1][0] - branches[k][-1] <= 1 and cools[k] != cools[k + 1]
    ]
    cooling_first = [(branches[k], branches[k + 1]) for k in successive if cools[k]]
    pairs = cooling_first or [(branches[k + 1], branches[k]) for k in successive]
    if not pairs:
        raise InputError(
            f"{name}: it has no complete cycle: record a cooling and a heating branch, each of {_MIN_ROWS} rows or "
            "more over most of the temperature range"
        )
    return pairs


def unpaired_branches(
    name: str, temperature: Float[np.ndarray, " n"], *, smooth: int = 1
) -> list[tuple[int, int, bool]]:
    """Find the branches that are in no cycle of ``find_cycles``.

    Args:
        name: The recording, for messages.
        temperature: Temperatures (n,), degC.
        smooth: Rows of the running median with which the temperatures are smoothed, an odd number.

    Returns:
        First row, last row, and whether it cools, for each such branch.

    Raises:
        InputError: There is no complete cycle, or ``smooth`` is even.
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
            f"{name}: smoothed over {smooth} rows the temperature changes by {span:.3g} K only: smooth over fewer rows"
        )
    if span < _MIN_RANGE:
        raise InputError(
            f"{name}: the temperature changes by {span:.3g} K only: heat and cool through the transformation"
        )
    parts = [np.arange(a, b + 1) for a, b in itertools.pairwise(turning_points(smoothed))]
    branches = [
        rows
        for rows in parts
        if len(rows) >= _MIN_ROWS and abs(smoothed[rows[-1]] - smoothed[rows[0]]) > _MIN_SPAN_SHARE * span
    ]
    return branches, [bool(smoothed[rows[-1]] < smoothed[rows[0]]) for rows in branches]
