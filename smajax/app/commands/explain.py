"""Job of ``smajax explain``: short texts on words of messages and on effects, without a network.

The texts of words are ``data/topics/NAME.md``, those of effects come from their classes. The documentation site shows
the same texts.
"""

import re
from difflib import get_close_matches
from textwrap import wrap
from typing import NamedTuple

from smajax.app.commands.catalogues import effect_lines
from smajax.errors import InputError
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path

# Width of the text in columns of a terminal.
_WIDTH = 100
# Most names that a message suggests, and the similarity (difflib's ratio) from which it does; chosen by trial,
# tests/integration/test_explain.py holds them.
_NEAR = 3
_SIMILARITY = 0.6
# Last line of a topic: the page of the documentation with more.
_PAGE = re.compile(r"\n+Page: \[([^\]]+)\]\([^)]*\)\s*$")
_ITEM = "- "


class Topic(NamedTuple):
    """A text on a word of messages.

    Attributes:
        name: Name for ``smajax explain``.
        title: What it is about.
        text: The text as Markdown.
        page: Page of the documentation with more, below docs.
    """

    name: str
    title: str
    text: str
    page: str


def topics() -> dict[str, Topic]:
    """Return the texts on words of messages by name."""
    return {path.stem: _read(path.stem, path.read_text("utf-8")) for path in sorted(data_path("topics").glob("*.md"))}


def explain_text(name: str | None = None) -> str:
    """Return the text on a topic for a terminal, or the list of all topics.

    Args:
        name: Name of the topic or key of an effect; ``None`` for the list.

    Raises:
        InputError: If there is no such topic.
    """
    words, effects = topics(), catalogue()
    if name is None:
        width = max(map(len, words))
        lines = [f"{topic.name.ljust(width)}  {topic.title}" for topic in words.values()]
        keys = wrap(f"Effects: {', '.join(sorted(effects))}", _WIDTH, break_on_hyphens=False)
        return "\n".join([*lines, "", *keys, "", "smajax explain TOPIC describes one of them."])
    key = re.sub(r"[\s_]+", "-", name.strip().lower())
    if key in words:
        topic = words[key]
        return f"{topic.title}\n\n{_plain(topic.text)}\n\nMore: docs/{topic.page}"
    if key in effects:
        return "\n".join([*effect_lines(key, effects[key]), "", "More: docs/reference/effects.md"])
    names = [*words, *effects]
    near = list(dict.fromkeys([*(n for n in names if key in n), *get_close_matches(key, names, _NEAR, _SIMILARITY)]))
    hint = f" (near it: {', '.join(near[:_NEAR])})" if key and near else ""
    raise InputError(f"there is no topic '{name}'{hint}: 'smajax explain' lists those that there are")


def _read(name: str, text: str) -> Topic:
    """Split the file of a topic into its parts."""
    page = _PAGE.search(text)
    if page is None:
        raise ValueError(f"data/topics/{name}.md does not end with a line 'Page: [PAGE](PAGE)'")
    title, _, body = text[: page.start()].partition("\n")
    return Topic(name, title.removeprefix("# "), body.strip(), page[1])


def _plain(text: str) -> str:
    """Return Markdown as text: paragraphs and items are wrapped, blocks of code are indented."""
    parts: list[str] = []
    for number, part in enumerate(text.split("```")):
        if number % 2:  # a block of code; its first line names the language
            parts.append("\n".join(f"    {line}".rstrip() for line in part.splitlines()[1:]))
            continue
        lines: list[str] = []
        for paragraph in part.strip().splitlines():
            indent = "  " if paragraph.startswith(_ITEM) else ""
            lines += wrap(paragraph.replace("`", ""), _WIDTH, subsequent_indent=indent) or [""]
        parts.append("\n".join(lines))
    return "\n\n".join(part for part in parts if part)
