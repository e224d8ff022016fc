"""Topics of ``smajax explain`` that explain the words of a summary; the texts are in ``data/topics``."""

from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

from smajax.files.documents import is_undetermined

# Width of the text in columns of a terminal.
_WIDTH = 110
# Codes of a search that ended before a minimum.
NOT_CONVERGED = ("interrupted", "steps", "diverged")


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
    }
    return [topic for topic, applies in words.items() if applies]


def diagnosis_topics(document: Mapping[str, Any]) -> list[str]:
    """Return the topics that explain the summary of a diagnosis, with the effects that it names.

    Args:
        document: The document diagnosis.json.
    """
    words = {
        "verdict": True,
        "equivalent": any(document["equivalent"].values()),
        "candidate": bool(document.get("candidates")),  # absent in documents of earlier versions
    }
    return [*(topic for topic, applies in words.items() if applies), *document["effects"]]
