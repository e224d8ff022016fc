"""What one column is taken for, by its header and its values."""

import dataclasses
from typing import Literal

import numpy as np

from smajax.channels import CHANNELS
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.recognition.answers import LEFT_OUT, answer_text, parse_answer
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.header_words import HeaderReading, read_header
from smajax.recordings.recognition.value_ranges import (
    Floats,
    Scale,
    are_counts,
    range_text,
    scale_of,
)
from smajax.recordings.unit_checks import looks_like_kelvin

# Share of the rows in which a column has to have a number.
_LEAST_NUMBERS = 0.5
# Words for a length that grows, where the displacement of smajax is positive when the wire shortens.
_LENGTHENING = ("extension", "elongation", "extensometer", "crosshead")


@dataclasses.dataclass(frozen=True)
class ColumnChoice:
    """What a column is taken for.

    Attributes:
        index: Number of the column, from 0.
        header: Its header.
        channel: The channel; ``None`` for a column that is left out.
        source: Unit and scale; ``None`` for a column that is left out.
        reason: Why, in one sentence.
        question: The doubt; ``None`` without one.
        by_unit: Whether only the unit says the channel.
        is_answer: Whether the user has decided.
        code: What ``reason`` is, where others ask for it: the header is unknown, or the column counts the rows.
        word: Word of the header that says the channel; empty without one.
        values: Range of the values in words, which is shown after ``reason``; empty for none.
    """

    index: int
    header: str
    channel: str | None
    source: ChannelMap | None
    reason: str
    question: Question | None = None
    by_unit: bool = False
    is_answer: bool = False
    code: Literal["", "unknown", "counts-rows"] = ""
    word: str = ""
    values: str = ""

    @property
    def full_reason(self) -> str:
        """The reason with the range of the values."""
        return f"{self.reason} ({self.values})" if self.values else self.reason

    @property
    def text(self) -> str:
        """What it is taken for, as in an answer."""
        return answer_text(self.channel, self.source)


def choose_column(index: int, header: str, values: Floats, answer: str | None) -> ColumnChoice:
    """Return what a column is taken for.

    Args:
        index: Number of the column, from 0.
        header: Its header.
        values: Its values, shape ``(rows,)``; NaN where a cell is not a number.
        answer: What the user says that it is; ``None`` for nothing.

    Raises:
        InputError: If the answer is not one of a channel.
    """
    if answer is not None:
        channel, source = parse_answer(header, answer)
        return ColumnChoice(index, header, channel, source, "as you say", is_answer=True)
    reading = read_header(header)
    numbers = values[np.isfinite(values)]
    if not len(numbers):
        return _left_out(index, header, "it has no numbers")
    if reading.is_row_number and _counts_rows(values):
        return dataclasses.replace(_left_out(index, header, "it counts the rows"), code="counts-rows")
    if reading.other_quantity:
        reason = f"'{reading.other_quantity}' says that it is not what was measured or applied"
        return _left_out(index, header, reason)
    if reading.is_command:
        return _command(index, header, numbers)
    if reading.channel is None:
        choice = _left_out(index, header, "its name says no channel")
        return dataclasses.replace(choice, code="unknown", values=range_text(numbers))
    if len(numbers) < _LEAST_NUMBERS * len(values):
        text = f"only {len(numbers)} of {len(values)} rows have a number"
        return _left_out(index, header, text, _question(header, text, LEFT_OUT, (_example(reading.channel),)))
    if reading.channel == "time":
        source, word = ChannelMap(header, reading.unit), reading.word
        return ColumnChoice(index, header, "time", source, f"'{word}' says time", word=word)
    return _measured(index, header, numbers, reading)


def _measured(index: int, header: str, numbers: Floats, reading: HeaderReading) -> ColumnChoice:
    """Return the choice of a column whose header names a channel other than time."""
    channel = reading.own_name or reading.channel or ""
    kind = reading.channel or ""
    says = f"'{reading.word}' says {kind}" if reading.word else f"its unit '{reading.unit_text}' says {kind}"
    if numbers.min() == numbers.max() == 0 and not CHANNELS[kind].commanded:
        return _left_out(index, header, f"{says}, and it is 0 in every row, as without a sensor")
    if reading.is_counts or (reading.unit is None and are_counts(kind, numbers)):
        return _counts(index, header, kind, numbers, says)
    scale = _scale_in_unit(kind, reading.unit, reading.unit_text, numbers) if reading.unit else scale_of(kind, numbers)
    others = tuple(f"{channel} {other}" for other in scale.others)
    if not scale.unit:
        text = f"{says}, but {scale.doubt}"
        return _left_out(index, header, text, _question(header, text, LEFT_OUT, others))
    factor = -1.0 if kind == "displacement" and reading.word.lower() in _LENGTHENING else 1.0
    source = ChannelMap(header, scale.unit, factor=factor, full_scale=scale.full_scale)
    doubts = [scale.doubt] if scale.doubt else []
    if reading.by_unit:
        doubts.append(f"only its unit says {kind}")
        others += (LEFT_OUT,)
    if factor < 0:
        doubts.append(f"'{reading.word}' grows as the wire lengthens, and {kind} is positive when it shortens")
        others += (answer_text(channel, ChannelMap(header, scale.unit)),)
    question = _question(header, "; ".join(doubts), answer_text(channel, source), others) if doubts else None
    return ColumnChoice(index, header, channel, source, f"{says}; {scale.reason}", question, reading.by_unit)


def _scale_in_unit(kind: str, unit: str, text: str, numbers: Floats) -> Scale:
    """Return the scale by the unit of the header, with a doubt where the values contradict it."""
    if kind in ("temperature", "ambient") and unit == "degC" and looks_like_kelvin(numbers):
        return Scale(
            "K", f"{range_text(numbers)} begins at room temperature in K", f"the header says {text}", ("[degC]",)
        )
    if kind in ("duty", "fan") and unit == "1" and numbers.max() > 1:
        return scale_of(kind, numbers)
    return Scale(unit, f"the unit is {text}" + (f", {unit}" if text != unit else ""))


def _command(index: int, header: str, numbers: Floats) -> ColumnChoice:
    """Return the choice of a column that names a command without a quantity: a duty where its values may be one."""
    if numbers.min() < 0:
        reason, values = "it names a command, whose quantity is not known", range_text(numbers)
        text = f"{reason} ({values})"
        return dataclasses.replace(
            _left_out(index, header, reason),
            values=values,
            question=_question(header, text, LEFT_OUT, ("current [A]", "voltage [V]")),
        )
    scale = scale_of("duty", numbers)
    others = (*(f"duty {other}" for other in scale.others), "voltage [V]", "current [A]", LEFT_OUT)
    if not scale.unit:
        return _left_out(index, header, scale.doubt, _question(header, scale.doubt, LEFT_OUT, others))
    source = ChannelMap(header, scale.unit, full_scale=scale.full_scale)
    doubt = "its name says a command only, whose quantity may be another one"
    doubt += f"; {scale.doubt}" if scale.doubt else ""
    question = _question(header, doubt, answer_text("duty", source), others)
    return ColumnChoice(index, header, "duty", source, f"it names a command; {scale.reason}", question, by_unit=True)


def _counts(index: int, header: str, kind: str, numbers: Floats, says: str) -> ColumnChoice:
    text = f"the whole numbers {range_text(numbers)} are counts of a converter, whose factor the file does not say"
    example = f"{kind} [{CHANNELS[kind].units[0]}] factor=0.01 offset=0"
    return _left_out(index, header, f"{says}; its unit is not known", _question(header, text, LEFT_OUT, (example,)))


def _left_out(index: int, header: str, reason: str, question: Question | None = None) -> ColumnChoice:
    return ColumnChoice(index, header, None, None, reason, question)


def _question(header: str, text: str, choice: str, others: tuple[str, ...]) -> Question:
    example = next((other for other in others if other != LEFT_OUT), choice)
    return Question(header, text, choice, others, True, f"--channel '{header} = {example}'")


def _example(channel: str) -> str:
    return f"{channel} [{CHANNELS[channel].units[0]}]"


def _counts_rows(values: Floats) -> bool:
    """Return whether values rise by one from row to row."""
    rows = np.flatnonzero(np.isfinite(values))
    return bool(np.array_equal(np.diff(values[rows]), np.diff(rows)))
