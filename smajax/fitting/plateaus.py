"""Plateaus of an input: rows over which its command is constant and only noise changes what was recorded.

A recording is split where the mean changes, by binary segmentation: a part is split at the row of the largest
cumulative sum of deviations from its mean, as long as that is beyond what white noise gives. Parts of a ramp or of a
sine are recognised by a line that fits two neighbours better than a step does, and by their slopes.

Source: fryzlewicz2014 (threshold of the binary segmentation).
"""

import itertools
import math
from typing import NamedTuple

import numpy as np

from smajax.fitting.autoregression import autoregressive_spectrum, fit_autoregression
from smajax.fitting.noise import second_difference_noise

# Factor on the level sqrt(2 log n) that the largest sum of n white deviations has; the value of fryzlewicz2014.
_THRESHOLD = 1.3
# Fewest rows of a plateau: its mean then has less than a third of the noise of a row.
MIN_ROWS = 10
# Noise below this share of the largest value is none: it has no effect on a wire. Chosen by trial, held by
# tests/unit/fitting/test_electrical_noise.py, as are the next two.
_MIN_NOISE = 1e-4
# Above this share of the largest value the scatter is the input itself, such as a pulsed current.
_MAX_NOISE = 0.1
# A part whose slope is more than this number of its standard deviations away from zero is no plateau: for white noise
# one of 16,000 parts.
_MAX_SLOPE = 4.0
# Least share of the rows that are on plateaus; the turning points of a sine have 0.2 to 0.3. Chosen by trial, held by
# the same test.
_MIN_COVER = 0.4
# Probability below which slopes as large as those of all plateaus together are none of white noise.
_SLOPE_PROBABILITY = 1e-3


class Plateaus(NamedTuple):
    """The plateaus of one input in one recording.

    Attributes:
        parts: First row and end of each plateau (k, 2).
        means: The input with the mean of each plateau in its rows (n,); as recorded elsewhere.
        deviations: The recorded input minus ``means`` (n,).
    """

    parts: np.ndarray
    means: np.ndarray
    deviations: np.ndarray

    @property
    def rows(self) -> np.ndarray:
        """Whether each row is on a plateau (n,)."""
        inside = np.zeros(len(self.means), bool)
        for first, end in self.parts:
            inside[first:end] = True
        return inside


def find_plateaus(values: np.ndarray) -> Plateaus:
    """Find the plateaus of an input.

    Args:
        values: The recorded input (n,).

    Returns:
        The plateaus; none where the input has no noise, or does not stay at levels.
    """
    noise = second_difference_noise(values)
    largest = float(np.max(np.abs(values)))
    none = Plateaus(np.zeros((0, 2), int), values, np.zeros(len(values)))
    if not _MIN_NOISE * largest < noise < _MAX_NOISE * largest:
        return none
    ends = _level_changes(values, noise)
    parts = _without_ramps(values, list(itertools.pairwise(ends)))
    parts = _without_slopes(values, parts, noise)
    if sum(end - first for first, end in parts) < _MIN_COVER * len(values):
        return none
    means = values.copy()
    for first, end in parts:
        means[first:end] = np.mean(values[first:end])
    return Plateaus(np.array(parts), means, values - means)


def pooled_noise(plateaus: list[Plateaus]) -> tuple[float, float]:
    """Compute the noise about the means of plateaus, of one row and of a mean of many rows.

    Args:
        plateaus: The plateaus of one input in all recordings, at least one.

    Returns:
        The standard deviation of a row, and that by which a mean of n rows has the standard deviation over root n: the
        root of the spectral density at frequency zero, and at least that of a row. Both in the input's unit.
    """
    deviations = np.concatenate([p.deviations[p.rows] for p in plateaus])
    freedom = len(deviations) - sum(len(p.parts) for p in plateaus)
    deviation = math.sqrt(float(np.sum(deviations**2)) / freedom)
    density = float(autoregressive_spectrum(*fit_autoregression(deviations), np.zeros(1))[0])
    return deviation, max(deviation, math.sqrt(density))


def _level_changes(values: np.ndarray, noise: float) -> list[int]:
    """The rows at which the level changes, with 0 and n at the ends."""
    ends, open_parts = {0, len(values)}, [(0, len(values))]
    limit = _THRESHOLD * noise * math.sqrt(2.0 * math.log(len(values)))
    while open_parts:
        first, end = open_parts.pop()
        middle, size = _best_split(values[first:end])
        if size > limit:
            ends.add(first + middle)
            open_parts += [(first, first + middle), (first + middle, end)]
    ordered = sorted(ends)
    # A first split depends on levels further away: each is placed again between its neighbours.
    for k in range(1, len(ordered) - 1):
        first, end = ordered[k - 1], ordered[k + 1]
        ordered[k] = first + _best_split(values[first:end])[0]
    return ordered


def _best_split(values: np.ndarray) -> tuple[int, float]:
    """The row (1 to n - 1) that divides values best into two levels, and the scaled difference of their means."""
    n = len(values)
    if n < 2:
        return 0, 0.0
    count = np.arange(1, n)
    sums = np.abs(np.cumsum(values - np.mean(values))[:-1]) / np.sqrt(count * (n - count) / n)
    best = int(np.argmax(sums))
    return best + 1, float(sums[best])


def _without_ramps(values: np.ndarray, parts: list[tuple[int, int]]) -> list[tuple[int, int]]:
    """The parts that are long enough, without neighbours which a line fits better than a step."""
    long = [b - a >= MIN_ROWS for a, b in parts]
    kept = list(long)
    for k in range(len(parts) - 1):
        if not (long[k] and long[k + 1]):
            continue
        (first, middle), (_, end) = parts[k], parts[k + 1]
        rows = min(middle - first, end - middle)
        around = values[middle - rows : middle + rows]
        step = np.sum((around - np.repeat([np.mean(around[:rows]), np.mean(around[rows:])], rows)) ** 2)
        index = np.arange(2 * rows) - (rows - 0.5)
        line = np.mean(around) + index * (index @ around) / (index @ index)
        if np.sum((around - line) ** 2) < step:
            kept[k] = kept[k + 1] = False
    return [part for part, keep in zip(parts, kept, strict=True) if keep]


def _without_slopes(values: np.ndarray, parts: list[tuple[int, int]], noise: float) -> list[tuple[int, int]]:
    """The parts without a slope of their own, and together without more slope than white noise has.

    The shortest parts are left out until that holds: a ramp breaks into shorter parts than the plateaus next to it.
    """
    from scipy.special import chdtri  # slow to import

    slopes = {part: _slope(values[slice(*part)], noise) for part in parts}
    kept = sorted((part for part in parts if abs(slopes[part]) < _MAX_SLOPE), key=lambda part: part[0] - part[1])
    while kept and sum(slopes[part] ** 2 for part in kept) > chdtri(len(kept), _SLOPE_PROBABILITY):
        kept.pop()
    return sorted(kept)


def _slope(values: np.ndarray, noise: float) -> float:
    """Slope of values over its standard deviation under white noise."""
    index = np.arange(len(values)) - 0.5 * (len(values) - 1)
    return float(index @ values) / (noise * math.sqrt(float(index @ index)))
