"""Parser of units such as ``"W/m^2/K"``: a small grammar, in which pint only looks up single names.

Text of a user is never evaluated. A unit is a product of names, with ``* / ^``, integer exponents and brackets, and
becomes an exact fraction times powers of SI base units. pint takes longer to load than a file to check; it is loaded at
the first name that is not among the frequent ones.
"""

import json
import re
from dataclasses import dataclass
from fractions import Fraction
from functools import cache, lru_cache
from pathlib import Path
from typing import Any

from smajax.errors import InputError

# Names that pint reads as a unit that is never meant here, such as number-metres or attometres per second.
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
# Longest text of a quantity or unit: limits the time for malicious input, and is longer than any unit with the digits
# of a float.
MAX_LENGTH = 60
# Most units, and most conversions, that are cached: limits the memory where a file has very many different texts.
CACHED_UNITS = 4096
# Letters of a name that is a whole word, in which a capital letter has no meaning as in Mm; volt has four.
_LONG_NAME = 4
_TOKEN = re.compile(
    r"\s*(?:(?P<name>[A-Za-zµμεΩΩ°℃℉_]+|[%‰])|(?P<power>\^|\*\*)\s*(?P<exponent>[+-]?\d)|(?P<sign>[*/()·1]))", re.ASCII
)
_SUPERSCRIPT = str.maketrans("⁰¹²³⁴⁵⁶⁷⁸⁹⁻", "0123456789-")
_ANGLE = (("radian", Fraction(1)),)


@dataclass(frozen=True)
class UnitScale:
    """A unit as a multiple of SI base units.

    Attributes:
        factor: Factor to the base units.
        dimension: Base units with their powers.
        offset: Zero of a temperature scale, K; 0 for other units.
    """

    factor: Fraction
    dimension: tuple[tuple[str, Fraction], ...]
    offset: Fraction = Fraction(0)


class UnknownUnitError(InputError):
    """A name that pint does not know."""

    def __init__(self, name: str):
        examples = "'mm', 'mA', 'MPa', 'degC' or 'W/m^2/K'"
        super().__init__(f"the unit '{name}' is not known: units are written like {examples}")
        self.name = name


@lru_cache(maxsize=CACHED_UNITS)
def parse_unit(unit: str) -> UnitScale:
    """Parse the text of a unit: powers first, then products and quotients from left to right.

    Args:
        unit: Unit as a user writes it.

    Raises:
        InputError: The text is too long or is not a product of units.
        UnknownUnitError: A name is not known.
    """
    if len(unit) > MAX_LENGTH:
        long = f"a unit of {len(unit)} characters ('{unit[:12]}...') is too long"
        raise InputError(f"{long}: write it like 'mm' or 'W/m^2/K'")
    text = re.sub(r"(?:\b[Dd]eg|°) ([CF])$", r"deg\1", unit.strip().replace("º", "°"))
    text = re.sub("[⁻⁰¹²³⁴-⁹]+", lambda match: "^" + match.group().translate(_SUPERSCRIPT), text)
    if text in _ALIASES or re.fullmatch(r"[^\W\d]+|°[CF]|1", text):
        return parse_unit(_ALIASES[text]) if text in _ALIASES else _unit_of_name(text)
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


def _parse_product(tokens: list[re.Match[str]], unit: str) -> tuple[UnitScale, list[re.Match[str]]]:
    """Parse the product at the beginning of the tokens, up to a closing bracket; return it with the tokens after it."""
    total, sign = UnitScale(Fraction(1), ()), 1
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
            factor = parse_unit(_ALIASES[name]) if name in _ALIASES else _unit_of_name(name)
        exponent = 1
        if tokens and tokens[0]["power"]:
            exponent, tokens = int(tokens[0]["exponent"]), tokens[1:]
        total, sign, operand_due = _times(total, factor, sign * exponent), 1, False
    if operand_due:
        raise malformed
    return total, tokens


def _times(a: UnitScale, b: UnitScale, exponent: int) -> UnitScale:
    powers = dict(a.dimension)
    for base, power in b.dimension:
        powers[base] = powers.get(base, Fraction(0)) + power * exponent
    dimension = tuple(sorted((base, power) for base, power in powers.items() if power))
    return UnitScale(a.factor * b.factor**exponent, dimension)


@lru_cache(maxsize=CACHED_UNITS)
def _unit_of_name(name: str) -> UnitScale:
    """Return the unit of a single name (``mm``, ``uohm``, ``degC``); frequent ones do not need pint."""
    if name == "1":
        return UnitScale(Fraction(1), ())
    if name.istitle() and len(name) >= _LONG_NAME and name not in _common_units():
        name = name.lower()  # oscilloscopes write Second and Volt
    if name in _common_units():  # Mohm, too, which is no mohm
        factor, dimension, offset = _common_units()[name]
        powers = tuple((base, Fraction(power)) for base, power in dimension.items())
        return UnitScale(Fraction(factor), powers, Fraction(offset))
    return unit_of_pint(name)


def unit_of_pint(name: str) -> UnitScale:
    """Return the unit of a single name, as pint knows it.

    Args:
        name: The name.

    Raises:
        UnknownUnitError: The name is not known.
    """
    registry = _registry()
    try:
        unit = registry.parse_units(name)
        at_0, at_1 = (registry.Quantity(Fraction(reading), unit).to_base_units() for reading in (0, 1))
        dimension = tuple(sorted((base, Fraction(power)) for base, power in at_1.unit_items()))
        return UnitScale(at_1.magnitude - at_0.magnitude, dimension, at_0.magnitude)
    except Exception:  # pint raises errors of many classes for an unknown name, such as AttributeError
        raise UnknownUnitError(name) from None


def same_kind(a: UnitScale, b: UnitScale) -> bool:
    """Return whether two units have the same dimension.

    rad is optional in a product (``N m/rad``), but an angle alone is not a fraction.

    Args:
        a: The first unit.
        b: The second unit.
    """
    if {a.dimension, b.dimension} == {(), _ANGLE}:
        return False
    return [d for d in a.dimension if d[0] != "radian"] == [d for d in b.dimension if d[0] != "radian"]


def unit_names() -> list[str]:
    """Return the names in pint's registry that consist of letters, for suggestions."""
    registry = _registry()
    for name in _common_units():  # pint lists a name with a prefix, such as millimeter, once it has parsed it
        registry.parse_units(name)
    return [name for name in dir(registry) if name.isalpha()]


@cache
def _common_units() -> dict[str, Any]:
    """Return factor, dimension and offset of frequent names, as ``python -m docs.generate.unit_table`` writes them."""
    return json.loads(Path(__file__).with_name("common_units.json").read_text("utf-8"))


@cache
def _registry() -> Any:
    import pint  # here, so that `import smajax.units` is fast

    exact: Any = Fraction
    return pint.UnitRegistry(non_int_type=exact)
