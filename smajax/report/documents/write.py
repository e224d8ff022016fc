"""Writing of a result folder whose record of the run fits its model."""

from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from smajax.files.result_folder import write_folder
from smajax.report.documents.run import RunDocument, SimulationDocument


def write_result(out: Path, run: Mapping[str, Any], fill: Callable[[Path], None]) -> None:
    """Write a result folder, completely or not at all.

    Args:
        out: The folder.
        run: Content of run.json without its schema and the list of files, which are added.
        fill: Function that writes the other files into the folder that is passed to it.

    Raises:
        InputError: If the folder holds files that smajax did not write, or the files cannot be written.
    """
    model = SimulationDocument if run.get("command") == "simulate" else RunDocument
    model.check({"schema": model.SCHEMA, **run, "files": []})
    write_folder(out, run, fill)
