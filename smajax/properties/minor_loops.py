"""Minor loops within a branch of a thermal cycle: the temperature turns back, further than noise, and returns.

After a minor loop a shape-memory alloy continues from the point at which the temperature turned back (return-point
memory), so that a branch without the rows of its minor loops is the same as a branch that had none. Noise of the
thermometer causes reversals as well: temperatures are averaged over as many rows as keep a loop visible, and a reversal
counts as a loop where it exceeds the scatter of these averages.
"""

import numpy as np
from jaxtyping import Float
from scipy.ndimage import uniform_filter1d

from smajax.errors import InputError

# Least depth (K) of a loop. This and the constants below were chosen by trial;
# tests/unit/properties/test_properties.py holds them on loops of 3 to 40 K and on thermometers with up to 10 K of
# noise.
_MIN_DEPTH = 0.5
# Least depth of a loop in steps of a coarse thermometer.
_MIN_STEPS = 2.0
# Least depth of a loop in standard deviations of the averaged temperatures: with 1,000 averages, none by chance.
_MIN_STANDARD_DEVIATIONS = 9.0
# Temperatures are averaged until noise hides no loop deeper than this share of the branch's temperature range.
_HIDDEN_SHARE = 0.01
# Least number of averages of a branch.
_MIN_AVERAGES = 24
# Quantiles of the absolute value of a standard normal variable: 0.9 and 0.5 of it lie below these.
_NORMAL_QUANTILE_90 = 1.645
_NORMAL_MEDIAN = 0.6745
# Second differences of white noise have this multiple of its standard deviation: sqrt(1 + 4 + 1).
_SECOND_DIFFERENCE = 6.0**0.5
# A thermometer is coarse where there are fewer distinct temperatures than this share of the rows.
_DISTINCT_SHARE = 0.5
# Rows run backwards where a loop ends in one jump of the temperature by more than this share of the loop's depth.
_JUMP_SHARE = 0.8
# Shorter loops (rows) than this may end in one jump.
_MIN_REVERSED_ROWS = 5


def minor_loops(temperature: Float[np.ndarray, " n"], branch: np.ndarray) -> list[tuple[int, int]]:
    """Find the minor loops of a branch.

    Args:
        temperature: Temperatures (n,) of the recording, degC.
        branch: Rows (m,) of the branch.

    Returns:
        First and last row of each loop, in rows of the recording.

    Raises:
        InputError: A loop ends in one jump: its rows are in reverse order.
    """
    rising = temperature[branch] if temperature[branch[-1]] > temperature[branch[0]] else -temperature[branch]
    noise = _row_noise(rising)
    rows = _averaged_rows(noise, rising)
    averages = uniform_filter1d(rising, rows, mode="nearest")
    reversal = np.maximum.accumulate(averages) - averages
    noise_of_mean = max(noise / np.sqrt(rows), noise_of_averages(averages, rows) if noise > 0.0 else 0.0)
    least = max(_MIN_DEPTH, _MIN_STEPS * _resolution(rising), _MIN_STANDARD_DEVIATIONS * noise_of_mean)
    edges = np.flatnonzero(np.diff(np.r_[False, reversal > 0.0, False]))
    spans = [(int(a), int(b) - 1) for a, b in zip(edges[::2], edges[1::2], strict=True)]
    loops = [(a, b) for a, b in spans if np.max(reversal[a : b + 1]) > least]
    for a, b in loops:
        depth = float(np.max(reversal[a : b + 1]))
        long_enough = b - a >= _MIN_REVERSED_ROWS and b + 1 < len(rising)
        if rows == 1 and long_enough and reversal[b] > _JUMP_SHARE * depth:
            raise InputError(
                f"rows {branch[a] + 1} to {branch[b] + 1} go back by {depth:.3g} K, and the next row jumps forward "
                "again: rows are missing, or not in the order in which they were recorded; sort them by time",
                code="rows-missing",
            )
    margin = rows // 2  # averages turn by this number of rows earlier and later
    return [(int(branch[max(a - margin, 0)]), int(branch[min(b + margin, len(rising) - 1)])) for a, b in loops]


def noise_of_averages(averages: Float[np.ndarray, " n"], rows: int) -> float:
    """Estimate the standard deviation of running means from their second differences.

    It exceeds the standard deviation of single rows over sqrt(rows) where the noise is autocorrelated.

    Args:
        averages: Running means (n,).
        rows: Number of rows of each mean; 1 for the rows themselves.

    Returns:
        The standard deviation, in the unit of the means.
    """
    differences = averages[: -2 * rows] - 2.0 * averages[rows:-rows] + averages[2 * rows :]
    return float(np.median(np.abs(differences))) / (_NORMAL_MEDIAN * _SECOND_DIFFERENCE)


def _row_noise(rising: np.ndarray) -> float:
    """Noise (K) of temperatures that rise except in minor loops; 0 where at most one row goes back."""
    if np.sum(np.diff(rising) < 0.0) < 2:
        return 0.0
    return float(np.quantile(np.abs(np.diff(rising, 2)), 0.9)) / (_NORMAL_QUANTILE_90 * _SECOND_DIFFERENCE)


def _averaged_rows(noise: float, rising: np.ndarray) -> int:
    """The odd number of rows over which temperatures with this noise are averaged."""
    needed = (_MIN_STANDARD_DEVIATIONS * noise / (_HIDDEN_SHARE * float(np.ptp(rising)))) ** 2
    return 2 * int(min(needed, len(rising) / _MIN_AVERAGES) / 2.0) + 1


def _resolution(rising: np.ndarray) -> float:
    """The step of a coarse thermometer (K); 0 where most temperatures are distinct."""
    distinct = np.unique(rising)
    return float(np.min(np.diff(distinct))) if 1 < len(distinct) < _DISTINCT_SHARE * len(rising) else 0.0
