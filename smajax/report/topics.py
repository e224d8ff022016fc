"""Topics of ``smajax explain`` that explain the words of a summary; the texts are in ``data/topics``."""

import re
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any, NamedTuple

from smajax.files.documents import is_undetermined
from smajax.recordings.datasets import data_path

# Width of the text in columns of a terminal.
_WIDTH = 110
# Width of the texts, which are read and not compared, in columns.
TEXT_WIDTH = 100
_ITEM = "- "
# Codes of a search that ended before a minimum.
NOT_CONVERGED = ("interrupted", "steps", "diverged")
# Kinds of noise of an electrical input that need no explanation.
_PLAIN_NOISE = ("none", "no-plateaus")
# Findings about a bench, by their code, and the topic that explains them.
_BENCH_TOPICS = {"sign": "displacement", "offset": "sensor"}
# Last lines of a topic: further words that it explains, if there are any, and the page of the documentation with more.
_PAGE = re.compile(r"(?:\n+Words: ([a-z, -]+))?\n+Page: \[([^\]]+)\]\([^)]*\)\s*$")


class Topic(NamedTuple):
    """A text on a word of messages.

    Attributes:
        name: Name for ``smajax explain``.
        title: What it is about.
        text: The text as Markdown.
        page: Page of the documentation with more, below docs.
        words: Further words for ``smajax explain`` that it explains.
    """

    name: str
    title: str
    text: str
    page: str
    words: tuple[str, ...] = ()


def read_topics() -> dict[str, Topic]:
    """Return the texts on words of messages by name."""
    return {path.stem: _read(path.stem, path.read_text("utf-8")) for path in sorted(data_path("topics").glob("*.md"))}


def _read(name: str, text: str) -> Topic:
    """Split the file of a topic into its parts."""
    page = _PAGE.search(text)
    if page is None:
        raise ValueError(f"data/topics/{name}.md does not end with a line 'Page: [PAGE](PAGE)'")
    title, _, body = text[: page.start()].partition("\n")
    words = tuple(word.strip() for word in (page[1] or "").split(",") if word.strip())
    return Topic(name, title.removeprefix("# "), body.strip(), page[2], words)


def plain_text(text: str) -> str:
    """Return the Markdown of a topic as text: paragraphs and items are wrapped, blocks of code are indented."""
    parts: list[str] = []
    for number, part in enumerate(text.split("```")):
        if number % 2:  # a block of code; its first line names the language
            parts.append("\n".join(f"    {line}".rstrip() for line in part.splitlines()[1:]))
            continue
        lines: list[str] = []
        for paragraph in part.strip().splitlines():
            indent = "  " if paragraph.startswith(_ITEM) else ""
            lines += wrap(paragraph.replace("`", ""), TEXT_WIDTH, subsequent_indent=indent) or [""]
        parts.append("\n".join(lines))
    return "\n\n".join(part for part in parts if part)


def explained(topics: Sequence[str]) -> list[str]:
    """Return the lines of a summary that name the command which explains its words; none without topics.

    Args:
        topics: Names of topics of ``smajax explain``.
    """
    if not topics:
        return []
    return ["", *wrap(f"Explained by smajax explain TOPIC: {', '.join(topics)}", _WIDTH, break_on_hyphens=False)]


def fit_topics(document: Mapping[str, Any], is_bad: bool) -> list[str]:
    """Return the topics that explain the summary of a fit.

    Args:
        document: The document fit.json.
        is_bad: Whether the residual of a channel is far above its noise floor.
    """
    if document["solver"]["code"] == "failed":
        return []
    fitted = [entry for entry in document["parameters"].values() if entry["free"]]
    words = {
        "at-bound": any(entry["at_bound"] for entry in fitted),
        "not-determined": any(map(is_undetermined, fitted)) and not document.get("failure"),
        "hard-to-distinguish": any(len(group["parameters"]) > 1 for group in document["indistinct"]),
        "not-converged": document["solver"]["code"] in NOT_CONVERGED,
        "noise-floor": is_bad,
        "input-noise": any(entry["kind"] not in _PLAIN_NOISE for entry in document.get("input_noise", ())),
    }
    return [topic for topic, applies in words.items() if applies] + bench_topics(document.get("bench", ()))


def bench_topics(entries: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the topics that explain what recordings show about their bench.

    Args:
        entries: The entries ``bench`` of a document.
    """
    codes = {entry["code"] for entry in entries}
    return [topic for code, topic in _BENCH_TOPICS.items() if code in codes]


def comparison_topics(document: Mapping[str, Any]) -> list[str]:
    """Return the topics that explain the summary of a comparison, the document compare.json."""
    words = {"at-bound": "at_bound", "not-determined": "undetermined"}
    return [topic for topic, key in words.items() if any(model.get(key) for model in document["models"])]


def tuning_topics(document: Mapping[str, Any]) -> list[str]:
    """Return the topics that explain the summary of a tuning, the document tune.json."""
    return ["margins", *["limits"] * bool(document["problems"])]


def sweep_topics(document: Mapping[str, Any]) -> list[str]:
    """Return the topics that explain the summary of a sweep, the document sweep.json."""
    return ["feasible"] if document["problems"] or document.get("constraints") else []


def diagnosis_topics(document: Mapping[str, Any]) -> list[str]:
    """Return the topics that explain the summary of a diagnosis, with the effects that it names.

    Args:
        document: The document diagnosis.json.
    """
    words = {
        "verdict": True,
        "equivalent": any(document["equivalent"].values()),
        "candidate": bool(document.get("candidates")),  # absent in documents of earlier versions
        "free-parameters": document.get("verdict") in ("partial", "unresolved"),
    }
    return [*(topic for topic, applies in words.items() if applies), *document["effects"]]
