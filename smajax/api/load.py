"""Load a saved study from its result folder."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from smajax.api.compare import ComparisonStudy
from smajax.api.diagnose import DiagnosisStudy
from smajax.api.fit import FitStudy
from smajax.api.predict import PredictionStudy
from smajax.api.properties import PropertiesStudy
from smajax.api.saved_files import saved_files
from smajax.api.study import PREDICTIONS, Study
from smajax.api.sweep import load_sweep
from smajax.api.tune import TuningStudy
from smajax.arguments import as_path
from smajax.report.documents import read_document, read_run
from smajax.report.prediction import read_predictions

_STUDIES: dict[str, type[Study]] = {
    study.command: study
    for study in (PredictionStudy, FitStudy, DiagnosisStudy, ComparisonStudy, PropertiesStudy, TuningStudy)
}


def load(folder: str | Path) -> Study:
    """Return the study of a result folder, of this version of smajax or an earlier one.

    Args:
        folder: The folder that ``save`` or a command wrote.

    Raises:
        InputError: If the folder is not a result of smajax, or a file is missing or damaged.
    """
    folder = as_path("load", "folder", folder, "the path of a result folder")
    run, document = read_run(folder).to_dict(), read_document(folder).to_dict()
    command = run["command"]
    if command == "sweep":
        return load_sweep(folder, run, document)
    study = _STUDIES[command]
    return study(
        document=document,
        series=tuple(read_predictions(folder / PREDICTIONS)),
        run=run,
        files=saved_files(folder, run, study.document_name),
        reason=_reason(run, document),
    )


def _reason(run: Mapping[str, Any], document: Mapping[str, Any]) -> str:
    """Why a study did not succeed, from its record; empty if it did."""
    if not run["exit_code"]:
        return ""
    # Folders of earlier versions have no reason.
    return run.get("reason") or "; ".join(document.get("problems", ())) or str(run.get("text") or "interrupted")
