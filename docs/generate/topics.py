"""The texts of ``smajax explain`` on words of messages."""

import posixpath
from pathlib import Path

from smajax.report.topics import Topic, read_topics

DOCS = Path(__file__).resolve().parents[1]


def messages() -> str:
    """Return a section for each topic, with the page that has more."""
    return "\n".join(
        f"\n## {topic.title} {{ #{topic.name} }}\n\n{_commands(topic)}\n\n{topic.text}\n\n"
        f"More: [{_title(topic.page)}]({posixpath.relpath(topic.page, 'reference')})\n"
        for topic in read_topics().values()
    )


def _commands(topic: Topic) -> str:
    """Return the command that prints a topic, and the other words that it takes."""
    words = ", ".join(f"`{word}`" for word in topic.words)
    return f"`smajax explain {topic.name}`" + (f", or one of the words {words}" if words else "")


def _title(page: str) -> str:
    return (DOCS / page).read_text("utf-8").partition("\n")[0].removeprefix("# ")
