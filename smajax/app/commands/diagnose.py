"""A diagnosis into a result folder, with the last parameter values where it fails."""

from functools import partial
from pathlib import Path
from typing import Any

from smajax.api.diagnose import DiagnosisStudy, diagnose
from smajax.app.command_line.run import argv
from smajax.errors import NumericsError
from smajax.files.result_folder import check_output_folder
from smajax.report.documents import write_result


def diagnose_into(out: Path, *recordings: Any, **options: Any) -> DiagnosisStudy:
    """Diagnose a rig, and write the result folder.

    Args:
        out: The result folder.
        *recordings: Rig file and training recording.
        **options: Keyword arguments of ``smajax.api.diagnose.diagnose``.

    Raises:
        InputError: If a file, a recording or the folder cannot be used.
        NumericsError: If the diagnosis fails; the folder then has ``rig-last.toml`` if there are last values.
    """
    check_output_folder(out)
    try:
        study = diagnose(*recordings, **options)
    except NumericsError as error:
        if not error.rig:
            raise
        write_result(out, error.run | {"argv": argv()}, partial(_write_last, error.rig))
        last = check_output_folder(out) / "rig-last.toml"
        raise NumericsError(f"{error}; the last parameter values are saved in {last}", error.state) from None
    study.save(out, argv=argv())
    return study


def _write_last(text: str, folder: Path) -> None:
    (folder / "rig-last.toml").write_text(text, "utf-8")
