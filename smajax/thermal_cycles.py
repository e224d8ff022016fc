"""Thermal cycles under constant stress, and the temperatures and strains that ASTM E3097 reads off them by tangents.

A cycle is a way from hot to cold and back. On each of its two branches three straight lines are laid that meet (``tangents.py``); where
they meet are start and finish. Or the transformation's line is the tangent at its steepest place (``steepest.py``), as ASTM E3097 draws
it, and start and finish are where it meets the plateaus' lines. Intervals come from redrawn branches: the course that the definition
takes, with distances from it that scatter and go together as the rows' do, and temperatures about their smooth course. Each is smoothed,
begun and laid like the measured one.

Where a transformation begins or ends slowly, the place of its end is a matter of definition, beyond what the interval tells: a tangent at
the steepest place ends it early, one of a symmetrical sigmoid through all rows, as other programs lay it, late, three lines between. The
measured NiTiHf begins sharply on cooling and ends slowly, and its M_f lies some kelvins above that of the sigmoid.
"""

import dataclasses
import itertools
import math
from collections.abc import Callable, Sequence
from typing import Literal

import numpy as np
from scipy.ndimage import median_filter
from scipy.signal import find_peaks, lfilter
from scipy.stats import t as student

from smajax.errors import InputError
from smajax.fit.uncertainty import autoregression
from smajax.inner_loops import inner_loops, scatter
from smajax.row_order import refuse_disorder, refuse_strays
from smajax.steepest import Straight, course, refuse_few, steepest
from smajax.tangents import Lines, lay

Tangent = Literal["lines", "steepest"]

NAMES = ("martensite_start", "martensite_finish", "austenite_start", "austenite_finish")
VALUES = (*NAMES, "transformation_strain", "actuation_strain", "width", "span")
_TURN = 0.35  # share of the temperature's range by which it has to turn back to begin another branch
_FEWEST = 12  # rows on a branch
_MOST = 2000  # of more rows on a branch, means of neighbours tell as much
_DRAWS = 60
_INSIDE = 0.95 * (_DRAWS + 1) / _DRAWS  # the quantile of so many draws below which one more lies in 95 % of all cases
_FREE = 6  # numbers in the three lines
_FEWEST_LEFT = 4.0  # rows that err by themselves, beyond those numbers
_SLOWEST = 0.96  # neighbours that go together more than this are no noise in so many rows
_TAKEN = 0.05  # numbers of a course to a row
_POOL = 4  # rows on a line that tell its noise
_SEEN = 4.0  # times the scatter about the lines by which the strain has to move
_LEAST = 1e-6  # strain
_EXPANSION = 5e-5  # 1/K: what no lattice expands by, a line beside the transformation as steep as this belongs to it
_BESIDE = 3  # rows on each plateau
_WITHIN = 2  # rows on the transformation
_STEEPER = 2.0  # times the plateaus' slopes that the transformation's has to be, expansion aside
_BACKWARDS = 0.02  # of the temperatures
_HIDDEN = 0.25  # of the branch's temperatures, to either side
_NO_NOISE = 5.0  # times the scatter from row to row: what is further off the lines is no noise


@dataclasses.dataclass(frozen=True)
class Value:
    """A property with its 95 % interval."""

    value: float
    lower95: float
    upper95: float


@dataclasses.dataclass(frozen=True)
class Cycle:
    """One cycle's properties: temperatures in degC, strains as fractions, all with intervals; ``rows`` are its first and last row.

    On heating, ``transformation_strain`` is between the plateaus at austenite start and finish, ``actuation_strain`` between them at the
    coldest and the hottest row. ``width`` (K) is between the middles of the branches, ``span`` from martensite to austenite finish.
    ``loops`` are the first and last rows of loops within it, which are left out.
    """

    number: int
    rows: tuple[int, int]
    values: dict[str, Value]
    loops: tuple[tuple[int, int], ...] = ()


def turns(temperature: np.ndarray) -> list[int]:
    """Rows at which the temperature turns, hottest and coldest by turns; the recording's ends, where it comes from or goes to, count."""
    enough = _TURN * float(np.ptp(temperature))
    found = []
    for sign in (1.0, -1.0):
        framed = np.pad(sign * temperature, 1, constant_values=-np.inf)
        found += [(int(k) - 1, sign) for k in find_peaks(framed, prominence=enough)[0]]
    # Rows that are exactly as hot as each other with a dip between them are one turn.
    return [next(same)[0] for _, same in itertools.groupby(sorted(found), key=lambda turn: turn[1])]


def unsteadiness(temperature: np.ndarray) -> float:
    """How far temperatures (n,) scatter about their neighbours' median (standard deviation, K); none where they rise or fall steadily."""
    return 1.4826 * float(np.median(np.abs(temperature - median_filter(temperature, 5, mode="nearest"))))


def cycles(name: str, temperature: np.ndarray, *, smooth: int = 1) -> list[tuple[np.ndarray, np.ndarray]]:
    """Rows of the cooling and of the heating branch of each cycle; temperatures are smoothed over ``smooth`` rows.

    A heating before the first cooling, of a specimen that may just have been loaded, counts only where there is no whole cycle else.
    Raises ``InputError`` if the rows hold no cycle, or if ``smooth`` is even: a median without a middle row puts all a row aside.
    """
    branches, cools = _branches(name, temperature, smooth)
    follow = [k for k in range(len(branches) - 1) if branches[k + 1][0] - branches[k][-1] <= 1 and cools[k] != cools[k + 1]]
    pairs = [(branches[k], branches[k + 1]) for k in follow if cools[k]] or [(branches[k + 1], branches[k]) for k in follow]
    if not pairs:
        raise InputError(
            f"{name}: no whole cycle is in it: a cooling and a heating branch of {_FEWEST} rows or more, over most of the temperatures"
        )
    return pairs


def unpaired(name: str, temperature: np.ndarray, *, smooth: int = 1) -> list[tuple[int, int, bool]]:
    """First row, last row, and whether it cools, of each branch that is in none of the ``cycles``."""
    taken = {int(branch[0]) for pair in cycles(name, temperature, smooth=smooth) for branch in pair}
    branches, cools = _branches(name, temperature, smooth)
    return [(int(b[0]), int(b[-1]), cool) for b, cool in zip(branches, cools, strict=True) if int(b[0]) not in taken]


def _branches(name: str, temperature: np.ndarray, smooth: int) -> tuple[list[np.ndarray], list[bool]]:
    """Rows of each way from hot to cold or back over most of the temperatures, and whether it cools."""
    if smooth % 2 == 0:
        raise InputError(f"{name}: temperatures are smoothed over an odd number of rows, and {smooth} is even: give {smooth + 1}")
    smooth_t = median_filter(temperature, smooth, mode="nearest")
    reach = float(np.ptp(smooth_t))
    if reach < 5.0 <= float(np.ptp(temperature)):
        raise InputError(f"{name}: smoothed over {smooth} rows the temperature moves by {reach:.3g} K: smooth over fewer")
    if reach < 5.0:
        raise InputError(f"{name}: the temperature moves by {reach:.3g} K: heat and cool through the transformation")
    ways = [np.arange(a, b + 1) for a, b in itertools.pairwise(turns(smooth_t))]
    found = [b for b in ways if len(b) >= _FEWEST and abs(smooth_t[b[-1]] - smooth_t[b[0]]) > 0.5 * reach]
    return found, [bool(smooth_t[b[-1]] < smooth_t[b[0]]) for b in found]


def analyse(
    name: str,
    temperature: np.ndarray,
    strain: np.ndarray,
    *,
    smooth: int = 1,
    seed: int = 0,
    tangent: Tangent = "lines",
    progress: Callable[[str], None] = lambda text: None,
) -> tuple[list[Cycle], list[str]]:
    """The properties of every cycle of a recording (arrays ``(n,)``: degC, fraction), and a sentence for each that cannot be read.

    With ``tangent`` the transformation's line is that of three laid by least squares ("lines"), or the tangent where it is "steepest".
    ``progress`` is told which cycle is read.

    Raises ``InputError`` if the rows are not in the order in which they were recorded, or if there is no cycle at all.
    """
    found, refused = [], []
    pairs = _in_order(name, temperature, strain, smooth)
    for number, (cooling, heating) in enumerate(pairs, 1):
        rows = (int(min(cooling[0], heating[0])), int(max(cooling[-1], heating[-1])))
        progress(f"{name}: cycle {number} of {len(pairs)}")
        try:
            loops = [loop for branch in (cooling, heating) for loop in inner_loops(temperature, branch)]
            inner = np.concatenate([np.arange(first, last + 1) for first, last in loops]) if loops else np.zeros(0, int)
            cooling, heating = (branch[~np.isin(branch, inner)] for branch in (cooling, heating))
            values = _properties(temperature, strain, cooling, heating, smooth, tangent, np.random.default_rng([seed, number]))
        except InputError as error:
            refused.append(f"{name}, cycle {number} (rows {rows[0] + 1} to {rows[1] + 1}): {error}")
            continue
        found.append(Cycle(number, rows, values, tuple(sorted(loops))))
    return found, refused


def _in_order(name: str, temperature: np.ndarray, strain: np.ndarray, smooth: int) -> list[tuple[np.ndarray, np.ndarray]]:
    if np.ptp(temperature) > 0.0:
        refuse_disorder(name, temperature, strain)
        refuse_strays(name, "a strain of", strain)
    return cycles(name, temperature, smooth=smooth)


def _properties(
    temperature: np.ndarray,
    strain: np.ndarray,
    cooling: np.ndarray,
    heating: np.ndarray,
    smooth: int,
    tangent: Tangent,
    rng: np.random.Generator,
) -> dict[str, Value]:
    """Values of a cycle, each with the distance within which 95 % of its redrawings lie from what they are drawn of."""
    kinds = ((cooling, "cooling"), (heating, "heating"))
    branches = [_branch(temperature[rows], strain[rows], kind, smooth, tangent, rng) for rows, kind in kinds]
    best, half = _joined(*(value for value, _ in branches)), np.quantile(np.abs(_joined(*(away for _, away in branches))), _INSIDE, axis=0)
    width = float(best[0, VALUES.index("width")])
    if width < -max(float(half[VALUES.index("width")]), _BACKWARDS * float(np.ptp(temperature))):
        told = f"it cools through the transformation {-width:.3g} K above where it heats through it, which no shape-memory alloy does"
        raise InputError(f"{told}: the rows run backwards, or the temperature lags far behind the wire's: give them in the order of time")
    return {n: Value(float(v), float(v - h), float(v + h)) for n, v, h in zip(VALUES, best[0], half, strict=True)}


def _joined(cooling: np.ndarray, heating: np.ndarray) -> np.ndarray:
    """The properties (draws, 8) of both branches' corners and strains."""
    (finish, start, *_), (begun, ended, change, moved) = cooling.T, heating.T
    width = 0.5 * (begun + ended) - 0.5 * (start + finish)
    return np.stack([start, finish, begun, ended, change, moved, width, ended - finish], axis=1)


def _branch(
    temperature: np.ndarray, strain: np.ndarray, kind: str, smooth: int, tangent: Tangent, rng: np.random.Generator
) -> tuple[np.ndarray, np.ndarray]:
    """A branch's corners and strains (1, 4), and how far redrawings (draws, 4) lie from what they are drawn of."""
    each = -(-len(strain) // _MOST)
    temperature, strain, smooth = _averaged(temperature, each), _averaged(strain, each), smooth // each | 1
    warm = median_filter(temperature, smooth, mode="nearest")[None]
    lines = lay(warm, strain[None])
    _refuse_unseen(warm[0], strain, lines, kind)
    if tangent == "steepest":
        refuse_few(warm, lines, kind)
    drawn_of, free = (lines.strain(warm), _FREE) if tangent == "lines" else course(warm, strain[None], lines)
    distance, count = strain - drawn_of[0], len(strain)
    # Distances from a smoothed course lack what is slow, which blocks would pass on; drawn singly they have it again.
    drawn_t = warm + (temperature - warm[0])[rng.integers(0, count, (_DRAWS, count))]
    drawn_e = drawn_of + _redrawn(np.searchsorted(lines.corners[0], warm[0]), distance, free, rng)
    drawn_t = median_filter(drawn_t, (1, smooth), mode="nearest")
    again = lay(drawn_t, drawn_e, lines.corners[0])
    away = _measured(drawn_t, drawn_e, again, tangent) - _measured(warm, drawn_of, lines, tangent)
    unsure = float(np.max(np.quantile(np.abs(away[:, :2]), 0.95, axis=0)))
    if not unsure <= _HIDDEN * float(np.ptp(warm)):  # nor where a draw has no corner at all
        told = f"on {kind} start and finish are uncertain by {unsure:.2g} K:"
        if float(np.std(strain - lines.strain(warm)[0])) > _NO_NOISE * scatter(strain, 1):
            why = "the strain bends where three straight lines do not, as by a transformation in two steps (an R-phase)"
            raise InputError(f"{told} {why}; give the part of the branch in which one step happens")
        raise InputError(f"{told} the transformation is hidden in the noise; load more, or measure with less noise")
    return _measured(warm, strain[None], lines, tangent), away


def _averaged(values: np.ndarray, each: int) -> np.ndarray:
    """Means of ``each`` neighbours among values (n,), of fewer at the end."""
    starts = np.arange(0, len(values), each)
    return np.asarray(np.add.reduceat(values, starts) / np.diff(np.append(starts, len(values))))


def _redrawn(line: np.ndarray, distance: np.ndarray, free: int, rng: np.random.Generator) -> np.ndarray:
    """Distances (draws, n) from a course of ``free`` numbers drawn anew, neighbours erring together as they do: by an autoregression.

    Each of the three ``line``s with rows enough has its own, and its own scatter: noise in the temperatures shows where the strain is steep
    and nowhere else.
    """
    drawn = np.zeros((_DRAWS, len(line)))
    lines = [line == one for one in np.unique(line)]
    for rows, taken in ((np.full(len(line), True), free), *((rows, free / 3) for rows in lines if np.sum(rows) >= _POOL)):
        one = distance[rows]
        scatter, together = math.sqrt(float(np.mean(one**2))), 2.0 * _together(one) - 1.0
        # So many rows err by themselves, of which the course has taken a number each with them; of how many are left, chi-squares tell.
        alone = max(len(one) / together, taken + _FEWEST_LEFT)
        drawn[:, rows] = (
            _alike(one / max(scatter, 1e-300), taken, rng) * scatter * np.sqrt(alone / rng.chisquare(alone - taken, (_DRAWS, 1)))
        )
    return drawn


def _alike(series: np.ndarray, taken: float, rng: np.random.Generator) -> np.ndarray:
    """Series (draws, n) of the same autoregression as one (n,), from which a course of so many numbers has been ``taken``."""
    own, variance = autoregression(series)
    if np.sum(own) <= 0.0:  # what goes to and fro like this is what the lines leave of noise without memory
        own, variance = np.zeros(0), 1.0
    if float(np.std(series)) < _NO_NOISE * scatter(series, 1):
        own = _slower(own, taken / len(series), 2.0 / len(series))
    burnt = len(series) + 20 * (len(own) + 1)
    pushed = math.sqrt(variance) * rng.standard_normal((_DRAWS, burnt))
    return np.asarray(lfilter([1.0], np.append(1.0, -own), pushed, axis=1))[:, burnt - len(series) :]


def _slower(own: np.ndarray, taken: float, each: float) -> np.ndarray:
    """An autoregression as it was before a course of so many numbers a row was taken from it, ``each`` being 2 over the rows.

    With the course went what is slow, so that neighbours seem to go together less than they do. Of a first-order autoregression r in n rows
    about a mean, r - (1 + 3 r) / n is seen on average (Kendall 1954), about a straight line r - (2 + 4 r) / n, and so on. That is undone of
    the slowest part of any, unless it swings or the rows are too few for such a formula.
    """
    if not len(own) or taken > _TAKEN:
        return own
    parts = np.roots(np.append(1.0, -own))
    slowest = int(np.argmax(np.abs(parts)))
    if abs(parts[slowest].imag) > 0.0 or parts[slowest].real <= 0.0:
        return own
    seen = parts[slowest].real
    parts[slowest] = max(seen, min((seen + taken) / (1.0 - taken - each), _SLOWEST))
    return -np.real(np.poly(parts))[1:]


def _together(distance: np.ndarray) -> float:
    """Rows over which distances (n,) go together, at least 1: the sum of their autocorrelation up to its first zero."""
    away = distance - distance.mean()
    whole = np.correlate(away, away, "full")[len(away) - 1 :]
    shares = whole / max(float(whole[0]), 1e-300)
    return float(np.sum(shares[: int(np.argmax(shares <= 0.0))])) if np.any(shares <= 0.0) else 1.0


def _measured(temperature: np.ndarray, strain: np.ndarray, lines: Lines, tangent: Tangent) -> np.ndarray:
    """Lower and upper corner, the strain between them, and between the coldest and the hottest rows: (draws, 4)."""
    cold, hot = (_plateau(temperature, strain, lines, side) for side in (0, 1))
    low, high = lines.corners.T
    if tangent == "steepest":
        steep = steepest(temperature, strain, lines)
        low, high = steep.meets(cold), steep.meets(hot)
    moved = cold.at(temperature.min(axis=1)) - hot.at(temperature.max(axis=1))
    return np.column_stack([low, high, cold.at(low) - hot.at(high), moved])


def _plateau(temperature: np.ndarray, strain: np.ndarray, lines: Lines, side: int) -> Straight:
    """The line along the farther half of the rows below the lower corner (side 0), or above the upper one.

    The half that is nearer may belong to a transformation that ends slowly. Where the farther one has few rows, the three lines' own tells.
    """
    corner = lines.corners[:, side, None]
    end = temperature.min(axis=1, keepdims=True) if side == 0 else temperature.max(axis=1, keepdims=True)
    taken = np.abs(temperature - end) <= 0.5 * np.abs(corner - end)
    count = np.maximum(taken.sum(axis=1, keepdims=True), 1)
    middle, level = (np.sum(np.where(taken, v, 0.0), axis=1, keepdims=True) / count for v in (temperature, strain))
    away = np.where(taken, temperature - middle, 0.0)
    slope = np.sum(away * strain, axis=1, keepdims=True) / np.maximum(np.sum(away**2, axis=1, keepdims=True), 1e-300)
    found, own = (middle, level, slope), (corner, lines.strain(corner), lines.slopes[:, 2 * side, None])
    return Straight(*(np.where(count >= _BESIDE, a, b)[:, 0] for a, b in zip(found, own, strict=True)))


def _refuse_unseen(temperature: np.ndarray, strain: np.ndarray, lines: Lines, kind: str) -> None:
    low, high = lines.corners[0]
    scatter = math.sqrt(float(lines.squares[0]) / len(strain))
    ends = lines.strain(lines.corners)[0]
    slopes = lines.slopes[0]
    # What the strain moves beyond the plateaus' own slopes.
    jump = float(ends[0] - ends[1]) + 0.5 * float(slopes[0] + slopes[2]) * (high - low)
    lengths = low - float(np.min(temperature)), float(np.max(temperature)) - high
    steep = any(abs(k) > _EXPANSION and abs(k) * far > _SEEN * scatter for k, far in zip((slopes[0], slopes[2]), lengths, strict=True))
    within = int(np.sum((temperature >= low) & (temperature <= high)))
    seen = abs(jump) > _SEEN * scatter + _LEAST
    if steep and (not seen or within < _WITHIN):
        raise InputError(_unreached(kind))
    if not seen:
        told = f"on {kind} the strain moves by {abs(jump):.2g} between lines about which it scatters by {scatter:.2g}"
        raise InputError(f"{told}: no transformation is seen; load more, or heat and cool further")
    if within < _WITHIN:
        told = f"on {kind} {within} row{'' if within == 1 else 's'} lie on the transformation, fewer than {_WITHIN}"
        raise InputError(f"{told}: record more rows per kelvin, or heat and cool further")
    for beside, side, cure in ((temperature < low, "colder", "cool"), (temperature > high, "hotter", "heat")):
        if np.sum(beside) < _BESIDE:
            told = f"on {kind} {np.sum(beside)} rows are {side} than the transformation, fewer than {_BESIDE}"
            raise InputError(f"{told}: heat and cool further ({cure}), or record more rows per kelvin")
    # What both plateaus expand by is in all three slopes; in tension it runs against the transformation, in compression along it.
    expansion = min(max(min(slopes[0], slopes[2]), 0.0), _EXPANSION)
    cold, steepness, hot = np.abs(slopes - expansion)
    if steepness < _STEEPER * max(cold, hot):
        raise InputError(_unreached(kind))


def _unreached(kind: str) -> str:
    return f"on {kind} a line beside the transformation is nearly as steep as it: its end was not reached, heat and cool further"


def mean_of(found: Sequence[Cycle]) -> dict[str, Value]:
    """Means over cycles with 95 % intervals: by the scatter between cycles and Student's t, or, if that is wider, by the cycles' own."""
    count, means = len(found), {}
    for name in found[0].values:
        values = np.array([c.values[name].value for c in found])
        own = np.array([0.5 * (c.values[name].upper95 - c.values[name].lower95) for c in found])
        half = math.sqrt(float(np.mean(own**2)) / count)
        if count > 1:
            half = max(half, float(student.ppf(0.975, count - 1) * np.std(values, ddof=1)) / math.sqrt(count))
        mean = float(values.mean())
        means[name] = Value(mean, mean - half, mean + half)
    return means
