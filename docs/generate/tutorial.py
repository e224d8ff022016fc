"""Tutorials that are notebooks in text form, as pages with the outputs of their cells.

The page of a notebook has a line ``<!-- cell N of: NAME.py -->`` below each cell, in place of which its output stands.
A cell that shows a figure says in its metadata what is in it: ``# %% figure="..."``.
"""

import functools
import json
import os
import re
from pathlib import Path

import jupytext

from docs.generate.figures import place_figure
from docs.generate.outputs import CommandError, read_file, result_of, text_block, write_file
from smajax.recordings.datasets import LOCAL, find

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"
CELL = re.compile(r"^<!-- cell (\d+) of: ([\w-]+\.py) -->$", re.MULTILINE)
# Data sets that a notebook reads.
DATASET = re.compile(r'\bget\("([\w-]+)"\)')
# Copies of public recordings next to a checkout.
COPIES = ROOT.parent / "shared" / "data"


def tutorial_pages() -> dict[str, str]:
    """Return the pages of the notebooks by path."""
    return {f"tutorials/{path.stem}.md": _page(path) for path in sorted(TUTORIALS.glob("*.py"))}


def _page(path: Path) -> str:
    link = f"[{path.name}](../files/docs/tutorials/{path.name})"
    note = f"This page is the notebook {link}, which is executed when the site is built; outputs stand below the cells."
    parts, number = [], 0
    for cell in jupytext.read(path).cells:
        if cell.cell_type == "markdown":
            parts.append(cell.source)
        else:
            number += 1
            parts.append(f"```python\n{cell.source}\n```\n\n{_line(number, path)}")
    head, _, rest = "\n\n".join(parts).partition("\n")
    return f"{head}\n\n{note}\n\n{_line(0, path)}\n{rest}\n"


def _line(number: int, path: Path) -> str:
    return f"<!-- cell {number} of: {path.name} -->"


def cell_output(number: int, path: Path) -> str:
    """Return what a cell of a notebook shows as part of a page; all cells are executed when the first is asked for.

    Args:
        number: Number of the cell, from 1; 0 for a remark on the page as a whole, which may be empty.
        path: The notebook.

    Raises:
        CommandError: If a cell fails or warns, or a figure has no text that says what is in it.
    """
    reason, outputs = _executed(path)
    return reason if not number else outputs[number - 1] if outputs else ""


def forget() -> None:
    """Drop the outputs of all notebooks."""
    _executed.cache_clear()


@functools.cache
def _executed(path: Path) -> tuple[str, list[str]]:
    """Execute a notebook; return why it has no outputs, if so, and the parts of the page below its cells."""
    cells = [cell for cell in jupytext.read(path).cells if cell.cell_type == "code"]
    page = f"tutorials/{path.name}"
    variables = _data_variables()
    for name in sorted({name for cell in cells for name in DATASET.findall(cell.source)}):
        find(name)  # an unknown name is an error
        if result_of(["-m", "smajax", "datasets", "get", name], page, variables).returncode:
            return f"*The outputs are left out: the recordings `{name}` were not there when this site was built.*", []
    write_file("cells.json", json.dumps([cell.source for cell in cells]), page)
    done = result_of(["-m", "docs.generate.run_cells", "cells.json", "outputs.json"], page, variables)
    if done.returncode or "Warning" in done.stderr:
        raise CommandError(f"{path.name} failed or warned: {done.stderr.strip()}")
    outputs = json.loads(read_file("outputs.json", page))
    return "", [_shown(o, cell.metadata.get("figure", ""), page) for o, cell in zip(outputs, cells, strict=True)]


def _shown(output: dict[str, str], text: str, page: str) -> str:
    """The output of a cell: a block of text, a figure, or both."""
    if output["figure"] and not text:
        raise CommandError(f"{page}: a figure has no text that says what is in it")
    parts = [text_block(output["text"])] if output["text"].strip() else []
    return "\n\n".join([*parts, place_figure(output["figure"], text, page)] if output["figure"] else parts)


def _data_variables() -> dict[str, str]:
    """Environment variables with which a notebook finds copies of public recordings, where there are some."""
    folder = os.environ.get(LOCAL) or (str(COPIES) if COPIES.is_dir() else "")
    return {LOCAL: folder} if folder else {}
