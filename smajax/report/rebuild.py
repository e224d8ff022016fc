"""Report of a finished run, built again from the files in its folder without a simulation."""

from pathlib import Path
from typing import Any

from smajax.errors import InputError
from smajax.files.result_folder import read_json, replace_file
from smajax.report.comparison import comparison_page
from smajax.report.diagnosis_page import diagnosis_page
from smajax.report.prediction import read_predictions
from smajax.report.run_pages import fit_page, simulation_page
from smajax.report.sweep import sweep_page
from smajax.report.tuning import tuning_page
from smajax.sweeps.table import read_table


def rebuild_report(folder: Path) -> Path:
    """Build report.html of a result folder again.

    Folders of earlier versions of smajax are readable as well: their documents have the same keys.

    Args:
        folder: The result folder.

    Returns:
        The path of the page.

    Raises:
        InputError: If a file of the folder is missing or damaged.
    """
    run = read_json(folder, "run.json")
    try:
        page = _build_page(folder, run)
    except OSError as error:
        raise InputError(
            f"{folder / 'rig.toml'}: the file cannot be read ({error.strerror or error}): run the command again"
        ) from None
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(
            f"{folder}: its files are not in the format of this version of smajax ({error}): run the command again"
        ) from None
    replace_file(folder / "report.html", page)
    return folder / "report.html"


def _build_page(folder: Path, run: dict[str, Any]) -> str:
    command = run.get("command")
    if command == "sweep":
        rig = (folder / "rig.toml").read_text("utf-8")
        return sweep_page(read_json(folder, "sweep.json"), read_table(folder / "sweep.parquet"), run, rig)
    series = read_predictions(folder / "prediction.csv")
    rig = (folder / "rig.toml").read_text("utf-8")
    if command == "simulate":
        return simulation_page(series[0], run, rig)
    if command == "diagnose":
        return diagnosis_page(read_json(folder, "diagnosis.json"), series, run["inputs"], run, rig)
    if command == "tune":
        return tuning_page(read_json(folder, "tune.json"), series, run, rig)
    if command == "compare":
        return comparison_page(read_json(folder, "compare.json"), series, run, rig)
    return fit_page(read_json(folder, "fit.json"), series, run, rig)
