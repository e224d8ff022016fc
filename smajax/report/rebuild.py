"""Report of a finished run, built again from the files in its folder without a simulation."""

import contextlib
import importlib
import threading
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.result_folder import replace_file
from smajax.report.documents import read_document, read_run
from smajax.report.prediction import read_predictions

# Module of this folder, and its function, that builds the page of each command; a command imports its own only.
_PAGES: Mapping[str, tuple[str, str]] = {
    "fit": ("run_pages", "fit_page"),
    "diagnose": ("diagnosis_page", "diagnosis_page"),
    "compare": ("comparison", "comparison_page"),
    "tune": ("tuning", "tuning_page"),
    "sweep": ("sweep", "sweep_page"),
    "properties": ("properties_page", "properties_page"),
    "simulate": ("run_pages", "simulation_page"),
}


def build_page(command: str, document: Mapping[str, Any], data: Any, run: Mapping[str, Any], rig: str) -> str:
    """Return the report of a command as HTML.

    Args:
        command: The command.
        document: The content of its result document.
        data: Predictions; of a sweep the columns of its table.
        run: The content of run.json.
        rig: The text of the rig file.
    """
    module, function = _PAGES[command]
    return getattr(importlib.import_module(f"smajax.report.{module}"), function)(document, data, run, rig)


def load_page_builder(command: str) -> None:
    """Load what ``build_page`` needs for a command in a thread, such as the classes of plotly, while numbers run.

    Args:
        command: The command.
    """
    threading.Thread(target=_load, args=(_PAGES[command][0],), daemon=True, name="smajax-report").start()


def _load(module: str) -> None:
    # An error is raised again where the page is built.
    with contextlib.suppress(Exception):
        importlib.import_module(f"smajax.report.{module}")
        importlib.import_module("smajax.report.figures").base_layout()  # plotly loads its classes at their first use


def rebuild_report(folder: Path) -> Path:
    """Build report.html of a result folder again.

    Folders of earlier versions of smajax are readable as well.

    Args:
        folder: The result folder.

    Returns:
        The path of the page.

    Raises:
        InputError: If a file of the folder is missing or damaged.
    """
    run, document = read_run(folder), read_document(folder)
    data = read_data(folder, run.command)
    try:
        # Thermal cycles need no rig.
        rig = "" if run.command == "properties" else (folder / "rig.toml").read_text("utf-8")
    except (OSError, UnicodeDecodeError) as error:
        reason = getattr(error, "strerror", None) or "not UTF-8"
        raise InputError(f"{folder / 'rig.toml'}: the file cannot be read ({reason}): run the command again") from None
    try:
        page = build_page(run.command, document.to_dict(), data, run.to_dict(), rig)
    except (LookupError, StopIteration, ValueError) as error:
        problem = f"it does not fit the document of the folder ({type(error).__name__} {error})"
        raise InputError(f"{folder / data_file(run.command)}: {problem}: run the command again") from None
    replace_file(folder / "report.html", page)
    return folder / "report.html"


def data_file(command: str) -> str:
    """Return the name of the file with the data of a command's figures."""
    return "sweep.parquet" if command == "sweep" else "prediction.csv"


def read_data(folder: Path, command: str) -> Any:
    """Read the data of a command's figures from a result folder.

    Args:
        folder: The result folder.
        command: The command that wrote it.

    Returns:
        The recordings with their predictions; of a sweep the columns of its table by name.

    Raises:
        InputError: If the file is missing or damaged.
    """
    path = folder / data_file(command)
    if command != "sweep":
        return read_predictions(path)
    from smajax.sweeps.table import read_table  # pyarrow, which other commands do not need

    return read_table(path)
