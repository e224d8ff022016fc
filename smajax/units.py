"""Conversion of quantities as text (``"0.15 mm"``) and of columns with units (``current [mA]``) to and from SI floats.

Inside smajax everything is SI, except that temperatures are degC (their differences K). The internal unit of a quantity
is named by its *canonical* text: ``"m"``, ``"Pa"``, ``"rad"``, ``"1"`` for a fraction, ``"degC"`` for a temperature,
``"K"`` for a difference.

Units are parsed by ``smajax.unit_parser``. Factors are exact fractions, so that ``"0.15 mm"`` is the float nearest to
0.00015 and every float can be written and read back without loss.
"""

import re
from collections.abc import Sequence
from decimal import Context, Decimal
from fractions import Fraction
from functools import lru_cache
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from smajax.channels import CHANNELS
from smajax.errors import InputError, suggestion
from smajax.unit_parser import CACHED_UNITS, MAX_LENGTH, UnitScale, UnknownUnitError, parse_unit, same_kind, unit_names

Numbers = TypeVar("Numbers", float, NDArray[np.float64])

# Example of a quantity by its internal unit; its unit is also the one in which such quantities are shown.
_EXAMPLES = {
    "1": "4.1 %",
    "m": "0.15 mm",
    "kg": "0.2 kg",
    "s": "20 ms",
    "A": "0.3 A",
    "V": "5 V",
    "W": "2 W",
    "N": "9.81 N",
    "N m": "0.02 N m",
    "N/m": "0.5 N/mm",
    "Pa": "35 MPa",
    "Pa/K": "6.7 MPa/K",
    "rad": "20 deg",
    "rad/s": "10 deg/s",
    "degC": "20 degC",
    "K": "5 K",
    "1/K": "10e-6 1/K",
    "ohm": "8 ohm",
    "ohm m": "80 uohm cm",
    "W/m^2/K": "100 W/m^2/K",
    "W/m^2/K^3": "0.001 W/m^2/K^3",
    "J/m^3/K": "2.0 MJ/m^3/K",
    "J/m^3": "156 MJ/m^3",
    "kg m^2": "1e-6 kg m^2",
    "Hz": "50 Hz",
    "m/s": "2 mm/s",
    "m/s^2": "9.81 m/s^2",
}
# Names with which a misspelt unit is compared first; pint's other names are tried only if none of these is similar.
_COMMON_UNITS = [unit for channel in CHANNELS.values() for unit in channel.units if " " not in unit]
_COMMON_UNITS += ["kg", "g", "cm", "us", "h", "Hz", "J"]
# Frequent misspellings that pint does not know, or knows as another unit, with the right name; only for suggestions.
_MISSPELLINGS = {
    "C": "degC",
    "F": "degF",
    "Celsius": "degC",
    "Kelvin": "K",
    "Amp": "A",
    "Amps": "A",
    "Volt": "V",
    "Watt": "W",
    "Ohm": "ohm",
}
# Masses that are often written for their weights, as on a spring balance, with the unit of the weight.
_WEIGHTS = {"g": "gf", "gram": "gf", "grams": "gf", "gr": "gf", "kg": "kgf", "mg": "mgf", "lb": "lbf", "oz": "ozf"}
_MASSES = {"gf": "g", "kgf": "kg", "mgf": "mg", "lbf": "lb", "ozf": "oz"}
_UNIT_NAME = re.compile(r"[A-Za-z]+", re.ASCII)
# Most digits that are tried when a float is written: the longest text minus room for the unit.
_MAX_DIGITS = MAX_LENGTH - 21
# Magnitudes from this one ...
_PLAIN_FROM = 1e-5
# ... to below this one are written without an exponent.
_PLAIN_BELOW = 1e7
# Number of floats that ``from_si`` tries on either side, so that ``to_si`` returns the original value: rounding errors
# are a few spacings of floats. tests/unit/test_units.py (random columns in all units) holds the number.
_NEIGHBOURS = 12
# All integers up to this one are floats; larger factors are converted to the nearest float.
_EXACT_BELOW = 2**53
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_MINUS = "\N{MINUS SIGN}"
_ZERO_CELSIUS = Fraction("273.15")


def to_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """Convert a value to its internal unit.

    Args:
        value: A float or an array of any shape in ``unit``.
        unit: Unit as a user writes it.
        canonical: Internal unit.

    Returns:
        The value in the internal unit, of the same type and shape.

    Raises:
        InputError: The unit is unknown or does not convert to ``canonical``.
    """
    factor, offset = conversion(unit, canonical)
    return _affine(value, factor, offset)


def from_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """Convert a value from its internal unit, so that ``to_si`` converts it back to the same float wherever possible.

    Args:
        value: A float or an array of any shape in the internal unit.
        unit: Unit of the result.
        canonical: Internal unit.

    Returns:
        The value in ``unit``, of the same type and shape.

    Raises:
        InputError: The unit is unknown or does not convert to ``canonical``.
    """
    factor, offset = conversion(unit, canonical)
    target = np.asarray(value, float)
    rounded = np.array(_affine(target, 1 / factor, -offset / factor), ndmin=1)
    best, target = rounded.copy(), target.reshape(rounded.shape)
    wrong = np.flatnonzero(_affine(best, factor, offset) != target)
    # The spacing of floats is that of the result or, where an offset cancels, that of the much coarser value.
    value_spacing = np.spacing(abs(target.flat[wrong])) / float(factor)
    spacing = np.maximum(np.spacing(abs(rounded.flat[wrong])), 0.25 * value_spacing)
    for steps in sorted(range(-_NEIGHBOURS, _NEIGHBOURS + 1), key=abs):
        trial = rounded.flat[wrong] + steps * spacing
        exact = _affine(trial, factor, offset) == target.flat[wrong]
        best.flat[wrong[exact]] = trial[exact]
        wrong, spacing = wrong[~exact], spacing[~exact]
    return cast(Numbers, best.reshape(value.shape) if isinstance(value, np.ndarray) else float(best[0]))


def parse_quantity(text: str | float, canonical: str) -> float:
    """Parse a quantity such as ``"0.15 mm"``, ``"80 uohm cm"`` or ``"4.1 %"`` into a float in the internal unit.

    Args:
        text: Number and unit; a number without unit is accepted for fractions (canonical ``"1"``) only.
        canonical: Internal unit.

    Returns:
        The value in the internal unit.

    Raises:
        InputError: The text is not one number with a unit of this kind; the caller adds file and key.
    """
    example = f"write it like '{example_of(canonical)}'"
    if isinstance(text, bool) or not isinstance(text, str | int | float):
        raise InputError(f"{text!r} is not a quantity: {example}")
    text = repr(text) if isinstance(text, int | float) else text.strip()
    number, unit = _split_quantity(text, canonical, example)
    try:
        factor, offset = conversion(unit or "1", canonical)
    except InputError as error:
        raise InputError(f"'{text.replace(_MINUS, '-')}': {error}") from None
    try:
        return float(Fraction(number) * factor + offset)
    except OverflowError:
        raise InputError(f"'{text.replace(_MINUS, '-')}' is too large for a number: {example}") from None


def _split_quantity(text: str, canonical: str, example: str) -> tuple[str, str]:
    """Split a quantity into number and unit; raise ``InputError`` where it is not one number with one unit."""
    if len(text) > MAX_LENGTH:
        raise InputError(f"a quantity of {len(text)} characters ('{text[:12]}...') is too long: {example}")
    text = text.replace(_MINUS, "-")
    number = _NUMBER.match(text)
    if number is None:
        raise InputError(f"'{text}' does not begin with a number: {example}")
    unit = text[number.end() :].strip()
    if re.match(r",\d", unit, re.ASCII):
        raise InputError(f"'{text}' has a decimal comma: {example}, with a point")
    if re.match(r"[\d.]", unit.replace("1/", "/", 1), re.ASCII) and unit != "1":
        raise InputError(f"'{text}' is not one number with one unit: {example}")
    if not unit and canonical != "1":
        raise InputError(f"'{text}' has no unit, and {canonical} is expected: {example}")
    return number.group(), unit


def unit_of(text: str | float) -> str:
    """Return the unit in which a quantity is written: ``"mm"`` of ``"5 mm"``, ``"1"`` of a number without unit."""
    number = _NUMBER.match(str(text).strip().replace(_MINUS, "-"))
    return (str(text).strip()[number.end() :].strip() if number else "") or "1"


def format_quantity(value_si: float, unit: str, canonical: str | None = None) -> str:
    """Format a quantity as the shortest text, such as ``"0.15 mm"``, that is parsed to exactly the same float.

    Temperatures within 1e-15 K of zero in another scale are an exception: they need more digits than a quantity may
    have.

    Args:
        value_si: A finite value in the internal unit.
        unit: Unit of the text.
        canonical: Internal unit. By default the SI unit of the same kind: degC for temperatures in degC or degF; K is
            a difference.

    Returns:
        Number and unit; the number alone for a fraction.

    Raises:
        InputError: The unit is unknown or does not convert to ``canonical``.
    """
    factor, offset = conversion(unit, canonical) if canonical is not None else _to_own_si(unit)
    exact = (Fraction(value_si) - offset) / factor
    if exact == 0:
        number = "-0" if np.signbit(value_si) else "0"
    else:
        parts = Decimal(exact.numerator), Decimal(exact.denominator)
        rounded = [Context(digits).divide(*parts) for digits in range(1, _MAX_DIGITS + 1)]
        same = (digits for digits in rounded if float(Fraction(digits) * factor + offset) == value_si)
        shortest = next(same, rounded[-1])
        plain = _PLAIN_FROM <= abs(exact) < _PLAIN_BELOW
        number = f"{shortest:f}" if plain else f"{shortest.normalize():e}".replace("e+", "e")
    return number if unit in ("", "1") else f"{number} {unit}"


def as_text(value: float, unit: str) -> str:
    """Format a value as a quantity in the unit in which it is shown; parsed again it is the same float.

    Args:
        value: A finite value in the internal unit.
        unit: Internal unit.
    """
    return format_quantity(value, display_unit(unit), unit)


def display_unit(unit: str) -> str:
    """Return the unit in which quantities of an internal unit are shown: mm for m, MPa for Pa."""
    return "1" if unit == "1" else example_of(unit).split(maxsplit=1)[1]


def example_of(canonical: str) -> str:
    """Return a quantity of the canonical unit's kind, as a user would write it."""
    return _EXAMPLES.get(canonical, f"1 {canonical}")


def base_units(unit: str) -> tuple[float, float, dict[str, int]]:
    """Return the conversion of a unit to SI base units.

    Args:
        unit: Unit as a user writes it.

    Returns:
        Factor and offset, so that factor x value + offset is in base units, and the powers of these by name.

    Raises:
        InputError: The unit is unknown.
    """
    scale = parse_unit(unit)
    return float(scale.factor), float(scale.offset), {base: int(power) for base, power in scale.dimension}


@lru_cache(maxsize=CACHED_UNITS)
def conversion(unit: str, canonical: str) -> tuple[Fraction, Fraction]:
    """Return the exact factor and offset of a conversion.

    Args:
        unit: Unit as a user writes it.
        canonical: Internal unit.

    Returns:
        Factor and offset, so that factor x value + offset is in the internal unit.

    Raises:
        InputError: The unit is unknown or of another kind.
    """
    target = parse_unit(canonical)
    try:
        scale = parse_unit(unit)
    except UnknownUnitError as unknown:
        whole = unknown.name == unit
        candidates = [common for common in _COMMON_UNITS if whole and same_kind(parse_unit(common), target)]
        name = f"'{unknown.name}' is not known{_unit_suggestion(unknown.name, candidates)}"
        raise InputError(f"the unit {name}: write one as in '{example_of(canonical)}'") from None
    absolute = canonical == "degC"
    if not same_kind(scale, target) or (absolute and scale.dimension != target.dimension):
        close = _MISSPELLINGS.get(unit) if absolute else _other_kind(unit, target)
        hint = f" (did you mean '{close}'?)" if close else ""
        what = "a fraction or '%'" if canonical == "1" else f"a unit that converts to {canonical}"
        raise InputError(f"the unit '{unit}' does not fit{hint}: {what} is expected, as in '{example_of(canonical)}'")
    return scale.factor / target.factor, scale.offset - _ZERO_CELSIUS if absolute else Fraction(0)


def _other_kind(unit: str, target: UnitScale) -> str | None:
    """Return a unit with the weights of its masses, or the masses of its weights, if it is of the target's kind."""
    for names in (_WEIGHTS, _MASSES):
        other = _UNIT_NAME.sub(lambda word, names=names: names.get(word.group(), word.group()), unit)
        if other != unit and same_kind(parse_unit(other), target):
            return other
    return None


def _to_own_si(unit: str) -> tuple[Fraction, Fraction]:
    scale = parse_unit(unit)
    return scale.factor, scale.offset - _ZERO_CELSIUS if scale.offset else Fraction(0)


def _affine(value: Any, factor: Fraction, offset: Fraction) -> Any:
    """Return factor x value + offset with as few roundings as possible: 0.001 x is computed as x / 1000."""
    top, bottom = factor.numerator, factor.denominator
    if max(top, bottom) > _EXACT_BELOW:
        value = value * float(factor)
    else:
        value = value * float(top) if top != 1 else value
        value = value / float(bottom) if bottom != 1 else value
    return value + float(offset) if offset else value


def _unit_suggestion(name: str, candidates: Sequence[str]) -> str:
    """Return the suggestion for an unknown unit: first among the candidates of the right kind, then among all."""
    if name in _MISSPELLINGS:
        return f" (did you mean '{_MISSPELLINGS[name]}'?)"
    names = [other for other in unit_names() if other != name]
    return suggestion(name, candidates) or suggestion(name, _COMMON_UNITS) or suggestion(name, names)
