"""Load a saved study from its result folder."""

import shutil
from collections.abc import Mapping
from functools import partial
from pathlib import Path
from typing import Any

from smajax.api.compare import ComparisonStudy
from smajax.api.diagnose import DiagnosisStudy
from smajax.api.fit import FitStudy
from smajax.api.predict import PredictionStudy
from smajax.api.properties import PropertiesStudy
from smajax.api.study import PREDICTIONS, REPORT, FileContent, Study
from smajax.api.sweep import load_sweep
from smajax.api.tune import TuningStudy

# TUNE
from smajax.errors import InputError
from smajax.report.documents import read_document, read_run
from smajax.report.prediction import read_predictions

_STUDIES: dict[str, type[Study]] = {
    study.command: study
    for study in (PredictionStudy, FitStudy, DiagnosisStudy, ComparisonStudy, PropertiesStudy, TuningStudy)
}
# Suffixes of files that are kept as text; others are copied when the study is saved again.
_TEXTS = (".toml", ".json", ".h")


def load(folder: str | Path) -> Study:
    """Return the study of a result folder, of this version of smajax or an earlier one.

    Args:
        folder: The folder that ``save`` or a command wrote.

    Raises:
        InputError: If the folder is not a result of smajax, or a file is missing or damaged.
    """
    folder = Path(folder)
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
        reason=str(run.get("text") or "") if run["exit_code"] else "",
    )


def saved_files(folder: Path, run: Mapping[str, Any], document_name: str) -> dict[str, FileContent]:
    """Return the files of a result folder that ``save`` does not build again.

    Args:
        folder: The folder.
        run: The document run.json, which lists the files.
        document_name: Name of the result document.

    Raises:
        InputError: If a file cannot be read.
    """
    built = {"run.json", document_name, PREDICTIONS, REPORT}
    files: dict[str, FileContent] = {}
    for name in run.get("files", []):
        path = folder / str(name)
        if name in built:
            continue
        try:
            files[name] = path.read_bytes() if path.suffix in _TEXTS else partial(_copy, path.resolve(strict=True))
        except OSError as error:
            reason = error.strerror or error
            raise InputError(f"{path}: the file cannot be read ({reason}): run the command again") from None
    return files


def _copy(source: Path, target: Path) -> None:
    shutil.copyfile(source, target)
