"""Results of experiments on pages: their tables, what they missed, and single numbers.

``<!-- result of: NAME -->`` is replaced by the run of ``experiments/results/NAME.json``, ``<!-- results: asked -->`` by
a table of the runs of the page, ``<!-- results: missed -->`` by the targets that they missed, and
``{{ NAME | ROW }}`` by what a row of the table measured. ``{{ NAME | ROW | 2 }}`` is the second number of that text.
"""

import ast
import functools
import json
import re
from pathlib import Path
from typing import Any

from docs.generate.markdown import cell, table

ROOT = Path(__file__).resolve().parents[2]
EXPERIMENTS = ROOT / "experiments"
RESULTS = EXPERIMENTS / "results"
RUN = re.compile(r"^<!-- result of: ([\w.-]+) -->$", re.MULTILINE)
LIST = re.compile(r"^<!-- results: (asked|missed) -->$", re.MULTILINE)
NUMBER = re.compile(r"\{\{ ([\w.-]+) \| (.+?)(?: \| (\d+))? \}\}")
# A number in a text: digits with separators of thousands, or with decimals and an exponent.
FIGURE = re.compile(r"(?<![\w.])[-+]?\d[\d,]*(?:\.\d+)?(?:e[-+]?\d+)?")
# Estimates of parameters with their intervals, which the commands print and the pages leave out.
ESTIMATE = re.compile(
    r"(.*: )?(heat|material|mechanism|environment|drive|sensor)\.[\w.@-]+: .*(?<!held at its bound)\)"
)
MET = {True: "yes", False: "no", None: "-"}
# Rows without a target that a page shows at once; more of them are folded.
SHOWN_ROWS = 8
NAMES = {"python": "Python", "jax": "JAX", "numpy": "NumPy", "scipy": "SciPy"}


class ResultError(RuntimeError):
    """A page asks for a result that there is not."""


@functools.cache
def results() -> dict[str, dict[str, Any]]:
    """Return the documents of all recorded runs by name."""
    return {path.stem: json.loads(path.read_text("utf-8")) for path in sorted(RESULTS.glob("*.json"))}


def result(name: str) -> dict[str, Any]:
    """Return the document of a run.

    Raises:
        ResultError: If there is none of that name.
    """
    if name not in results():
        raise ResultError(f"experiments/results has no {name}.json")
    return results()[name]


def measured(name: str, what: str, index: str | None = None) -> str:
    """Return what a row of a run measured, or one number of that text.

    Raises:
        ResultError: If there is no such row or number.
    """
    found = [row["measured"] for row in result(name)["rows"] if row["what"] == what]
    if len(found) != 1:
        raise ResultError(f"{len(found)} rows of {name} are called '{what}'")
    if index is None:
        return found[0]
    figures = FIGURE.findall(found[0])
    if not 1 <= int(index) <= len(figures):
        raise ResultError(f"'{found[0]}' ({name}) has no number {index}")
    return figures[int(index) - 1]


def insert_results(markdown: str) -> str:
    """Replace the markers of a page."""
    names = RUN.findall(markdown)
    lists = {"asked": asked, "missed": missed}
    markdown = NUMBER.sub(lambda match: measured(match[1], match[2], match[3]), markdown)
    markdown = LIST.sub(lambda match: lists[match[1]](names), markdown)
    return RUN.sub(lambda match: run(match[1]), markdown)


def asked(names: list[str]) -> str:
    """Return a table of runs: what each one asks, how many targets are met, and how long it took."""
    rows = [(f"[{_title(result(name))}](#{anchor(name)})", targets(name), duration(result(name))) for name in names]
    return table(("question", "targets met", "running time"), rows)


def _title(document: dict[str, Any]) -> str:
    """The question of a run, with its options."""
    options = variant(document)
    return f"{question(document['experiment'])} ({options})" if options else question(document["experiment"])


def missed(names: list[str]) -> str:
    """Return a list of the targets that runs missed."""
    lines = [
        f"- [{row['what']}](#{anchor(name)}): {row['measured']}; the target is {row['target']}."
        for name in names
        for row in result(name)["rows"]
        if row["met"] is False
    ]
    return "\n".join(lines) or "No target of these runs is missed."


def run(name: str) -> str:
    """Return the command of a run, its circumstances and its table."""
    document = result(name)
    rows = [row for row in document["rows"] if not ESTIMATE.fullmatch(f"{row['what']}: {row['measured']}")]
    judged = [row for row in rows if row["met"] is not None]
    others = [row for row in rows if row["met"] is None]
    shown, folded = (rows, []) if len(others) <= SHOWN_ROWS else (judged, others)
    text = f"`{document['command']}`\n{{ #{anchor(name)} }}\n\n{circumstances(document)}\n\n{_table(shown)}"
    if folded:
        lines = _table(folded).splitlines()
        text += f'\n??? note "{len(folded)} rows without a target"\n\n' + "".join(f"    {line}\n" for line in lines)
    return text


def _table(rows: list[dict[str, Any]]) -> str:
    return table(
        ("what", "target", "measured", "met"),
        [(row["what"], row["target"], row["measured"], MET[row["met"]]) for row in rows],
    )


def anchor(name: str) -> str:
    """Return the anchor of a run on its page."""
    return f"run-{name.replace('.', '-')}".lower()


def targets(name: str) -> str:
    """Return how many targets of a run are met."""
    judged = [row["met"] for row in result(name)["rows"] if row["met"] is not None]
    return f"{sum(judged)} of {len(judged)}" if judged else "none set"


def duration(document: dict[str, Any]) -> str:
    """Return the running time of a run, rounded for a reader."""
    seconds = document["seconds"]
    if seconds is None:
        return "not recorded"
    return f"{seconds:.0f} s" if seconds < 120 else f"{seconds / 60:.0f} min" if seconds < 7200 else "hours"


def circumstances(document: dict[str, Any]) -> str:
    """Return when, on what and with which versions a run was made, and which of these were not recorded."""
    machine = document["machine"]
    cores = f"{machine['cores']} cores" if machine["cores"] else None
    versions = [f"{NAMES.get(name, name)} {value}" for name, value in document["versions"].items() if value]
    facts = {
        "date": document["date"],
        "running time": document["seconds"] and duration(document),
        "processor": ", ".join(filter(None, (machine["processor"], cores, machine["accelerator"]))),
        "versions": ", ".join(versions),
    }
    is_recorded = {"date": document["date"], "running time": document["seconds"]}
    is_recorded |= {"processor": machine["processor"], "versions": all(document["versions"].values())}
    lost = [name for name, content in is_recorded.items() if not content]
    text = "; ".join(content for content in facts.values() if content)
    sentence = f"Run: {text}." if text else ""
    return f"{sentence} Not recorded for this run: {', '.join(lost)}.".strip() if lost else sentence


@functools.cache
def question(experiment: str) -> str:
    """Return the first sentence of an experiment's text."""
    module = ast.parse((EXPERIMENTS / f"{experiment}.py").read_text("utf-8"))
    return cell((ast.get_docstring(module) or "").partition("\n\n")[0]).removesuffix(".")


def variant(document: dict[str, Any]) -> str:
    """Return the options of a run, and its accelerator; empty for an experiment as it is."""
    words = [document["words"].strip(), "--quick" * document["quick"], document["machine"]["accelerator"]]
    return " ".join(filter(None, words))
