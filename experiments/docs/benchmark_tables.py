"""Tables of experiments, inserted into the benchmark pages.

    python experiments/docs/benchmark_tables.py FILE.json ...

The files are written by experiments with ``--json``. A table goes between ``<!-- NAME -->`` and ``<!-- end -->`` on a
page of docs/benchmarks, under the command that prints it. The pages get their numbers only from here. Of recordings by
others only the rows with a target are inserted, unless the document says that its table is whole, and of estimates only
those at a bound and those that the data cannot distinguish.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))  # the checkout: smajax, tests/reference, experiments

from experiments.common.base import ROOT, table

PAGES = ROOT / "docs" / "benchmarks"
ESTIMATE = re.compile(r"(sample \d+: )?(heat|material|mechanism|environment)\.\w+: .*(?<!held at its bound)\)")
MET = {True: "yes", False: "no", None: "-"}


def block(document: dict[str, Any]) -> str:
    """Return the table of one experiment as Markdown, under its command.

    Args:
        document: The experiment's JSON document: ``experiment`` (its path below experiments/), ``rows``, ``quick``,
            ``words``.
    """
    by_others = document["experiment"].startswith("measured/")
    rows = [
        (row["what"], row["target"], row["measured"], MET[row["met"]])
        for row in document["rows"]
        if row["met"] is not None
        or document.get("whole")
        or not (by_others or ESTIMATE.fullmatch(f"{row['what']}: {row['measured']}"))
    ]
    options = document.get("words", "") + (" --quick" if document["quick"] else "")
    command = f"`python experiments/{document['experiment']}.py{options}`"
    return f"{command}:\n\n{table(['what', 'target', 'measured', 'met'], rows)}"


def insert(name: str, text: str) -> None:
    """Replace the table of that name on the page that has a place for it; exit if no page has."""
    marker = re.compile(f"(<!-- {re.escape(name)} -->\n).*?(<!-- end -->)", re.DOTALL)
    for page in sorted(PAGES.glob("*.md")):
        content = page.read_text(encoding="utf-8")
        if marker.search(content):
            page.write_text(marker.sub(lambda match: f"{match[1]}{text}\n{match[2]}", content), encoding="utf-8")
            return
    sys.exit(f"no page of docs/benchmarks has a place for {name}: add the lines <!-- {name} --> and <!-- end -->")


def main() -> None:
    """Insert the tables of all files on the command line."""
    for path in sys.argv[1:]:
        document = json.loads(Path(path).read_text(encoding="utf-8"))
        suffix = "" if document.get("backend", "cpu") == "cpu" else " on an accelerator"
        insert(document["experiment"] + document.get("words", "") + suffix, block(document))


if __name__ == "__main__":
    main()
