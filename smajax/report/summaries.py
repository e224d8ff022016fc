"""Summary of each command's result for a terminal, a function of its document alone."""

import importlib
from collections.abc import Mapping
from typing import Any

# Module of this folder whose function ``text`` formats the document of each command; a command imports its own only.
_MODULES: Mapping[str, str] = {
    "fit": "summary",
    "diagnose": "diagnosis_summary",
    "compare": "comparison",
    "tune": "tuning",
    "sweep": "sweep",
    "properties": "properties",
    "simulate": "simulation_summary",
}


def summarise(command: str, document: Mapping[str, Any], folder: str = "") -> str:
    """Return the summary of a result, as the command prints it.

    Args:
        command: The command.
        document: The content of its result document; that of run.json for a simulation.
        folder: The result folder, which the last line names; empty for none.
    """
    return importlib.import_module(f"smajax.report.{_MODULES[command]}").text(document, folder)
