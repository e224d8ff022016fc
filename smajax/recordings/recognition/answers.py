"""Texts that decide what a column is: ``force [N] factor=-0.0087 offset=7.5``, or ``-`` for none."""

import re
from collections.abc import Mapping, Sequence
from typing import Any

from smajax.channels import CHANNELS, channel_of, channel_suggestion, channel_unit
from smajax.errors import InputError, suggestion
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.recognition.unit_names import unit_for

# Answer for a column that is not a channel.
LEFT_OUT = "-"
_SCALE_KEYS = ("factor", "offset", "full_scale")
_ANSWER = re.compile(
    r"(?P<channel>\w++)(?:\s*+\[(?P<unit>[^\]]*+)\])?+(?P<scale>(?:[\s,]++\w++\s*+=\s*+[^\s,]++)*+)\s*+"
)
_SETTING = re.compile(r"(\w+)\s*=\s*([^\s,]+)")
_EXAMPLE = (
    "write it like 'force [N]', 'force [N] factor=-0.0087 offset=7.5', 'duty full_scale=255', or - to leave it out"
)


def parse_answer(header: str, text: str) -> tuple[str | None, ChannelMap | None]:
    """Return the channel and the scale that a text says for a column; ``None`` for a column to leave out.

    Args:
        header: Header of the column.
        text: The text.

    Raises:
        InputError: If the text is not one of a channel.
    """
    if text.strip() == LEFT_OUT:
        return None, None
    match = _ANSWER.fullmatch(text.strip())
    if match is None:
        raise InputError(f"column '{header}': '{text}' does not say what it is: {_EXAMPLE}")
    channel = match["channel"]
    if channel_of(channel) is None:
        known = f"the channels are {', '.join(CHANNELS)}"
        raise InputError(f"column '{header}': '{channel}' is not a channel{channel_suggestion(channel)}: {known}")
    scale = _scale(header, match["scale"])
    unit = match["unit"]
    if unit is not None:
        read = unit_for(unit, channel)
        if read is None:
            example = CHANNELS[channel_of(channel) or channel].units[0]
            raise InputError(f"column '{header}': '{unit}' is not a unit of {channel}: write one like '{example}'")
        unit = read
    elif channel_unit(channel) == "1":
        unit = "1"
    else:
        example = f"{channel} [{CHANNELS[channel_of(channel) or channel].units[0]}]"
        raise InputError(f"column '{header}': '{text}' has no unit: write it like '{example}'")
    return channel, ChannelMap(header, unit, **scale)


def answer_text(channel: str | None, source: ChannelMap | None) -> str:
    """Return the text that says what a column is; ``parse_answer`` returns the same.

    Args:
        channel: The channel; ``None`` for a column that is left out.
        source: Unit and scale.
    """
    if channel is None or source is None:
        return LEFT_OUT
    default = ChannelMap(source.column)
    settings = [
        f" {key}={getattr(source, key):.12g}" for key in _SCALE_KEYS if getattr(source, key) != getattr(default, key)
    ]
    unit = "" if source.unit in (None, "1") else f" [{source.unit}]"
    return f"{channel}{unit}{''.join(settings)}"


def answers_by_header(texts: Sequence[str]) -> dict[str, str]:
    """Divide texts such as ``Force sensor = force [N]`` into headers of a file and what they are.

    Args:
        texts: The texts.

    Raises:
        InputError: If a text is not of this form.
    """
    answers = {}
    for text in texts:
        places = [match.start() for match in re.finditer("=", text)]
        if not places:
            cure = "write it like 'Force sensor = force [N]', or 'Force sensor = -' to leave the column out"
            raise InputError(f"'{text}' does not say what a column is: {cure}")
        place = next((k for k in places if _is_answer(text[k + 1 :])), places[0])
        answers[text[:place].strip()] = text[place + 1 :].strip()
    return answers


def check_headers(answers: Mapping[str, str], headers: Sequence[str], path: object) -> None:
    """Refuse an answer for a column that a file does not have.

    Args:
        answers: What columns are, by header.
        headers: Headers of the file.
        path: The file, for the message.

    Raises:
        InputError: If there is no such column.
    """
    for header in answers:
        if header not in headers:
            hint = suggestion(header, headers)
            raise InputError(f"{path}: there is no column '{header}'{hint}: it has {', '.join(headers)}")


def _scale(header: str, text: str) -> dict[str, Any]:
    scale: dict[str, Any] = {}
    for key, value in _SETTING.findall(text):
        if key not in _SCALE_KEYS:
            hint = suggestion(key, _SCALE_KEYS)
            raise InputError(f"column '{header}': '{key}' is not known{hint}: it is one of {', '.join(_SCALE_KEYS)}")
        try:
            scale[key] = float(value)
        except ValueError:
            raise InputError(f"column '{header}': {key} = '{value}' is not a number: {_EXAMPLE}") from None
    return scale


def _is_answer(text: str) -> bool:
    match = _ANSWER.fullmatch(text.strip())
    return text.strip() == LEFT_OUT or (match is not None and channel_of(match["channel"]) is not None)
