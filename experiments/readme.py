"""Puts the tables of experiments into the README: ``python experiments/readme.py FILE.json ...``, files written by experiments with --json.

Of measured recordings by others only the rows with a target go in, and of estimates only what a bound holds and what cannot be told apart.
A table goes between ``<!-- NAME -->`` and ``<!-- end -->``, under the command that prints it. Numbers reach the README in no other way.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path

from _common import ROOT, table

ESTIMATE = re.compile(r"(sample \d+: )?(heat|material|mechanism|environment)\.\w+: .*(?<!held at its bound)\)")


def block(document: dict) -> str:
    """The table of one experiment as Markdown, under its command."""
    brief = document["experiment"].startswith("measured_")
    shown = [r for r in document["rows"] if r["met"] is not None or not (brief or ESTIMATE.fullmatch(f"{r['what']}: {r['measured']}"))]
    words = document.get("words", "") + (" --quick" if document["quick"] else "")
    command = f"`python experiments/{document['experiment']}.py{words}`"
    rows = [(r["what"], r["target"], r["measured"], {True: "yes", False: "no", None: "-"}[r["met"]]) for r in shown]
    return f"{command}:\n\n{table(['what', 'target', 'measured', 'met'], rows)}"


def main() -> None:
    """Rewrites README.md."""
    readme = ROOT / "README.md"
    text = readme.read_text(encoding="utf-8")
    for path in sys.argv[1:]:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        beside = "" if document.get("backend", "cpu") == "cpu" else " on an accelerator"
        name = document["experiment"] + document.get("words", "") + beside
        marked = re.compile(f"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
        found = marked.search(text)
        if found is None:
            sys.exit(f"README.md has no place for {name}: add the lines <!-- {name} --> and <!-- end -->")
        text = f"{text[: found.end(1)]}{block(document)}\n{text[found.start(2) :]}"
    readme.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
