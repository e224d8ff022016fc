"""Blocks of code on pages, and how each is executed.

A block of ``sh`` or ``python`` is executed by ``tests/integration/test_docs_commands.py``, in the order of its page, or
when the site is built, if the page shows the outputs of its commands (``<!-- output of: ... -->``). A block that cannot
run there has the line ``<!-- not executed: REASON -->`` above it, which the site shows. ``<!-- run first -->`` marks a
block of Python that makes a file for the commands of a page, and ``<!-- file: PATH -->`` one that is such a file.
"""

import re
from typing import NamedTuple

BLOCK = re.compile(
    r"^(?:<!-- (?:not executed: (?P<reason>[^>]+?)|(?P<first>run first)|file: (?P<file>[\w./-]+)) -->\n)?"
    r"```(?P<language>\w*)\n(?P<text>.*?)^```$",
    re.MULTILINE | re.DOTALL,
)
OUTPUT = re.compile(r"^<!-- output of: (smajax .+) -->$", re.MULTILINE)
REFUSAL = re.compile(r"^<!-- refusal of: (smajax .+) -->$", re.MULTILINE)
FILE = re.compile(r"^<!-- file: ([\w./-]+) -->$", re.MULTILINE)
REASON = re.compile(r"^<!-- not executed: ([^>]+?) -->$", re.MULTILINE)
EXECUTED = ("sh", "python")


class Block(NamedTuple):
    """A block of a page.

    Attributes:
        language: Its language.
        text: Its text.
        line: Number of its first line on the page.
        reason: Why it is not executed; empty if it is.
        is_first: Whether it makes a file for the commands of the page.
        file: Path of the file that it is for the commands of the page; empty for none.
    """

    language: str
    text: str
    line: int
    reason: str
    is_first: bool
    file: str


def blocks(markdown: str) -> list[Block]:
    """Return the blocks of a page in their order."""
    return [
        Block(
            match["language"],
            match["text"],
            markdown.count("\n", 0, match.start("text")) + 1,
            match["reason"] or "",
            bool(match["first"]),
            match["file"] or "",
        )
        for match in BLOCK.finditer(markdown)
    ]


def commands(text: str) -> list[str]:
    """Return the commands of a shell block, without comments and line continuations."""
    lines = (re.split(r"\s#", line)[0] for line in text.replace("\\\n", " ").splitlines())
    return [" ".join(line.split()) for line in lines if line.strip()]
