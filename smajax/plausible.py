"""Columns whose numbers cannot be in the unit that the header says: mA given as A, K as degC, a unit that changes half-way down.

A wrong unit ruins a fit without any other sign, and its factor is nearly always a power of 1000. The bounds are those of benches with
shape-memory alloys (units.CHANNELS): currents of 1 mA to 50 A, strokes up to 1 m. A rig beyond them says so (``any_scale``).
"""

from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError
from smajax.units import CHANNELS, channel_of, conversion, from_si, to_si

# An unchanging signal shows the factor itself; a moving one changes somewhat over the row in which its unit changes.
_FACTORS = (1e3, 1e6)
_SLACK = 0.15
# Rows on either side of a jump that must have the same magnitude among themselves, so that noise about zero makes no jump.
_ROWS_ASIDE, _LEAST_ASIDE, _LEVEL = 5, 3, 3.0
_MOST_JUMPS = 1000
_KELVIN_AT_ZERO = 273.15


def check_scale(values: NDArray[np.float64], name: str, unit: str, siblings_peak: float, place: Callable[[int], str], cure: str) -> None:
    """Refuse a column (rows,) of the channel ``name``, in the file's ``unit``, if its scale jumps or is not that of any bench.

    ``siblings_peak`` is the largest magnitude (canonical unit) among all columns of the same kind: where wire 1 carries a current, none
    is needed in wire 2. ``place`` makes "file: row 5, column 'x'" of an index, ``cure`` is where the unit is written, with ``{unit}``.
    """
    kind = channel_of(name) or name
    _refuse_jump(values, kind, unit, place)
    channel = CHANNELS[kind]
    low, high = channel.plausible
    si = to_si(values, unit, channel.unit)
    outside = np.flatnonzero((si < low - 1e-9 * abs(low)) | (si > high + 1e-9 * abs(high)))
    if outside.size:
        bound = low if si[outside[0]] < low else high
        limit = f"{'below' if bound == low else 'above'} {_shown(bound, unit, kind)}"
        what = f"the {kind} of {_text(float(values[outside[0]]), unit)} is {limit}"
        _refuse(place(int(outside[0])), what, _likely_unit(values, kind, unit), name, cure)
    if 0 < siblings_peak < channel.faint:
        row = int(np.argmax(abs(values)))
        if values[row]:
            what = f"the largest {kind}, {_text(values[row], unit)}, is below {_shown(channel.faint, unit, kind)}"
            _refuse(place(row), what, _likely_unit(values, kind, unit), name, cure)
    # A recording that begins at what is room temperature in kelvin and never cools below freezing: in degC no bench is that warm at rest.
    in_celsius = kind in ("temperature", "ambient") and conversion(unit, "degC") == (1, 0)
    if in_celsius and 283.0 <= values[0] <= 308.0 and values.min() >= 270.0 and values.max() < 700.0:
        what = f"a {kind} that starts at {_text(values[0], unit)} and is never below {_text(values.min(), unit)} is not one in degC"
        _refuse(place(0), what, "K", name, cure)


def _refuse(place: str, what: str, likely: str | None, name: str, cure: str) -> None:
    looks = f", and the numbers look like {likely}" if likely else ", beyond what a bench with SMA wires gives"
    advice = f"correct {cure.format(unit=likely)}" if likely else "correct the unit or the value"
    raise InputError(f"{place}: {what}{looks}: {advice}, or, if it is right, give {name} any_scale = true under [channels] in the rig")


def _likely_unit(values: NDArray[np.float64], kind: str, unit: str) -> str | None:
    """The first usual unit of the channel in which all these numbers would be plausible."""
    channel = CHANNELS[kind]
    low, high = channel.plausible
    for other in channel.units:
        si = to_si(values, other, channel.unit)
        right = low <= si.min() and si.max() <= high and max(-si.min(), si.max()) >= channel.faint
        if right and conversion(other, channel.unit) != conversion(unit, channel.unit):
            return other
    return None


def _shown(bound: float, unit: str, kind: str) -> str:
    return _text(from_si(bound, unit, CHANNELS[kind].unit), unit)


def _text(value: float, unit: str) -> str:
    return f"{value:.6g}" if unit == "1" else f"{value:.6g} {unit}"


def _refuse_jump(values: NDArray[np.float64], kind: str, unit: str, place: Callable[[int], str]) -> None:
    """A step by a factor of 1000 between two quiet stretches, or by 273.15 in a temperature."""
    before, after = values[:-1], values[1:]
    for factor in (*_FACTORS, *(1 / factor for factor in _FACTORS)):
        scaled = before * factor
        for row in np.flatnonzero((abs(after - scaled) < _SLACK * abs(scaled)) & (scaled != 0))[:_MOST_JUMPS] + 1:
            if _unit_changes(values, int(row), factor, kind, unit):
                raise InputError(
                    f"{place(int(row))}: the scale of {kind} jumps by a factor of {max(factor, 1 / factor):.0f} from {values[row - 1]:.6g} "
                    f"to {_text(float(values[row]), unit)}, as if the unit changed: write all rows in one unit"
                )
    if kind in ("temperature", "ambient") and conversion(unit, "degC")[0] == 1:
        steps = np.diff(values)
        for row in np.flatnonzero(abs(abs(steps) - _KELVIN_AT_ZERO) < 3.0)[:_MOST_JUMPS] + 1:
            aside = values[max(row - _ROWS_ASIDE, 0) : row], values[row : row + _ROWS_ASIDE]
            if min(map(len, aside)) >= _LEAST_ASIDE and abs(abs(np.median(aside[1]) - np.median(aside[0])) - _KELVIN_AT_ZERO) < 15.0:
                raise InputError(
                    f"{place(int(row))}: the {kind} jumps by 273.15 from {values[row - 1]:.6g} to {values[row]:.6g} {unit}, "
                    "as if degC and K were mixed: write all rows in one unit"
                )


def _unit_changes(values: NDArray[np.float64], row: int, factor: float, kind: str, unit: str) -> bool:
    """Whether the jump by ``factor`` at ``row`` parts two stretches of the same signal."""
    channel = CHANNELS[kind]
    earlier, later = abs(values[max(row - _ROWS_ASIDE, 0) : row]), abs(values[row : row + _ROWS_ASIDE])
    if min(len(earlier), len(later)) < _LEAST_ASIDE or any(side.max() > _LEVEL * side.min() for side in (earlier, later)):
        return False
    if kind == "time":  # steps are another factor apart too, unless the clock just paused
        return bool(1 / _LEVEL < np.ptp(later) / (np.ptp(earlier) * factor) < _LEVEL)
    largest = to_si(max(earlier.max(), later.max()), unit, channel.unit)
    return not channel.commanded or bool(largest > channel.usual)
