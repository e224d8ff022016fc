"""Diagnoses and tuning studies: saved and loaded again, and saved by the command as from Python."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from typer.testing import CliRunner

import smajax as sma
from smajax.api.diagnose import DiagnosisStudy
from smajax.api.run_record import Clock, run_record
from smajax.api.study import Study
from smajax.api.tune import TuningStudy
from smajax.app.cli import app
from smajax.recordings.datasets import data_path
from smajax.report.prediction import make_series, variant_label
from tests.unit.report.example_documents import EXAMPLES

RIG = data_path("recordings", "dead-weight") / "rig.toml"
CONTROLLER = data_path("controllers", "dead-weight.toml")
# Entries of run.json that depend on the way in which a study was started.
OF_THE_START = ("argv",)


def series(name: str, role: str):
    """Return made predictions."""
    time = 0.1 * np.arange(40)
    channels = {"displacement": 1e-3 * np.sin(time), "current": np.cos(time)}
    model = {"displacement": 1.1e-3 * np.sin(time)}
    return make_series(name, role, time, channels, model, {"displacement": "mm"}, has_clock=True)


def diagnosis() -> DiagnosisStudy:
    """Return a diagnosis without a calculation."""
    roles = [(role, stage) for role in ("train", "select", "holdout") for stage in ("before", "after")]
    text = RIG.read_bytes()
    return DiagnosisStudy(
        document=EXAMPLES["diagnose"],
        series=tuple(series(variant_label(f"{role}.csv", stage), role) for role, stage in roles),
        run=run_record("diagnose", "rig.toml", Clock(), 0, 130) | {"inputs": ["current"]},
        files={"rig.toml": text, "rig-diagnosed.toml": text},
        reason="interrupted",
    )


def tuning() -> TuningStudy:
    """Return a tuning study without a calculation."""
    return TuningStudy(
        document=EXAMPLES["tune"],
        series=(series("start gains", "start"), series("tuned gains", "tuned")),
        run=run_record("tune", "rig.toml", Clock(), 0, 0) | {"controller": "controller.toml"},
        files={"rig.toml": RIG.read_bytes(), "controller.toml": CONTROLLER.read_bytes()},
    )


STUDIES = {"diagnose": diagnosis, "tune": tuning}


def assert_same_files(first: Path, second: Path) -> None:
    """Two result folders have the same files, apart from the way in which they were started."""
    assert {path.name for path in first.iterdir()} == {path.name for path in second.iterdir()}
    for path in first.iterdir():
        if path.name == "run.json":
            runs = [json.loads((folder / path.name).read_text("utf-8")) for folder in (first, second)]
            assert runs[0] | dict.fromkeys(OF_THE_START) == runs[1] | dict.fromkeys(OF_THE_START)
        elif path.name != "report.html":  # which has the command line, too
            assert (second / path.name).read_bytes() == path.read_bytes(), path.name


@pytest.mark.parametrize("command", STUDIES)
def test_a_saved_study_is_loaded_again(command, tmp_path):
    study = STUDIES[command]()
    study.save(tmp_path / "first")
    loaded = sma.load(tmp_path / "first")
    assert type(loaded) is type(study) and str(loaded) == str(study) and repr(loaded) == repr(study)
    assert loaded.document == study.document and loaded.exit_code == study.exit_code and loaded.reason == study.reason
    assert {name: loaded.file_text(name) for name in loaded.files} == {n: study.file_text(n) for n in study.files}
    assert [(s.name, s.role, s.units) for s in loaded.series] == [(s.name, s.role, s.units) for s in study.series]
    for before, after in zip(study.series, loaded.series, strict=True):
        for side in ("measured", "model"):
            for channel, values in getattr(before, side).items():
                np.testing.assert_allclose(getattr(after, side)[channel], values, rtol=1e-6, atol=1e-12)
    loaded.save(tmp_path / "second")
    assert_same_files(tmp_path / "first", tmp_path / "second")
    assert (tmp_path / "first" / "report.html").read_bytes() == (tmp_path / "second" / "report.html").read_bytes()
    assert loaded.plot().to_json() == sma.load(tmp_path / "second").plot().to_json()


@pytest.mark.parametrize("command", STUDIES)
def test_the_command_saves_what_python_returns(command, monkeypatch, tmp_path):
    study, calls = STUDIES[command](), []

    def function(*arguments, progress, **options) -> Study:
        calls.append((arguments, options))
        return study

    place = {"diagnose": "smajax.app.commands.diagnose.diagnose", "tune": "smajax.api.tune.tune"}[command]
    monkeypatch.setattr(place, function)
    words = {
        "diagnose": ["rig.toml", "a.csv", "--select", "b.csv", "--holdout", "c.csv", "--start", "fit.toml", "--laws"],
        "tune": ["rig.toml", "controller.toml"],
    }[command]
    monkeypatch.chdir(tmp_path)
    for name, file in {"rig.toml": RIG, "fit.toml": RIG, "controller.toml": CONTROLLER}.items():
        shutil.copy(file, tmp_path / name)
    for name in ("a.csv", "b.csv", "c.csv"):
        shutil.copy(RIG.with_name("train.csv"), tmp_path / name)
    out = tmp_path / "command"
    result = CliRunner().invoke(app, [command, *words, "--seed", "3", "--out", str(out), "--json"])
    assert result.exit_code == study.exit_code, result.output
    expected = {
        "diagnose": (
            (Path("rig.toml"), Path("a.csv")),
            {
                "select": Path("b.csv"),
                "holdout": Path("c.csv"),
                "start": Path("fit.toml"),
                "seed": 3,
                "laws": True,
                "split": False,
            },
        ),
        "tune": ((Path("rig.toml"), Path("controller.toml")), {"seed": 3}),
    }[command]
    assert calls == [expected]
    study.save(tmp_path / "python")
    assert_same_files(out, tmp_path / "python")
    assert json.loads((out / study.document_name).read_text("utf-8")) == study.document
