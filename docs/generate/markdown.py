"""Markdown: tables whose cells cannot break them, and texts of docstrings."""

import inspect
import re
from collections.abc import Iterable, Sequence
from typing import Any


def cell(text: Any) -> str:
    """Return a text as the content of a cell."""
    parts = re.split(r"(`[^`]*`)", " ".join(str(text).split()))  # a bar within code is no border
    return "".join(part if part.startswith("`") else part.replace("|", "\\|") for part in parts) or "-"


def table(head: Sequence[str], rows: Iterable[Sequence[Any]]) -> str:
    """Return a table; empty if it has no rows."""
    lines = [f"| {' | '.join(map(cell, row))} |" for row in rows]
    if not lines:
        return ""
    return "\n".join([f"| {' | '.join(head)} |", f"|{'---|' * len(head)}", *lines]) + "\n"


def code(text: Any) -> str:
    """Return a text in the type of code; a dash for an empty one."""
    shown = " ".join(str(text).split())
    return f"`{shown}`" if shown else "-"


def docstring(thing: Any) -> str:
    """Return the docstring as Markdown: literal blocks (``::``) end with a colon, lists have an empty line before."""
    lines: list[str] = []
    for line in (inspect.getdoc(thing) or "").splitlines():
        if line.lstrip().startswith("- ") and lines and lines[-1].strip() and not lines[-1].lstrip().startswith("- "):
            previous_is_item = any(before.lstrip().startswith("- ") for before in lines[-3:])
            if not previous_is_item:
                lines.append("")
        lines.append(f"{line[:-1]}" if line.endswith("::") else line)
    return "\n".join(lines)


def first_sentence(thing: Any) -> str:
    """Return the first paragraph of a docstring in one line."""
    return " ".join((inspect.getdoc(thing) or "").partition("\n\n")[0].split())
