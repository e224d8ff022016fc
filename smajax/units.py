"""Quantities as text (``"0.15 mm"``) and columns with units (``current [mA]``) on one side, SI floats on the other.

Inside smajax everything is SI, except that temperatures are degC (their differences K). The unit that a quantity has inside is named by
its *canonical* text: ``"m"``, ``"Pa"``, ``"rad"``, ``"1"`` for a fraction, ``"degC"`` for a temperature, ``"K"`` for a difference of two.

What a user writes is never evaluated. A small grammar (names, ``* / ^``, whole exponents, brackets) takes the text apart and pint is asked
about single names only. Factors are exact fractions, so that ``"0.15 mm"`` is the float nearest to 0.00015 and every float can be
written and read back without loss. pint is loaded at the first conversion, not at import.
"""

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from decimal import Context, Decimal
from fractions import Fraction
from functools import cache, lru_cache
from types import MappingProxyType
from typing import Any, TypeVar, cast

import numpy as np
from numpy.typing import NDArray

from smajax.errors import InputError, nearest

Numbers = TypeVar("Numbers", float, NDArray[np.float64])


@dataclass(frozen=True)
class Channel:
    """What a recorded channel is, and what values a bench with shape-memory alloys can give.

    ``plausible`` bounds every value (canonical unit), ``faint`` is the smallest that the largest magnitude of a recording can be without
    being a mistake of unit (0: any). ``units`` are tried when the values are outside, to say what they look like. A ``commanded`` channel
    may jump by any factor from row to row, as an input does; beyond ``usual`` such a jump is a change of unit all the same.
    """

    unit: str
    description: str
    units: tuple[str, ...]
    plausible: tuple[float, float] = (-np.inf, np.inf)
    faint: float = 0.0
    commanded: bool = False
    usual: float = 0.0


CHANNELS: Mapping[str, Channel] = MappingProxyType(
    {
        "time": Channel("s", "time of the row, strictly increasing", ("s", "ms", "min")),
        "current": Channel("A", "current through the wire", ("A", "mA", "uA"), (-50.0, 50.0), 1e-3, commanded=True, usual=10.0),
        "voltage": Channel("V", "voltage across the wire", ("V", "mV", "uV"), (-400.0, 400.0), commanded=True, usual=100.0),
        "power": Channel("W", "electrical power into the wire", ("W", "mW", "uW"), (-10.0, 2000.0), commanded=True, usual=500.0),
        "duty": Channel("1", "fraction of the time in which the drive is on, 0 to 1", ("1", "%"), (0.0, 1.0), commanded=True, usual=1.0),
        "temperature": Channel("degC", "temperature of the wire", ("degC", "K", "mK", "degF"), (-200.0, 900.0)),
        "ambient": Channel("degC", "temperature of the surroundings", ("degC", "K", "mK", "degF"), (-200.0, 500.0)),
        "displacement": Channel("m", "displacement of the load, positive when the wire shortens", ("m", "mm", "um", "nm"), (-1.0, 1.0)),
        "angle": Channel("rad", "angle of the pulley, positive when wire 1 is heated", ("rad", "deg", "mrad"), (-20.0, 20.0)),
        "rate": Channel("rad/s", "rate of the angle", ("deg/s", "rad/s", "mrad/s"), (-500.0, 500.0)),
        "force": Channel("N", "force along the wire, tension positive", ("N", "mN", "uN", "kN"), (-1e5, 1e5)),
        "torque": Channel("N m", "torque on the pulley", ("N m", "N mm", "uN m"), (-1000.0, 1000.0)),
        "stress": Channel("Pa", "stress in the wire, tension positive", ("MPa", "Pa", "kPa", "GPa"), (-5e9, 5e9), faint=1e4),
        "strain": Channel("1", "strain of the wire, elongation positive", ("1", "%", "ppm"), (-0.5, 0.5)),
        "resistance": Channel("ohm", "electrical resistance of the wire", ("ohm", "mohm", "uohm"), (-1.0, 1000.0)),
    }
)

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
# Names that a misspelt unit is compared with first; the rest of pint's thousand names only if none of these is near.
_COMMON = (*(unit for channel in CHANNELS.values() for unit in channel.units if " " not in unit), "kg", "g", "cm", "us", "h", "Hz", "J")
# Names that pint reads as something nobody at a bench means: number-metres, attometres per second.
_ALIASES = {"Nm": "N m", "mNm": "mN m", "uNm": "uN m", "Nmm": "N mm", "Ncm": "N cm", "amps": "A", "℃": "degC", "℉": "degF"}
_MEANT = {"C": "degC", "F": "degF", "Celsius": "degC", "Kelvin": "K", "Amp": "A", "Amps": "A", "Volt": "V", "Watt": "W", "Ohm": "ohm"}
_LONGEST = 60
_NUMBER = re.compile(r"[+-]?(?:\d+\.?\d*|\.\d+)(?:[eE][+-]?\d{1,3})?", re.ASCII)
_TOKEN = re.compile(r"\s*(?:(?P<name>[A-Za-zµμεΩΩ°℃℉_]+|[%‰])|(?P<power>\^|\*\*)\s*(?P<exponent>[+-]?\d)|(?P<sign>[*/()·1]))", re.ASCII)
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_ZERO_CELSIUS = Fraction("273.15")
_ANGLE = (("radian", Fraction(1)),)


@dataclass(frozen=True)
class _Scale:
    """A unit as ``factor`` times the product of SI base units in ``dimension``; ``offset`` (K) is where a thermometer's scale begins."""

    factor: Fraction
    dimension: tuple[tuple[str, Fraction], ...]
    offset: Fraction = Fraction(0)


class _UnknownUnit(InputError):
    """A name that pint does not know."""

    def __init__(self, name: str):
        super().__init__(f"the unit '{name}' is not known: units are written like 'mm', 'mA', 'MPa', 'degC' or 'W/m^2/K'")
        self.name = name


def channel_of(name: str) -> str | None:
    """The known channel behind ``name``: ``current`` for ``current`` and ``current_2``, None for an unknown name."""
    base = re.sub(r"_[1-9][0-9]*$", "", name, flags=re.ASCII)
    return base if base in CHANNELS else None


def numbered(name: str, wires: int) -> tuple[str, ...]:
    """The channels of a kind that ``wires`` wires have: ``name`` itself for one, else ``name_1``, ``name_2``."""
    return (name,) if wires == 1 else tuple(f"{name}_{i + 1}" for i in range(wires))


def to_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """``value`` (float or array of any shape) in ``unit``, converted to the canonical unit; an InputError if the two do not convert."""
    factor, offset = conversion(unit, canonical)
    return _affine(value, factor, offset)


def from_si(value: Numbers, unit: str, canonical: str) -> Numbers:
    """``value`` (float or array) in the canonical unit, converted to ``unit``.

    Of the floats next to the result it is the one that ``to_si`` takes back to ``value``, wherever there is one.
    """
    factor, offset = conversion(unit, canonical)
    wanted = np.asarray(value, float)
    first = np.array(_affine(wanted, 1 / factor, -offset / factor), ndmin=1)
    best, wanted = first.copy(), wanted.reshape(first.shape)
    wrong = np.flatnonzero(_affine(best, factor, offset) != wanted)
    # Rounding has led at most a few places astray, of the result or, where an offset cancels, of the much coarser value.
    place = np.maximum(np.spacing(abs(first.flat[wrong])), 0.25 * np.spacing(abs(wanted.flat[wrong])) / float(factor))
    for steps in sorted(range(-12, 13), key=abs):
        trial = first.flat[wrong] + steps * place
        found = _affine(trial, factor, offset) == wanted.flat[wrong]
        best.flat[wrong[found]] = trial[found]
        wrong, place = wrong[~found], place[~found]
    return cast(Numbers, best.reshape(value.shape) if isinstance(value, np.ndarray) else float(best[0]))


def parse(text: str | float, canonical: str) -> float:
    """A quantity as text (``"0.15 mm"``, ``"80 uohm cm"``, ``"20 degC"``, ``"4.1 %"``) as a float in the canonical unit.

    A bare number is a fraction (canonical ``"1"``) and nothing else. Raises InputError with the cure; the caller adds file and key.
    """
    example = f"write it like '{example_of(canonical)}'"
    if isinstance(text, bool) or not isinstance(text, str | int | float):
        raise InputError(f"{text!r} is not a quantity: {example}")
    text = repr(text) if isinstance(text, int | float) else text.strip()
    if len(text) > _LONGEST:
        raise InputError(f"a quantity of {len(text)} characters ('{text[:12]}...') is too long: {example}")
    text = text.replace("\N{MINUS SIGN}", "-")
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
    try:
        factor, offset = conversion(unit or "1", canonical)
    except InputError as error:
        raise InputError(f"'{text}': {error}") from None
    try:
        return float(Fraction(number.group()) * factor + offset)
    except OverflowError:
        raise InputError(f"'{text}' is too large for a number: {example}") from None


def unit_of(text: str | float) -> str:
    """The unit in which a quantity that ``parse`` reads is written: ``"mm"`` of ``"5 mm"``, ``"1"`` of a bare number."""
    number = _NUMBER.match(str(text).strip().replace("\N{MINUS SIGN}", "-"))
    return (str(text).strip()[number.end() :].strip() if number else "") or "1"


def format_quantity(value_si: float, unit: str, canonical: str | None = None) -> str:
    """Text such as ``"0.15 mm"``, as short as can be, that ``parse`` takes back to exactly the same finite float.

    (Exactly, but for temperatures within 1e-15 K of zero that are wanted in another scale: these take more digits than a quantity has.)
    Without ``canonical`` the value is taken in the SI unit of its kind, a temperature (degC, degF) in degC, and K as a difference.
    """
    factor, offset = conversion(unit, canonical) if canonical is not None else _to_own_si(unit)
    exact = (Fraction(value_si) - offset) / factor
    if exact == 0:
        number = "-0" if np.signbit(value_si) else "0"
    else:
        parts = Decimal(exact.numerator), Decimal(exact.denominator)
        rounded = [Context(digits).divide(*parts) for digits in range(1, _LONGEST - 20)]
        shortest = next((digits for digits in rounded if float(Fraction(digits) * factor + offset) == value_si), rounded[-1])
        number = f"{shortest:f}" if 1e-5 <= abs(exact) < 1e7 else f"{shortest.normalize():e}".replace("e+", "e")
    return number if unit in ("", "1") else f"{number} {unit}"


def example_of(canonical: str) -> str:
    """A quantity in the canonical unit's kind, as a user would write it."""
    return _EXAMPLES.get(canonical, f"1 {canonical}")


def base_units(unit: str) -> tuple[float, float, dict[str, int]]:
    """``(factor, offset, powers)`` of a unit: its value in SI base units, whose powers are given by name, is factor x value + offset."""
    scale = _scale(unit)
    return float(scale.factor), float(scale.offset), {base: int(power) for base, power in scale.dimension}


@lru_cache(maxsize=4096)
def conversion(unit: str, canonical: str) -> tuple[Fraction, Fraction]:
    """Exact ``(factor, offset)`` with canonical = factor x value + offset; InputError for an unknown unit or one of another kind."""
    target = _scale(canonical)
    try:
        scale = _scale(unit)
    except _UnknownUnit as unknown:
        alike = [common for common in _COMMON if unknown.name == unit and _same_kind(_scale(common), target)]
        hint = _near_unit(unknown.name, alike)
        raise InputError(f"the unit '{unknown.name}' is not known{hint}: write one as in '{example_of(canonical)}'") from None
    absolute = canonical == "degC"
    if not _same_kind(scale, target) or (absolute and scale.dimension != target.dimension):
        hint = f" (did you mean '{_MEANT[unit]}'?)" if absolute and unit in _MEANT else ""
        what = "a fraction or '%'" if canonical == "1" else f"a unit that converts to {canonical}"
        raise InputError(f"the unit '{unit}' does not fit{hint}: {what} is expected, as in '{example_of(canonical)}'")
    return scale.factor / target.factor, scale.offset - _ZERO_CELSIUS if absolute else Fraction(0)


def _to_own_si(unit: str) -> tuple[Fraction, Fraction]:
    scale = _scale(unit)
    return scale.factor, scale.offset - _ZERO_CELSIUS if scale.offset else Fraction(0)


def _same_kind(a: _Scale, b: _Scale) -> bool:
    """Equal dimensions; rad is optional inside a product (``N m/rad``), but an angle is not a fraction."""
    if {a.dimension, b.dimension} == {(), _ANGLE}:
        return False
    return [d for d in a.dimension if d[0] != "radian"] == [d for d in b.dimension if d[0] != "radian"]


def _affine(value: Any, factor: Fraction, offset: Fraction) -> Any:
    """factor x value + offset, with as few roundings as floats allow: 0.001 x is x / 1000."""
    top, bottom = factor.numerator, factor.denominator
    if max(top, bottom) > 2**53:
        value = value * float(factor)
    else:
        value = value * float(top) if top != 1 else value
        value = value / float(bottom) if bottom != 1 else value
    return value + float(offset) if offset else value


@lru_cache(maxsize=4096)
def _scale(unit: str) -> _Scale:
    """The unit's text, taken apart: products and quotients from left to right, powers first."""
    if len(unit) > _LONGEST:
        raise InputError(f"a unit of {len(unit)} characters ('{unit[:12]}...') is too long: write it like 'mm' or 'W/m^2/K'")
    text = re.sub(r"(?:\bdeg|°) ([CF])$", r"deg\1", unit.strip().replace("º", "°"))
    text = re.sub("[⁻⁰¹²³⁴-⁹]+", lambda found: "^" + found.group().translate(_SUPERSCRIPT), text)
    if text in _ALIASES or re.fullmatch(r"[^\W\d]+|°[CF]|1", text):
        return _scale(_ALIASES[text]) if text in _ALIASES else _atom(text)
    tokens, end = [], 0
    while end < len(text):
        token = _TOKEN.match(text, end)
        if token is None or token.end() == end:
            raise InputError(f"the unit '{unit}' is not understood at '{text[end:].strip()}': write it like 'mm', 'N m' or 'W/m^2/K'")
        tokens.append(token)
        end = token.end()
    scale, rest = _product(tokens, unit)
    if rest:
        raise InputError(f"the unit '{unit}' has a bracket that was never opened: write it like 'W/(m^2 K)'")
    return scale


def _product(tokens: list[re.Match[str]], unit: str) -> tuple[_Scale, list[re.Match[str]]]:
    """The product at the beginning of ``tokens``, up to a closing bracket, and the tokens after it."""
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
            factor, tokens = _product(tokens, unit)
            if not tokens:
                raise InputError(f"the unit '{unit}' has a bracket that is never closed: write it like 'W/(m^2 K)'")
            tokens = tokens[1:]
        else:
            name = token["name"] or "1"
            factor = _scale(_ALIASES[name]) if name in _ALIASES else _atom(name)
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
    return _Scale(a.factor * b.factor**exponent, tuple(sorted((base, power) for base, power in powers.items() if power)))


@lru_cache(maxsize=4096)
def _atom(name: str) -> _Scale:
    """One name (``mm``, ``uohm``, ``degC``), asked of pint."""
    if name == "1":
        return _Scale(Fraction(1), ())
    registry = _registry()
    try:
        unit = registry.parse_units(name)
        at_0, at_1 = (registry.Quantity(Fraction(reading), unit).to_base_units() for reading in (0, 1))
        dimension = tuple(sorted((base, Fraction(power)) for base, power in at_1.unit_items()))
        return _Scale(at_1.magnitude - at_0.magnitude, dimension, at_0.magnitude)
    except Exception:  # whatever pint makes of a single word (it raises many kinds, AttributeError and AssertionError too): no unit
        raise _UnknownUnit(name) from None


def _near_unit(name: str, alike: Sequence[str]) -> str:
    """The unit that may have been meant: one of the right kind rather than one that only looks similar."""
    if name in _MEANT:
        return f" (did you mean '{_MEANT[name]}'?)"
    names = [other for other in dir(_registry()) if other.isalpha() and other != name]
    return nearest(name, alike) or nearest(name, _COMMON) or nearest(name, names)


@cache
def _registry() -> Any:
    import pint  # here, since `import smajax.units` has to be quick

    exact: Any = Fraction
    return pint.UnitRegistry(non_int_type=exact)
