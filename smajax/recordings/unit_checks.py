"""Checks of units: columns whose numbers cannot be in the unit of the header.

Examples are mA labelled as A, K labelled as degC, and a unit that changes in the middle of a column. A wrong unit ruins
a fit without any other symptom, and its factor is nearly always a power of 1000. The plausible ranges are those of test
rigs with shape-memory alloys (``channels.CHANNELS``): currents of 1 mA to 50 A, strokes up to 1 m. ``any_scale`` turns
the check off for a channel.
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from smajax.channels import CHANNELS, channel_of
from smajax.errors import InputError
from smajax.units import conversion, from_si, to_si

# The constants below were chosen by trial; they are tested in tests/unit/recordings/test_bad_recordings.py.

# Factors between units that are often confused: one or two steps of the SI prefixes.
_UNIT_FACTORS = (1e3, 1e6)
# Relative deviation from such a factor: a constant signal has the exact factor, any other also changes between the two
# rows.
_FACTOR_TOLERANCE = 0.15
# Rows on either side of a jump that are compared, so that noise about zero does not count as a jump.
_ROWS_ASIDE = 5
# Smallest number of rows on either side.
_MIN_ROWS_ASIDE = 3
# Ratio of the largest to the smallest magnitude up to which the rows on one side count as one level.
_LEVEL_RATIO = 3.0
# Jumps that are examined in one column, which limits the time spent on noise.
_MAX_JUMPS = 1000
# Difference between the same temperature in K and in degC.
_KELVIN_AT_ZERO = 273.15
# Deviation in K from this difference, of one row to the next and of the medians on either side.
_KELVIN_JUMP_TOLERANCE = 3.0
_KELVIN_MEDIAN_TOLERANCE = 15.0
# Range of room temperature in K: a recording in degC does not begin there.
_ROOM_KELVIN_FROM = 283.0
_ROOM_KELVIN_TO = 308.0
# Lowest and highest values of a recording that counts as one in K: not below freezing, in the range of a wire.
_LOWEST_KELVIN = 270.0
_HIGHEST_KELVIN = 700.0
# Relative tolerance of the bounds of the plausible range, for rounding in the conversion.
BOUND_ROUNDING = 1e-9


def check_scale(
    values: NDArray[np.float64],
    name: str,
    unit: str,
    siblings_peak: float,
    place: Callable[[int], str],
    unit_place: str,
) -> None:
    """Check that the scale of a column does not jump, and that its values are plausible.

    Args:
        values: Numbers, shape ``(rows,)``, in the unit of the file.
        name: Name of the channel.
        unit: Unit in the file.
        siblings_peak: Largest magnitude, in the internal unit, in all columns of the same kind of channel: if wire 1
            carries a current, that in wire 2 may be zero.
        place: Returns a text such as "file: row 5, column 'x'" for an index.
        unit_place: Where to correct the unit, with ``{unit}`` for the likely one, such as "the header to ..."; empty
            where the numbers are scaled by the rig, so that a unit is not what is wrong.

    Raises:
        InputError: If they are not; the message names place, likely unit and cure.
    """
    kind = channel_of(name) or name
    _refuse_factor_jump(values, kind, unit, place)
    _refuse_kelvin_jump(values, kind, unit, place)
    channel = CHANNELS[kind]
    low, high = channel.plausible_range
    si = to_si(values, unit, channel.unit)
    outside = np.flatnonzero((si < low - BOUND_ROUNDING * abs(low)) | (si > high + BOUND_ROUNDING * abs(high)))
    if outside.size:
        bound = low if si[outside[0]] < low else high
        limit = f"{'below' if bound == low else 'above'} {_bound_text(bound, unit, kind)}"
        problem = f"the {kind} of {_text(float(values[outside[0]]), unit)} is {limit}"
        _refuse(place(int(outside[0])), problem, _likely_unit(values, kind, unit), name, unit_place)
    if 0 < siblings_peak < channel.faint:
        row = int(np.argmax(abs(values)))
        if values[row]:
            peak = f"the largest {kind}, {_text(values[row], unit)}"
            problem = f"{peak}, is below {_bound_text(channel.faint, unit, kind)}"
            _refuse(place(row), problem, _likely_unit(values, kind, unit), name, unit_place)
    if kind in ("temperature", "ambient") and conversion(unit, "degC") == (1, 0) and looks_like_kelvin(values):
        start = f"a {kind} that starts at {_text(values[0], unit)} and is never below {_text(values.min(), unit)}"
        _refuse(place(0), f"{start} is not one in degC", "K", name, unit_place)


def looks_like_kelvin(values: NDArray[np.float64]) -> bool:
    """Return whether temperatures begin at room temperature in K and stay above freezing, unlike any in degC.

    Args:
        values: Temperatures, shape ``(rows,)``.
    """
    at_room = _ROOM_KELVIN_FROM <= values[0] <= _ROOM_KELVIN_TO
    return bool(at_room and values.min() >= _LOWEST_KELVIN and values.max() < _HIGHEST_KELVIN)


def _refuse(place: str, problem: str, likely: str | None, name: str, unit_place: str) -> None:
    if not unit_place:
        scale = f"correct factor, offset or full_scale of {name} under [channels]"
        exception = f", or, if it is right, give {name} any_scale = true there"
        raise InputError(f"{place}: {problem}: {scale}{exception}", code="implausible", cure=exception)
    looks = f", and the numbers look like {likely}" if likely else ", outside the range of rigs with SMA wires"
    advice = f"correct {unit_place.format(unit=likely)}" if likely else "correct the unit or the value"
    exception = f", or, if it is right, give {name} any_scale = true under [channels] in the rig"
    raise InputError(f"{place}: {problem}{looks}: {advice}{exception}", code="implausible", cure=exception)


def _likely_unit(values: NDArray[np.float64], kind: str, unit: str) -> str | None:
    """Return the first of the channel's usual units in which all numbers are plausible, or ``None``."""
    channel = CHANNELS[kind]
    low, high = channel.plausible_range
    for other in channel.units:
        si = to_si(values, other, channel.unit)
        is_plausible = low <= si.min() and si.max() <= high and max(-si.min(), si.max()) >= channel.faint
        if is_plausible and conversion(other, channel.unit) != conversion(unit, channel.unit):
            return other
    return None


def _bound_text(bound: float, unit: str, kind: str) -> str:
    return _text(from_si(bound, unit, CHANNELS[kind].unit), unit)


def _text(value: float, unit: str) -> str:
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _refuse_factor_jump(values: NDArray[np.float64], kind: str, unit: str, place: Callable[[int], str]) -> None:
    """Refuse a step by a factor of 1000 or 1e6 between two parts of constant level."""
    before, after = values[:-1], values[1:]
    for factor in (*_UNIT_FACTORS, *(1 / factor for factor in _UNIT_FACTORS)):
        scaled = before * factor
        jumps = (abs(after - scaled) < _FACTOR_TOLERANCE * abs(scaled)) & (scaled != 0)
        for row in np.flatnonzero(jumps)[:_MAX_JUMPS] + 1:
            if _unit_changes(values, int(row), factor, kind, unit):
                jump = f"the scale of {kind} jumps by a factor of {max(factor, 1 / factor):.0f}"
                ends = f"from {values[row - 1]:.6g} to {_text(float(values[row]), unit)}"
                raise InputError(
                    f"{place(int(row))}: {jump} {ends}, as if the unit changed: write all rows in one unit"
                )


def _refuse_kelvin_jump(values: NDArray[np.float64], kind: str, unit: str, place: Callable[[int], str]) -> None:
    """Refuse a step by 273.15 in a temperature."""
    if kind not in ("temperature", "ambient") or conversion(unit, "degC")[0] != 1:
        return
    jumps = abs(abs(np.diff(values)) - _KELVIN_AT_ZERO) < _KELVIN_JUMP_TOLERANCE
    for row in np.flatnonzero(jumps)[:_MAX_JUMPS] + 1:
        earlier, later = values[max(row - _ROWS_ASIDE, 0) : row], values[row : row + _ROWS_ASIDE]
        if min(len(earlier), len(later)) < _MIN_ROWS_ASIDE:
            continue
        if abs(abs(np.median(later) - np.median(earlier)) - _KELVIN_AT_ZERO) < _KELVIN_MEDIAN_TOLERANCE:
            jump = f"the {kind} jumps by 273.15 from {values[row - 1]:.6g} to {values[row]:.6g} {unit}"
            raise InputError(f"{place(int(row))}: {jump}, as if degC and K were mixed: write all rows in one unit")


def _unit_changes(values: NDArray[np.float64], row: int, factor: float, kind: str, unit: str) -> bool:
    """Return whether the jump by ``factor`` at ``row`` separates two parts of the same signal."""
    channel = CHANNELS[kind]
    earlier, later = abs(values[max(row - _ROWS_ASIDE, 0) : row]), abs(values[row : row + _ROWS_ASIDE])
    is_short = min(len(earlier), len(later)) < _MIN_ROWS_ASIDE
    if is_short or any(side.max() > _LEVEL_RATIO * side.min() for side in (earlier, later)):
        return False
    if kind == "time":  # the steps also differ by the factor, unless the clock only paused
        return bool(1 / _LEVEL_RATIO < np.ptp(later) / (np.ptp(earlier) * factor) < _LEVEL_RATIO)
    largest = to_si(max(earlier.max(), later.max()), unit, channel.unit)
    return not channel.commanded or bool(largest > channel.usual)
