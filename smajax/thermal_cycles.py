"""Thermal cycles under constant stress, and the temperatures and strains that ASTM E3097 reads off them by tangents.

A cycle is a way from hot to cold and back. On each of its two branches three straight lines are laid that meet: along the cold rows, along
the transformation, and along the hot rows; where they meet are start and finish. All three are laid at once, by least squares in the strain
with both corners free, so that no row has to be called plateau or transformation beforehand. Intervals come from laying them again through
blocks of the rows drawn at random.
"""

import dataclasses
import itertools
import math
from collections.abc import Sequence

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks

from smajax.errors import InputError

NAMES = ("martensite_start", "martensite_finish", "austenite_start", "austenite_finish")
_TURN = 0.35  # share of the temperature's range by which it has to turn back to begin another branch
_FEWEST = 12  # rows on a branch
_JUMPY = 0.15  # mean step from row to row, as a share of the range, above which the rows are out of order
_DRAWS = 60
_BLOCKS = 24
_CORNERS = 24  # places where a corner is tried first
_REFINED = 10
_SEEN = 4.0  # times the scatter about the lines by which the strain has to move
_LEAST = 1e-6  # strain
_BESIDE = 4  # rows on each plateau
_STEEPER = 2.0  # times the plateaus' slopes that the transformation's has to be


@dataclasses.dataclass(frozen=True)
class Value:
    """A property with its 95 % interval."""

    value: float
    lower95: float
    upper95: float


@dataclasses.dataclass(frozen=True)
class Cycle:
    """One cycle's properties: temperatures in degC, strains as fractions, all with intervals; ``rows`` are its first and last row.

    ``transformation_strain`` is between martensite start and finish on cooling, ``actuation_strain`` between the hottest and the coldest
    rows, ``width`` between the middles of the branches, and ``span`` from martensite finish to austenite finish (K).
    """

    number: int
    rows: tuple[int, int]
    values: dict[str, Value]


def turns(temperature: np.ndarray) -> list[int]:
    """Rows at which the temperature turns, hottest and coldest by turns; the recording's ends, where it comes from or goes to, count."""
    enough = _TURN * float(np.ptp(temperature))
    found = []
    for sign in (1.0, -1.0):
        framed = np.pad(sign * temperature, 1, constant_values=-np.inf)
        found += [(int(k) - 1, sign) for k in find_peaks(framed, prominence=enough)[0]]
    # Rows that are exactly as hot as each other with a dip between them are one turn.
    return [next(same)[0] for _, same in itertools.groupby(sorted(found), key=lambda turn: turn[1])]


def cycles(name: str, temperature: np.ndarray, *, smooth: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of the cooling and of the heating branch of each cycle; temperatures are smoothed over ``smooth`` rows.

    Raises ``InputError`` if the rows are not in the order in which they were recorded, or hold no cycle.
    """
    smooth_t = median_filter(temperature, smooth, mode="nearest")
    reach = float(np.ptp(smooth_t))
    if reach < 5.0:
        raise InputError(f"{name}: the temperature moves by {reach:.3g} K: these are no thermal cycles")
    if float(np.mean(np.abs(np.diff(temperature)))) > _JUMPY * reach:
        told = f"{name}: the temperature jumps to and fro from row to row"
        raise InputError(f"{told}: the rows are not in the order in which they were recorded; sort them by time")
    at = turns(smooth_t)
    branches = [np.arange(a, b + 1) for a, b in itertools.pairwise(at)]
    branches = [b for b in branches if len(b) >= _FEWEST and abs(smooth_t[b[-1]] - smooth_t[b[0]]) > 0.5 * reach]
    pairs, k = [], 0
    while k + 1 < len(branches):
        first, second = branches[k], branches[k + 1]
        if second[0] - first[-1] > 1 or (smooth_t[first[-1]] < smooth_t[first[0]]) == (smooth_t[second[-1]] < smooth_t[second[0]]):
            k += 1
            continue
        pairs.append((first, second) if smooth_t[first[-1]] < smooth_t[first[0]] else (second, first))
        k += 2
    if not pairs:
        raise InputError(
            f"{name}: no whole cycle is in it: a cooling and a heating branch of {_FEWEST} rows or more, over most of the temperatures"
        )
    return pairs


def analyse(
    name: str,
    temperature: np.ndarray,
    strain: np.ndarray,
    *,
    smooth: int = 1,
    seed: int = 0,
) -> tuple[list[Cycle], list[str]]:
    """The properties of every cycle of a recording (arrays ``(n,)``: degC, fraction), and a sentence for each that cannot be read.

    Raises ``InputError`` if there is no cycle at all.
    """
    found, refused = [], []
    warm = median_filter(temperature, smooth, mode="nearest")
    for number, (cooling, heating) in enumerate(cycles(name, temperature, smooth=smooth), 1):
        rows = (int(min(cooling[0], heating[0])), int(max(cooling[-1], heating[-1])))
        try:
            values = _properties(warm, strain, cooling, heating, np.random.default_rng([seed, number]))
        except InputError as error:
            refused.append(f"{name}, cycle {number} (rows {rows[0] + 1} to {rows[1] + 1}): {error}")
            continue
        found.append(Cycle(number, rows, values))
    return found, refused


def _properties(
    warm: np.ndarray, strain: np.ndarray, cooling: np.ndarray, heating: np.ndarray, rng: np.random.Generator
) -> dict[str, Value]:
    first = [tangents(warm[rows], strain[rows], branch) for rows, branch in ((cooling, "cooling"), (heating, "heating"))]

    def all_of(cool: np.ndarray, heat: np.ndarray, near: Sequence[Sequence[float] | None]) -> np.ndarray:
        finish, start, change = tangents(warm[cool], strain[cool], "cooling", near[0])
        begun, ended, _ = tangents(warm[heat], strain[heat], "heating", near[1])
        hot, cold = (strain[cool][np.argsort(warm[cool])][side].mean() for side in (slice(-3, None), slice(3)))
        width = 0.5 * (begun + ended) - 0.5 * (start + finish)
        return np.array([start, finish, begun, ended, change, cold - hot, width, ended - finish])

    best, drawn = all_of(cooling, heating, first), []
    for _ in range(_DRAWS):
        try:
            drawn.append(all_of(_blocks(cooling, rng), _blocks(heating, rng), first))
        except InputError:
            continue
    if len(drawn) < _DRAWS // 2:
        raise InputError("most redrawings of its rows show no transformation: it is hidden in the noise")
    low, high = np.quantile(drawn, [0.025, 0.975], axis=0)
    names = (*NAMES, "transformation_strain", "actuation_strain", "width", "span")
    return {n: Value(float(v), float(min(a, v)), float(max(b, v))) for n, v, a, b in zip(names, best, low, high, strict=True)}


def tangents(temperature: np.ndarray, strain: np.ndarray, branch: str, near: Sequence[float] | None = None) -> tuple[float, float, float]:
    """Lower and upper corner of a branch in degC, and how much larger the strain is at the lower; ``near`` are corners to begin with.

    Raises ``InputError`` if the branch shows no transformation.
    """
    order = np.argsort(temperature, kind="stable")
    t, e = temperature[order], strain[order]
    corners = np.array(near[:2]) if near is not None else _corners(t, e)
    for _ in range(_REFINED):
        lines = _lines(t, corners)
        along = np.linalg.lstsq(lines, e, rcond=None)[0]
        bends = -along[2:] * (t[:, None] > corners)
        moved = np.linalg.lstsq(np.column_stack([lines, bends]), e - lines @ along, rcond=None)[0][4:]
        reach = 0.05 * (t[-1] - t[0])
        corners = np.sort(np.clip(corners + np.clip(moved, -reach, reach), t[1], t[-2]))
    lines = _lines(t, corners)
    along = np.linalg.lstsq(lines, e, rcond=None)[0]
    low, high = corners
    if np.sum(t < low) < _BESIDE or np.sum(t > high) < _BESIDE:
        raise InputError(f"on {branch} there are too few rows beside the transformation: heat and cool further")
    scatter = float(np.std(e - lines @ along))
    middle = 0.5 * (low + high)
    jump = float(along[2] * (low - middle) + along[3] * (high - middle))  # of the cold line above the hot one
    if not abs(jump) > _SEEN * scatter + _LEAST:
        told = f"on {branch} the strain moves by {abs(jump):.2g} between lines about which it scatters by {scatter:.2g}"
        raise InputError(f"{told}: no transformation is seen")
    slopes = np.abs(np.cumsum(along[1:]))
    if slopes[1] < _STEEPER * max(slopes[0], slopes[2]):
        raise InputError(
            f"on {branch} a line beside the transformation is nearly as steep as it: its end was not reached, heat and cool further"
        )
    ends = _lines(corners, corners) @ along
    return float(low), float(high), float(ends[0] - ends[1])


def _lines(t: np.ndarray, corners: np.ndarray) -> np.ndarray:
    """A straight line and what bends it at each corner, as columns."""
    return np.column_stack([np.ones_like(t), t, np.maximum(t - corners[0], 0.0), np.maximum(t - corners[1], 0.0)])


def _corners(t: np.ndarray, e: np.ndarray) -> np.ndarray:
    """The best pair of corners among some places spread over the rows."""
    places = np.quantile(t, np.linspace(0.04, 0.96, _CORNERS))
    bends = np.maximum(t[:, None] - places, 0.0)
    base = np.column_stack([np.ones_like(t), t])
    q, _ = np.linalg.qr(base)
    left, bent = e - q @ (q.T @ e), bends - q @ (q.T @ bends)
    gram, toward = bent.T @ bent, bent.T @ left
    best, found = -1.0, (places[0], places[-1])
    for i in range(_CORNERS):
        for j in range(i + 1, _CORNERS):
            a, b, c = gram[i, i], gram[i, j], gram[j, j]
            below = a * c - b * b
            if below <= 1e-12 * a * c:
                continue
            explained = (c * toward[i] ** 2 - 2 * b * toward[i] * toward[j] + a * toward[j] ** 2) / below
            if explained > best:
                best, found = explained, (places[i], places[j])
    return np.array(found)


def _blocks(rows: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Rows of a branch, drawn in blocks."""
    parts = np.array_split(rows, min(_BLOCKS, len(rows) // 3))
    return np.sort(np.concatenate([parts[k] for k in rng.integers(0, len(parts), len(parts))]))


def mean_of(found: Sequence[Cycle]) -> dict[str, Value]:
    """Means over cycles; the interval is that of the mean by the scatter between them, of a single one its own."""
    means = {}
    for name in found[0].values:
        values = np.array([c.values[name].value for c in found])
        if len(values) == 1:
            means[name] = found[0].values[name]
            continue
        half = 1.96 * float(np.std(values, ddof=1)) / math.sqrt(len(values))
        means[name] = Value(float(values.mean()), float(values.mean()) - half, float(values.mean()) + half)
    return means
