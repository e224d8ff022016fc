"""Tutorials that are notebooks in text form, as pages."""

from pathlib import Path

import jupytext

ROOT = Path(__file__).resolve().parents[2]
TUTORIALS = ROOT / "docs" / "tutorials"


def tutorial_pages() -> dict[str, str]:
    """Return the pages of the notebooks by path; ``tests/integration/test_tutorials.py`` executes them."""
    return {f"tutorials/{path.stem}.md": _page(path) for path in sorted(TUTORIALS.glob("*.py"))}


def _page(path: Path) -> str:
    parts = []
    for cell in jupytext.read(path).cells:
        parts.append(cell.source if cell.cell_type == "markdown" else f"```python\n{cell.source}\n```")
    note = f"This page is the notebook [{path.name}](../files/docs/tutorials/{path.name}), which the tests execute."
    head, _, rest = "\n\n".join(parts).partition("\n")
    return f"{head}\n\n{note}\n{rest}\n"
