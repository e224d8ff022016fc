"""The report of a finished run, made anew from the files in its folder; nothing is simulated."""

from pathlib import Path

from smajax.errors import InputError
from smajax.report import html, prediction
from smajax.report.comparison import comparison_page
from smajax.report.diagnosis import diagnosis_page
from smajax.report.sweep import sweep_page
from smajax.report.tuning import tuning_page
from smajax.results import read_json, replace_file
from smajax.sweep.table import read_table


def rebuild_report(folder: Path) -> Path:
    """Makes report.html anew and returns its path. InputError if the folder's files are not there or not whole."""
    run = read_json(folder, "run.json")
    sweep = run.get("command") == "sweep"
    series = [] if sweep else prediction.read(folder / "prediction.csv")
    try:
        rig = (folder / "rig.toml").read_text("utf-8")
        if run["command"] == "simulate":
            page = html.simulation_page(series[0], run, rig)
        elif run["command"] == "diagnose":
            page = diagnosis_page(read_json(folder, "diagnosis.json"), series, run["inputs"], run, rig)
        elif run["command"] == "tune":
            page = tuning_page(read_json(folder, "tune.json"), series, run, rig)
        elif sweep:
            page = sweep_page(read_json(folder, "sweep.json"), read_table(folder / "sweep.parquet"), run, rig)
        elif run["command"] == "compare":
            page = comparison_page(read_json(folder, "compare.json"), series, run, rig)
        else:
            page = html.fit_page(read_json(folder, "fit.json"), series, run, rig)
    except OSError as error:
        raise InputError(f"{folder / 'rig.toml'}: the file cannot be read ({error.strerror or error}): run the command again") from None
    except (KeyError, TypeError, AttributeError, ValueError) as error:
        if isinstance(error, InputError):
            raise
        raise InputError(f"{folder}: its files are not as this version of smajax writes them ({error}): run the command again") from None
    replace_file(folder / "report.html", page)
    return folder / "report.html"
