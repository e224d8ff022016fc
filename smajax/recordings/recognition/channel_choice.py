"""One column for each channel, where several columns may be the same one."""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from smajax.channels import channel_of
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.recognition.answers import LEFT_OUT
from smajax.recordings.recognition.column_choice import ColumnChoice
from smajax.recordings.recognition.findings import Question
from smajax.recordings.recognition.value_ranges import Floats, range_text

# Channels that drive a wire: their number is the number of wires.
DRIVING = ("current", "voltage", "power", "duty")
# Words in headers of columns that are less direct than others of the same channel.
_INDIRECT = ("crosshead", "ch", "chamber", "raw")


def choose_channels(choices: Sequence[ColumnChoice], values: Mapping[int, Floats]) -> list[ColumnChoice]:
    """Return the choices with one column for each channel, or several with numbers; the time is chosen elsewhere.

    Args:
        choices: What each column is taken for by itself.
        values: Values, shape ``(rows,)``, by the number of the column.
    """
    result = {choice.index: choice for choice in choices}
    names = dict.fromkeys(choice.channel for choice in choices if choice.channel not in (None, "time"))
    # The driving channels come first, since their number says how many wires there are.
    for name in sorted(names, key=lambda name: channel_of(name or "") not in DRIVING):
        group = [choice for choice in result.values() if choice.channel == name]
        if len(group) > 1:
            wires = sum(
                choice.channel is not None and channel_of(choice.channel) in DRIVING for choice in result.values()
            )
            result |= {choice.index: choice for choice in _resolved(group, values, wires)}
    return [result[choice.index] for choice in choices]


def _resolved(group: list[ColumnChoice], values: Mapping[int, Floats], wires: int) -> list[ColumnChoice]:
    """Return the choices of the columns of one channel, of which one remains, or several with numbers."""
    decided = [choice for choice in group if choice.is_answer]
    if decided:
        return [c if c.is_answer else _dropped(c, f"column '{decided[0].header}' is the {c.channel}") for c in group]
    group, dropped = _without(group, _repeats(group, values))
    constant = {c.index: f"{range_text(_finite(values[c.index]))}" for c in group if _is_constant(values[c.index])}
    if len(constant) < len(group):
        changing = next(c.header for c in group if c.index not in constant)
        reasons = {k: f"it is {text}, while column '{changing}' changes" for k, text in constant.items()}
        group, more = _without(group, reasons)
        dropped += more
    by_name = [c for c in group if not c.by_unit]
    if by_name and len(by_name) < len(group):
        reason = f"column '{by_name[0].header}' names the {by_name[0].channel}"
        group, more = _without(group, {c.index: reason for c in group if c.by_unit})
        dropped += more
    if len(group) == 1:
        return [*group, *dropped]
    return [*_numbered_or_first(group, values, wires), *dropped]


def _numbered_or_first(group: list[ColumnChoice], values: Mapping[int, Floats], wires: int) -> list[ColumnChoice]:
    """Return columns of one channel with the numbers of the wires, or one of them where there is one wire."""
    channel = group[0].channel or ""
    headers = ", ".join(f"'{c.header}'" for c in group)
    if channel_of(channel) in DRIVING or len(group) == wires:
        text = f"columns {headers} are all {channel}: they are numbered in this order, as of several wires"
        numbered = [_renamed(c, f"{channel}_{k}") for k, c in enumerate(group, 1)]
        others = (f"{channel}{numbered[0].text.removeprefix(f'{channel}_1')}", LEFT_OUT)
        question = Question(
            group[0].header, text, numbered[0].text, others, True, f"--channel '{group[0].header} = {others[0]}'"
        )
        return [dataclasses.replace(numbered[0], question=question), *numbered[1:]]
    direct = [c for c in group if not any(word in c.header.lower().split() for word in _INDIRECT)] or group
    if channel_of(channel) == "temperature":
        best = max(direct, key=lambda c: float(np.ptp(_finite(values[c.index]))))
        why = f"it changes most ({range_text(_finite(values[best.index]))})"
    else:
        best, why = direct[0], "it is the first of them"
        if len(direct) == 1:
            why = f"the others are indirect by a word in their names ({', '.join(_INDIRECT)})"
    text = f"columns {headers} are all {channel}, and one is needed: '{best.header}' was taken, as {why}"
    other = next(c for c in group if c is not best)
    option = f"--channel '{other.header} = {other.text}'"
    question = Question(best.header, text, best.text, (LEFT_OUT,), True, option)
    if best.question:
        question = dataclasses.replace(best.question, text=f"{text}; {best.question.text}")
    rest = [_dropped(c, f"column '{best.header}' was taken as {channel}") for c in group if c is not best]
    return [dataclasses.replace(best, question=question), *rest]


def _repeats(group: Sequence[ColumnChoice], values: Mapping[int, Floats]) -> dict[int, str]:
    """Return reasons to leave out columns that repeat an earlier one, by number of the column."""
    reasons: dict[int, str] = {}
    for k, choice in enumerate(group):
        for earlier in group[:k]:
            if np.array_equal(values[choice.index], values[earlier.index], equal_nan=True):
                if earlier.index not in reasons and not _is_constant(values[choice.index]):
                    reasons[choice.index] = f"it repeats column '{earlier.header}'"
                break
    return reasons


def _without(
    group: Sequence[ColumnChoice], reasons: Mapping[int, str]
) -> tuple[list[ColumnChoice], list[ColumnChoice]]:
    rest = [c for c in group if c.index not in reasons]
    return rest, [_dropped(c, reasons[c.index]) for c in group if c.index in reasons]


def _dropped(choice: ColumnChoice, reason: str) -> ColumnChoice:
    return ColumnChoice(choice.index, choice.header, None, None, reason)


def _renamed(choice: ColumnChoice, channel: str) -> ColumnChoice:
    source = choice.source or ChannelMap(choice.header)
    return dataclasses.replace(choice, channel=channel, source=source, question=None)


def _is_constant(values: Floats) -> bool:
    numbers = _finite(values)
    return bool(len(numbers) and numbers.min() == numbers.max())


def _finite(values: Floats) -> Floats:
    return values[np.isfinite(values)]
