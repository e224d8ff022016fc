"""Summary of each command's result for a terminal, a function of its document alone."""

from collections.abc import Callable, Mapping
from typing import Any

from smajax.report import comparison, diagnosis_summary, properties, simulation_summary, summary, sweep, tuning

# Function of each command that formats its document, with a line on the result folder unless its name is empty.
SUMMARIES: Mapping[str, Callable[[Mapping[str, Any], str], str]] = {
    "fit": summary.text,
    "diagnose": diagnosis_summary.text,
    "compare": comparison.text,
    "tune": tuning.text,
    "sweep": sweep.text,
    "properties": properties.text,
    "simulate": simulation_summary.text,
}


def summarise(command: str, document: Mapping[str, Any], folder: str = "") -> str:
    """Return the summary of a result, as the command prints it.

    Args:
        command: The command.
        document: The content of its result document; that of run.json for a simulation.
        folder: The result folder, which the last line names; empty for none.
    """
    return SUMMARIES[command](document, folder)
