"""The channel and the unit that a header names, in the ways in which people write them."""

import re
from dataclasses import dataclass

from smajax.channels import channel_of
from smajax.recordings.column_mapping import ChannelMap, name_and_unit
from smajax.recordings.recognition.unit_names import SUFFIXES, channel_of_unit, is_counts, unit_for


def _words(text: str) -> frozenset[str]:
    return frozenset(text.split())


# Words in headers by channel; those of four letters or more also as the beginning or the end of a longer word.
_WORDS = {
    "time": "time timestamp millis micros clock elapsed zeit uhrzeit tiempo temps seconds monotonic datetime date",
    "current": "current curr strom courant corriente amps isma iwire",
    "voltage": "voltage volt volts voltaje vsma vwire",
    "power": "power leistung puissance potencia watt watts",
    "duty": "duty pwm dutycycle tastgrad",
    "temperature": "temperature temp temperatur température temperatura thermocouple thermo chamber twire",
    "ambient": "ambient ambiente amb tamb room troom environment umgebung raum air tair",
    "fan": "fan lüfter ventilator",
    "displacement": "displacement disp displ position pos stroke weg lvdt laser travel deflection contraction "
    "crosshead desplazamiento déplacement extension elongation extensometer",
    "angle": "angle winkel theta phi angulo rotation",
    "rate": "gyro omega",
    "force": "force load kraft fuerza loadcell weight",
    "torque": "torque drehmoment couple",
    "stress": "stress stres sigma tensile",
    "strain": "strain eps epsilon dehnung deformation",
    "resistance": "resistance resist widerstand rsma rwire resistencia",
}
_CHANNEL_OF_WORD = {word: channel for channel, words in _WORDS.items() for word in words.split()}
# Symbols, which count only where they are the whole name.
_SYMBOLS = {
    "t": "time",
    "T": "temperature",
    "i": "current",
    "I": "current",
    "u": "voltage",
    "U": "voltage",
    "v": "voltage",
    "V": "voltage",
    "p": "power",
    "P": "power",
    "F": "force",
    "f": "force",
    "R": "resistance",
    "r": "resistance",
    "x": "displacement",
    "X": "displacement",
    "\u03b5": "strain",
    "\u03c3": "stress",
}
# Name of the time in text files of LabVIEW, whose x axis it is.
_LABVIEW_TIME = "X_Value"
# Words that may stand with a symbol or word without changing what it is.
_NEUTRAL = _words("sma wire meas measured actual in out input output sensor raw the of mean avg")
# Words that say that a column is not what was measured or applied.
_OTHER_QUANTITY = _words(
    "setpoint target ref reference desired goal limit max maximum min minimum error err derivative deriv std gain "
    "unconstrained flag status median count sum change phase dt"
)
# Words of a command whose quantity its values have to say.
_COMMAND = _words("control command cmd input drive")
# Words by which a channel is recognised before all others in the header.
_FIRST = ("ambient", "fan")
# Words of a length that is likely to be meant where they begin or end a longer word.
_LONG = 4
_ROW_NUMBERS = _words("index row rows sample samples nr no n # id count counter")
_OPENING, _CLOSING = "[(<", "])>"
_SEPARATORS = r"[_ .-]"
_PARTS = re.compile(r"[A-ZÄÖÜ]+(?![a-zäöü])|[A-ZÄÖÜ]?[^\W\d_A-ZÄÖÜ]+|#|\d+")


@dataclass(frozen=True)
class HeaderReading:
    """What a header says.

    Attributes:
        channel: The channel that it names; ``None`` for none.
        word: The word by which it was recognised.
        unit: The unit that it names, as smajax reads it; ``None`` for none.
        unit_text: The unit as it is in the header.
        by_unit: Whether the channel is recognised by the unit alone.
        other_quantity: The word that says that this is not what was measured or applied; empty without one.
        is_counts: Whether it says that the numbers are counts of a converter.
        is_command: Whether it names a command without a quantity.
        is_row_number: Whether it names row numbers.
        own_name: The name where it is one of a channel, such as ``current_2``; empty otherwise.
    """

    channel: str | None = None
    word: str = ""
    unit: str | None = None
    unit_text: str = ""
    by_unit: bool = False
    other_quantity: str = ""
    is_counts: bool = False
    is_command: bool = False
    is_row_number: bool = False
    own_name: str = ""


def read_header(header: str) -> HeaderReading:
    """Return what a header says.

    Args:
        header: The header.
    """
    name, unit_text = split_unit(header)
    words = _words_of(name)
    other = next((word for word in words if word.lower() in _OTHER_QUANTITY), "")
    channel, word = _channel_in(name, words)
    if not unit_text and len(words) > 1 and words[-1] in SUFFIXES and words[-1] != word:
        suffix = words[-1]
        if (channel and unit_for(suffix, channel)) or (not channel and re.search(rf"[_ .-]{re.escape(suffix)}$", name)):
            unit_text = suffix
            channel, word = (channel, word) if channel else _channel_in(name, words[:-1])
    counts = is_counts(unit_text) or bool({"adc", "counts", "raw"} & {w.lower() for w in words} and not unit_text)
    unit = unit_for(unit_text, channel) if channel and unit_text else None
    by_unit = False
    if channel is None and unit_text:
        pair = channel_of_unit(unit_text)
        channel, unit, by_unit = (*pair, True) if pair else (None, None, False)
    elif channel and unit_text and unit is None and not is_counts(unit_text):
        # The unit is more certain than the word: "Spannung [MPa]" is no voltage.
        pair = channel_of_unit(unit_text)
        channel, unit, by_unit = (*pair, True) if pair else (channel, None, False)
    lower = {w.lower() for w in words}
    is_row_number = channel is None and (not name.strip() or bool(lower & _ROW_NUMBERS) or name.startswith("Unnamed"))
    is_command = channel is None and bool(lower & _COMMAND)
    own_name = name if channel_of(name) else ""
    return HeaderReading(channel, word, unit, unit_text, by_unit, other, counts, is_command, is_row_number, own_name)


def split_unit(header: str) -> tuple[str, str]:
    """Return the name in a header, and the text in the place of its unit: in brackets, or after a slash, comma or in.

    Args:
        header: The header.
    """
    text = header.strip()
    if bracketed := _split_brackets(text):
        return bracketed
    separated = _split_separator(text)
    return separated if separated and channel_of_unit(separated[1]) else (text, "")


def _split_brackets(text: str) -> tuple[str, str] | None:
    """Return the text before the last brackets, and the text in them; ``None`` where it does not end with any."""
    if not text.endswith(tuple(_CLOSING)):
        return None
    after_others = max(text.rfind(bracket, 0, -1) for bracket in _CLOSING) + 1
    places = [text.find(bracket, after_others) for bracket in _OPENING]
    at = min((place for place in places if place >= 0), default=None)
    return None if at is None else (text[:at].strip(), text[at + 1 : -1].strip())


def _split_separator(text: str) -> tuple[str, str] | None:
    """Return the text before the last slash with white space, comma or in, and the word after it; ``None`` without."""
    unit = re.split(r"[\s,/]", text)[-1]
    before = text[: len(text) - len(unit)]
    head = before.rstrip()
    has_space = head != before
    name = head[:-1]
    if head.endswith("/"):
        is_split = has_space or name != name.rstrip()
    elif head.endswith("in"):
        name = head[:-2]
        is_split = has_space and name != name.rstrip()
    else:
        is_split = head.endswith(",")
    return (name.strip(), unit) if is_split and unit and name.strip() else None


def _words_of(name: str) -> list[str]:
    """Return the words of a name; a unit after its last separator, such as mN, is one word."""
    last = re.split(_SEPARATORS, name)[-1]
    head = name[: len(name) - len(last)]
    return [*_PARTS.findall(head), last] if head and last in SUFFIXES else _PARTS.findall(name)


def _channel_in(name: str, words: list[str]) -> tuple[str | None, str]:
    """Return the channel that the words of a name say, and the word."""
    if channel_of(name) is not None or name == _LABVIEW_TIME:
        return channel_of(name) or "time", name
    matches = [match for match in map(_channel_of_word, words) if match is not None]
    for first in _FIRST:
        for channel, word in matches:
            if channel == first:
                return channel, word
    if matches:
        return matches[-1]
    rest = [word for word in words if word.lower() not in _NEUTRAL and not word.isdigit()]
    if rest and rest[0] in _SYMBOLS and (len(rest) == 1 or (len(rest) == 2 and rest[1] in SUFFIXES)):
        return _SYMBOLS[rest[0]], rest[0]
    return None, ""


def _channel_of_word(word: str) -> tuple[str, str] | None:
    """Return the channel that a word says, and the word or the part of it that says it."""
    lower = word.lower()
    if lower in _CHANNEL_OF_WORD:
        return _CHANNEL_OF_WORD[lower], word
    parts = [w for w in _CHANNEL_OF_WORD if len(w) >= _LONG and (lower.startswith(w) or lower.endswith(w))]
    part = max(parts, key=len, default="")
    return (_CHANNEL_OF_WORD[part], part) if part else None


def is_own_header(header: str, channel: str, source: ChannelMap) -> bool:
    """Return whether a header says channel and unit in the form that needs no mapping: ``name [unit]``.

    Args:
        header: The header.
        channel: The channel.
        source: Unit and scale.
    """
    if source.is_scaled or source.any_scale:
        return False
    name, unit = name_and_unit(header)
    return name == channel and (unit or "1").strip() == source.unit
