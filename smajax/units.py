"""Conversion of quantities as text (``"0.15 mm"``) and of columns with units (``current [mA]``) to and from SI floats.

Inside smajax everything is SI, except that temperatures are degC (their differences K). The internal unit of a quantity
is named by its *canonical* text: ``"m"``, ``"Pa"``, ``"rad"``, ``"1"`` for a fraction, ``"degC"`` for a temperature,
``"K"`` for a difference.

What a user writes is never evaluated. A small grammar (names, ``* / ^``, whole exponents, brackets) parses the text,
and pint is asked about single names only. Factors are exact fractions, so that ``"0.15 mm"`` is the float nearest to
0.00015 and every float can be written and read back without loss. pint is loaded at the first conversion, not at
import.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from fractions import Fraction
from functools import cache, lru_cache
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from smajax.channels import CHANNELS
from smajax.errors import InputError, suggestion

Numbers = TypeVar("Numbers", float, NDArray[np.float64])

# How a quantity is written by users, by its internal unit; also the unit in which it is shown.
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
    "kg m^2": "1e-6 kg m^2",
    "Hz": "50 Hz",
    "m/s": "2 mm/s",
    "m/s^2": "9.81 m/s^2",
}
# Names that a misspelt unit is compared with first; the rest of pint's thousand names only if none of these is similar.
_COMMON_UNITS = [unit for channel in CHANNELS.values() for unit in channel.units if " " not in unit]
_COMMON_UNITS += ["kg", "g", "cm", "us", "h", "Hz", "J"]
# Names that pint reads as something that is never meant on a bench: number-metres, attometres per second.
_ALIASES = {
    "Nm": "N m",
    "mNm": "mN m",
    "uNm": "uN m",
    "Nmm": "N mm",
    "Ncm": "N cm",
    "amps": "A",
    "℃": "degC",
    "℉": "degF",
}
# Frequent wrong spellings that pint does not know, or knows as another unit, and what is meant; used for suggestions
# only.
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
# Longest text of a quantity or unit: bounds the work for hostile input. Above any unit with the digits of a float.
_MAX_LENGTH = 60
# Digits that are tried when a float is written: the longest text less room for the unit.
_MAX_DIGITS = _MAX_LENGTH - 21
# Magnitudes that are written without an exponent.
_PLAIN_FROM = 1e-5
_PLAIN_BELOW = 1e7
# Floats that ``from_si`` tries on either side, so that ``to_si`` returns the original value. Rounding
# leads a few places away; tests/unit/test_units.py (random columns in all units) holds the number.
_NEIGHBOURS = 12
# Largest whole number up to which all are floats: larger factors are converted to the nearest float.
_EXACT_BELOW = 2**53
_CACHED_UNITS = 4096
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_TOKEN = re.compile(
    r"\s*(?:(?P<name>[A-Za-zµμεΩΩ°℃℉_]+|[%‰])|(?P<power>\^|\*\*)\s*(?P<exponent>[+-]?\d)|(?P<sign>[*/()·1]))", re.ASCII
)
_MINUS = "\N{MINUS SIGN}"
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_ZERO_CELSIUS = Fraction("273.15")
_ANGLE = (("radian", Fraction(1)),)


@dataclass(frozen=True)
class _Scale:
    """A unit: ``factor`` times base units with the powers ``dimension``; a thermometer's zero is at ``offset`` K."""

    factor: Fraction
    dimension: tuple[tuple[str, Fraction], ...]
    offset: Fraction = Fraction(0)


class _UnknownUnit(InputError):
    """A name that pint does not know."""

    def __init__(self, name: str):
        examples = "'mm', 'mA', 'MPa', 'degC' or 'W/m^2/K'"
        super().__init__(f"the unit '{name}' is not known: units are written like {examples}")
        self.name = name


def to_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """Convert a value to its internal unit.

    Args:
        value: A float or an array of any shape in ``unit``.
        unit: Unit as a user writes it.
        canonical: Internal unit.

    Raises:
        InputError: if the two units do not convert.
    """
    factor, offset = conversion(unit, canonical)
    return _affine(value, factor, offset)


def from_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """Convert a value from its internal unit, so that ``to_si`` converts it back to the same float wherever possible.

    Args:
        value: A float or an array of any shape in the internal unit.
        unit: Unit of the result.
        canonical: Internal unit.

    Raises:
        InputError: if the two units do not convert.
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
        text: Number and unit; a bare number is a fraction (canonical ``"1"``) and nothing else.
        canonical: Internal unit.

    Raises:
        InputError: with the cure; the caller adds file and key.
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
    """Split a quantity into number and unit; refuse what is not one number with one unit."""
    if len(text) > _MAX_LENGTH:
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
    """Return the unit in which a quantity is written: ``"mm"`` of ``"5 mm"``, ``"1"`` of a bare number."""
    number = _NUMBER.match(str(text).strip().replace(_MINUS, "-"))
    return (str(text).strip()[number.end() :].strip() if number else "") or "1"


def format_quantity(value_si: float, unit: str, canonical: str | None = None) -> str:
    """Format a quantity as the shortest text, such as ``"0.15 mm"``, that is parsed to exactly the same float.

    Temperatures within 1e-15 K of zero in another scale are the exception: these take more digits than a quantity has.

    Args:
        value_si: A finite value in the internal unit.
        unit: Unit of the text.
        canonical: Internal unit. By default the SI unit of the same kind: a temperature (degC, degF) is taken in degC,
            and K is taken as a difference.
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
    """Format a value in an internal unit as a user would write it; read back it is the same float."""
    return format_quantity(value, display_unit(unit), unit)


def display_unit(unit: str) -> str:
    """Return the unit in which quantities of an internal unit are shown: mm for m, MPa for Pa."""
    return "1" if unit == "1" else example_of(unit).split(maxsplit=1)[1]


def example_of(canonical: str) -> str:
    """Return a quantity of the canonical unit's kind, as a user would write it."""
    return _EXAMPLES.get(canonical, f"1 {canonical}")


def base_units(unit: str) -> tuple[float, float, dict[str, int]]:
    """Return ``(factor, offset, powers)``: factor x value + offset is in SI base units with these powers."""
    scale = _parse_unit(unit)
    return float(scale.factor), float(scale.offset), {base: int(power) for base, power in scale.dimension}


@lru_cache(maxsize=_CACHED_UNITS)
def conversion(unit: str, canonical: str) -> tuple[Fraction, Fraction]:
    """Return the exact ``(factor, offset)`` with canonical = factor x value + offset.

    Raises:
        InputError: for an unknown unit or one of another kind.
    """
    target = _parse_unit(canonical)
    try:
        scale = _parse_unit(unit)
    except _UnknownUnit as unknown:
        whole = unknown.name == unit
        alike = [common for common in _COMMON_UNITS if whole and _same_kind(_parse_unit(common), target)]
        name = f"'{unknown.name}' is not known{_unit_suggestion(unknown.name, alike)}"
        raise InputError(f"the unit {name}: write one as in '{example_of(canonical)}'") from None
    absolute = canonical == "degC"
    if not _same_kind(scale, target) or (absolute and scale.dimension != target.dimension):
        hint = f" (did you mean '{_MISSPELLINGS[unit]}'?)" if absolute and unit in _MISSPELLINGS else ""
        what = "a fraction or '%'" if canonical == "1" else f"a unit that converts to {canonical}"
        raise InputError(f"the unit '{unit}' does not fit{hint}: {what} is expected, as in '{example_of(canonical)}'")
    return scale.factor / target.factor, scale.offset - _ZERO_CELSIUS if absolute else Fraction(0)


def _to_own_si(unit: str) -> tuple[Fraction, Fraction]:
    scale = _parse_unit(unit)
    return scale.factor, scale.offset - _ZERO_CELSIUS if scale.offset else Fraction(0)


def _same_kind(a: _Scale, b: _Scale) -> bool:
    """Whether dimensions are equal; rad is optional in a product (``N m/rad``), but an angle is not a fraction."""
    if {a.dimension, b.dimension} == {(), _ANGLE}:
        return False
    return [d for d in a.dimension if d[0] != "radian"] == [d for d in b.dimension if d[0] != "radian"]


def _affine(value: Any, factor: Fraction, offset: Fraction) -> Any:
    """Return factor x value + offset, with as few roundings as floats allow: 0.001 x is x / 1000."""
    top, bottom = factor.numerator, factor.denominator
    if max(top, bottom) > _EXACT_BELOW:
        value = value * float(factor)
    else:
        value = value * float(top) if top != 1 else value
        value = value / float(bottom) if bottom != 1 else value
    return value + float(offset) if offset else value


@lru_cache(maxsize=_CACHED_UNITS)
def _parse_unit(unit: str) -> _Scale:
    """Parse the text of a unit: products and quotients from left to right, powers first."""
    if len(unit) > _MAX_LENGTH:
        long = f"a unit of {len(unit)} characters ('{unit[:12]}...') is too long"
        raise InputError(f"{long}: write it like 'mm' or 'W/m^2/K'")
    text = re.sub(r"(?:\bdeg|°) ([CF])$", r"deg\1", unit.strip().replace("º", "°"))
    text = re.sub("[⁻⁰¹²³⁴-⁹]+", lambda match: "^" + match.group().translate(_SUPERSCRIPT), text)
    if text in _ALIASES or re.fullmatch(r"[^\W\d]+|°[CF]|1", text):
        return _parse_unit(_ALIASES[text]) if text in _ALIASES else _unit_of_name(text)
    tokens, end = [], 0
    while end < len(text):
        token = _TOKEN.match(text, end)
        if token is None or token.end() == end:
            where = f"'{unit}' is not understood at '{text[end:].strip()}'"
            raise InputError(f"the unit {where}: write it like 'mm', 'N m' or 'W/m^2/K'")
        tokens.append(token)
        end = token.end()
    scale, remaining_tokens = _parse_product(tokens, unit)
    if remaining_tokens:
        raise InputError(f"the unit '{unit}' has a bracket that was never opened: write it like 'W/(m^2 K)'")
    return scale


def _parse_product(tokens: list[re.Match[str]], unit: str) -> tuple[_Scale, list[re.Match[str]]]:
    """Parse the product at the beginning of the tokens, up to a closing bracket; return it with the tokens after it."""
    total, sign = _Scale(Fraction(1), ()), 1
    malformed = InputError(f"the unit '{unit}' is incomplete: write it like 'mm', 'N m' or 'W/m^2/K'")
    operand_due = True
    while tokens and tokens[0]["sign"] != ")":
        token, tokens = tokens[0], tokens[1:]
        if token["sign"] in ("*", "·", "/"):
            if operand_due and (token["sign"] != "/" or total.dimension):
                raise malformed
            sign, operand_due = (-1 if token["sign"] == "/" else 1), True
            continue
        if token["power"]:
            raise malformed
        if token["sign"] == "(":
            factor, tokens = _parse_product(tokens, unit)
            if not tokens:
                raise InputError(f"the unit '{unit}' has a bracket that is never closed: write it like 'W/(m^2 K)'")
            tokens = tokens[1:]
        else:
            name = token["name"] or "1"
            factor = _parse_unit(_ALIASES[name]) if name in _ALIASES else _unit_of_name(name)
        exponent = 1
        if tokens and tokens[0]["power"]:
            exponent, tokens = int(tokens[0]["exponent"]), tokens[1:]
        total, sign, operand_due = _times(total, factor, sign * exponent), 1, False
    if operand_due:
        raise malformed
    return total, tokens


def _times(a: _Scale, b: _Scale, exponent: int) -> _Scale:
    powers = dict(a.dimension)
    for base, power in b.dimension:
        powers[base] = powers.get(base, Fraction(0)) + power * exponent
    dimension = tuple(sorted((base, power) for base, power in powers.items() if power))
    return _Scale(a.factor * b.factor**exponent, dimension)


@lru_cache(maxsize=_CACHED_UNITS)
def _unit_of_name(name: str) -> _Scale:
    """Return the unit of a single name (``mm``, ``uohm``, ``degC``), as pint knows it."""
    if name == "1":
        return _Scale(Fraction(1), ())
    registry = _registry()
    try:
        unit = registry.parse_units(name)
        at_0, at_1 = (registry.Quantity(Fraction(reading), unit).to_base_units() for reading in (0, 1))
        dimension = tuple(sorted((base, Fraction(power)) for base, power in at_1.unit_items()))
        return _Scale(at_1.magnitude - at_0.magnitude, dimension, at_0.magnitude)
    except Exception:  # pint raises many kinds for an unknown word, AttributeError and AssertionError too
        raise _UnknownUnit(name) from None


def _unit_suggestion(name: str, alike: Sequence[str]) -> str:
    """Return the suggestion for an unknown unit: one of the right kind rather than one that only looks similar."""
    if name in _MISSPELLINGS:
        return f" (did you mean '{_MISSPELLINGS[name]}'?)"
    names = [other for other in dir(_registry()) if other.isalpha() and other != name]
    return suggestion(name, alike) or suggestion(name, _COMMON_UNITS) or suggestion(name, names)


@cache
def _registry() -> Any:
    import pint  # here, since `import smajax.units` has to be quick

    exact: Any = Fraction
    return pint.UnitRegistry(non_int_type=exact)
