"""Summary of a simulation for a terminal, from its document ``run.json`` alone."""

from collections.abc import Mapping
from typing import Any

from smajax.report.shown_values import format_value
from smajax.report.summary import table

Document = Mapping[str, Any]


def text(run: Document, folder: str = "") -> str:
    """Format the summary of a simulation for a terminal.

    Args:
        run: The document run.json.
        folder: The result folder, which the last line names; empty for none.
    """
    recording = run["recordings"][0]
    lines = [f"Simulated {recording['rows']:,} rows of {recording['name']} with {run['rig']}.", ""]
    rows = [
        (channel, *("-" if v is None else f"{v:.5g}" for v in (entry["lowest"], entry["highest"])), entry["unit"])
        for channel, entry in run["channels"].items()
    ]
    lines += table([("channel", "lowest", "highest", "unit"), *rows], right=(1, 2))
    if metrics := run.get("metrics"):
        lines += ["", "Last cycle:"]
        lines += table([(n, format_value(e["value"], e["unit"])) for n, e in metrics.items()], right=(1,))
    lines += [
        "",
        *(f"- {recording['name']}: {note}." for note in recording["notes"]),
        *(f"- {warning}" for warning in run["warnings"]),
    ]
    if folder:
        lines.append(f"Results: {folder}")
    return "\n".join(line.rstrip() for line in lines)
