"""Units as people write them in headers, as units that smajax reads."""

import re

from smajax.channels import CHANNELS, channel_of, channel_unit
from smajax.errors import InputError
from smajax.units import conversion

# Spellings that are no units, or units of something else, by the spelling in lower case.
_SPELLINGS = {
    "c": "degC",
    "°c": "degC",
    "ºc": "degC",
    "celsius": "degC",
    "deg c": "degC",
    "deg. c": "degC",
    "grad c": "degC",
    "k": "K",
    "kelvin": "K",
    "f": "degF",
    "°f": "degF",
    "fahrenheit": "degF",
    "sec": "s",
    "secs": "s",
    "second": "s",
    "seconds": "s",
    "sek": "s",
    "msec": "ms",
    "millis": "ms",
    "millisec": "ms",
    "millisecs": "ms",
    "milliseconds": "ms",
    "usec": "us",
    "micros": "us",
    "microseconds": "us",
    "min": "min",
    "mins": "min",
    "minutes": "min",
    "hr": "h",
    "hrs": "h",
    "hours": "h",
    "amp": "A",
    "amps": "A",
    "ampere": "A",
    "volt": "V",
    "volts": "V",
    "watt": "W",
    "watts": "W",
    "newton": "N",
    "newtons": "N",
    "ohms": "ohm",
    "Ω": "ohm",
    "pct": "%",
    "percent": "%",
    "prozent": "%",
    "degree": "deg",
    "degrees": "deg",
    "°": "deg",
    "a": "A",
    "v": "V",
    "w": "W",
    "n": "N",
    "ma": "mA",
    "mpa": "MPa",
    "-": "1",
}
# Masses that stand for their weights where a force is meant.
_WEIGHTS = {"g": "gf", "gram": "gf", "grams": "gf", "gr": "gf", "kg": "kgf", "lb": "lbf", "lbs": "lbf"}
# Suffixes of headers that may be units, as in Temp_C: only those that are usual in such names.
_SUFFIX_NAMES = (
    "s ms us sec secs msec millis micros min h A mA a V mV v W mW N mN kN n g kg mm um cm m MPa Pa GPa kPa mpa ohm "
    "ohms mohm deg rad C c degC celsius K F degF pct percent"
)
SUFFIXES = frozenset(_SUFFIX_NAMES.split())
_COUNTS = re.compile(r"(adc|raw|counts?|lsb|bits?|digits?|ticks?|steps?)( ?(counts?|value|units?))?", re.IGNORECASE)


def is_counts(text: str) -> bool:
    """Return whether a text in the place of a unit says raw numbers of a converter.

    Args:
        text: The text, such as "ADC counts".
    """
    return bool(_COUNTS.fullmatch(text.strip()))


def unit_for(text: str, channel: str | None) -> str | None:
    """Return the unit that a text says; ``None`` where it is not a unit of the channel.

    Args:
        text: Text in the place of a unit.
        channel: The channel; ``None`` for any one.
    """
    text = text.strip()
    kind = channel_of(channel or "")
    usual = text if kind and text in CHANNELS[kind].units else ""
    weight = _WEIGHTS.get(text.lower(), "") if kind == "force" else ""
    first_word = text.lower().split(" ")[0]
    candidates = [usual, weight, _SPELLINGS.get(text.lower(), ""), text, _SPELLINGS.get(first_word, "")]
    channels = [channel] if channel else list(_OF_UNITS)
    return next((unit for unit in candidates if unit and any(is_unit_of(unit, name) for name in channels)), None)


def is_unit_of(unit: str, channel: str) -> bool:
    """Return whether a unit converts to that of a channel.

    Args:
        unit: The unit.
        channel: The channel.
    """
    try:
        conversion(unit, channel_unit(channel))
    except (InputError, ValueError):
        return False
    return True


# Channel that a unit alone suggests, in this order.
_OF_UNITS = (
    "time",
    "current",
    "voltage",
    "power",
    "temperature",
    "force",
    "displacement",
    "stress",
    "resistance",
    "angle",
    "rate",
    "torque",
)


def channel_of_unit(text: str) -> tuple[str, str] | None:
    """Return the channel that a unit alone suggests, and the unit; ``None`` for none.

    Args:
        text: Text in the place of a unit.
    """
    for channel in _OF_UNITS:
        unit = unit_for(text, channel)
        if unit is not None:
            return channel, unit
    return None
