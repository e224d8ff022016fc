"""``smajax compare``: laws and input-output laws on one recording, by the command as a user types it."""

import json
import shutil

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.comparison.driving_input import changing_inputs
from smajax.comparison.material_models import with_material_law
from smajax.comparison.scores import fit_percent
from smajax.files.rig_file import read_rig
from smajax.fitting.io_models.fit import IOModelFit
from smajax.recordings.recording import Recording
from tests.conftest import ROOT

FOLDER = ROOT / "data" / "recordings" / "dead-weight"


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The shipped dead weight, a row in eight of its first 90 s, so that it fits fast."""
    folder = tmp_path_factory.mktemp("short")
    text = (FOLDER / "rig.toml").read_text().replace("starts = 4", "starts = 1")
    (folder / "rig.toml").write_text(text)
    rig = read_rig(folder / "rig.toml")
    for part in ("train", "holdout"):
        r = rig.read(FOLDER / f"{part}.csv")
        channels = {c: v[:4500:8] for c, v in r.channels.items()}
        Recording.from_arrays(part, r.time[:4500:8], channels, {"displacement": "mm"}).write(folder / f"{part}.csv")
    return folder


def run(folder, models, out, *more, rig="rig.toml"):
    words = [
        "compare",
        str(folder / rig),
        str(folder / "train.csv"),
        "--holdout",
        str(folder / "holdout.csv"),
        "--models",
        models,
    ]
    return CliRunner().invoke(app, [*words, "--out", str(out), *more])


def test_models_are_ranked_by_what_they_predict(short, tmp_path):
    done = run(short, "brinson,transfer-function-one-pole,bouc-wen", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "compare.json").read_text())
    names = [m["name"] for m in found["models"]]
    assert names[0] == "brinson" and set(names) == {"brinson", "transfer-function-one-pole", "bouc-wen"}
    errors = [m["rmse_holdout"] for m in found["models"]]
    assert errors == sorted(errors) and found["unit"] == "mm" and errors[0] < 0.3 * errors[1]
    for m in found["models"]:
        assert m["fit_percent_holdout"] < 100.0 and m["parameters"] > 3 and np.isfinite(m["bic"]) and m["wall_s"] > 0.0
        free = [p for p in m["fitted"].values() if p["free"]]
        assert (
            len(free) == m["parameters"]
            and sum(p["lower95"] is not None and p["lower95"] < p["value"] for p in free) > 3
        )
        told = f"{m['name']}: at its bound: {', '.join(m['at_bound'])}"
        assert (told in done.output) is bool(m["at_bound"])
    assert "brinson predicts the holdout best" in done.output
    page = (tmp_path / "out" / "report.html").read_text()
    assert "transfer-function-one-pole" in page and "Fitted parameters" in page and "<td>delay</td>" in page
    again = CliRunner().invoke(app, ["report", str(tmp_path / "out")])
    assert again.exit_code == 0 and (tmp_path / "out" / "report.html").read_text() == page


def test_what_ends_at_its_bound_is_said_of_laws_and_of_operators(short, tmp_path):
    """A law that has no room for the truth, and a displacement that answers before it is asked."""
    text = (
        (short / "rig.toml")
        .read_text()
        .replace("[fit]", '[fit]\nbounds = {"heat.h0" = ["100 W/m^2/K", "101 W/m^2/K"]}')
    )
    (tmp_path / "rig.toml").write_text(text)
    for part in ("train", "holdout"):
        r = read_rig(short / "rig.toml").read(short / f"{part}.csv")
        early = np.interp(r.time + 0.5, r.time, r.channels["displacement"])
        Recording.from_arrays(part, r.time, {**r.channels, "displacement": early}, {"displacement": "mm"}).write(
            tmp_path / f"{part}.csv"
        )
    done = run(tmp_path, "brinson,transfer-function-one-pole", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = {m["name"]: m["at_bound"] for m in json.loads((tmp_path / "out" / "compare.json").read_text())["models"]}
    assert {"heat.h0 (100 W/m^2/K)", "heat.h0 (101 W/m^2/K)"} & set(found["brinson"])
    assert "delay (0)" in found["transfer-function-one-pole"]
    page = (tmp_path / "out" / "report.html").read_text()
    for name, told in found.items():
        assert f"{name}: at its bound: {', '.join(told)}" in done.output and f"{name}: at its bound: " in page


def test_a_model_that_runs_away_is_left_out_and_the_others_are_ranked(short, tmp_path, monkeypatch):
    honest = IOModelFit.respond

    def runs_away(self, series):
        found = honest(self, series)
        return (
            np.where(series.time > 50.0, np.nan, found)
            if self.spec.name == "bouc-wen" and "holdout" in series.name
            else found
        )

    monkeypatch.setattr(IOModelFit, "respond", runs_away)
    done = run(short, "bouc-wen,transfer-function-one-pole", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = {m["name"]: m for m in json.loads((tmp_path / "out" / "compare.json").read_text())["models"]}
    assert "holdout.csv: its prediction of displacement is not finite at" in found["bouc-wen"]["why"]
    assert found["bouc-wen"]["rmse_holdout"] is None and found["transfer-function-one-pole"]["rmse_holdout"] > 0.0
    assert "Left out: bouc-wen" in done.output


@pytest.mark.parametrize("law", ["transfer-function-two-poles", "hammerstein-wiener"])
def test_rows_of_another_step_are_resampled_for_laws_that_go_row_by_row(short, tmp_path, law):
    """Every other row of the holdout, with stamps that jitter by a tenth of a row: scored as with all rows, and told."""
    rig, rng = read_rig(short / "rig.toml"), np.random.default_rng(0)
    r = rig.read(short / "holdout.csv")
    time = (r.time + 0.1 * np.median(np.diff(r.time)) * rng.uniform(-1.0, 1.0, len(r)))[::2]
    channels = {c: np.interp(time, r.time, v) for c, v in r.channels.items()}
    Recording.from_arrays("holdout", time, channels, {"displacement": "mm"}).write(tmp_path / "holdout.csv")
    for name in ("rig.toml", "train.csv"):
        (tmp_path / name).write_bytes((short / name).read_bytes())
    errors = []
    for folder in (short, tmp_path):
        done = run(folder, law, tmp_path / f"out{len(errors)}")
        assert done.exit_code == 0, done.output
        (model,) = json.loads((tmp_path / f"out{len(errors)}" / "compare.json").read_text())["models"]
        errors.append(model["rmse_holdout"])
        assert bool(model["note"]) is (folder is tmp_path)
    assert "holdout.csv resampled for it" in done.output
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


def test_what_few_rows_do_not_tell_is_said(short, tmp_path):
    """Twelve rows, in which the wire is heated only, and fewer than there are parameters."""
    for name in ("rig.toml", "holdout.csv"):
        shutil.copy(short / name, tmp_path)
    rows = (short / "train.csv").read_text().splitlines()
    (tmp_path / "train.csv").write_text("\n".join(rows[:13]))
    done = run(tmp_path, "brinson", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "brinson: not determined by the training recording: material.martensite_shift" in done.output
    (tmp_path / "train.csv").write_text("\n".join(rows[:6]))
    done = run(tmp_path, "brinson", tmp_path / "more")
    assert done.exit_code == 2
    assert "train.csv: 5 measured rows do not determine the 6 parameters of brinson: record more rows" in done.output


def test_a_sensor_that_reads_from_elsewhere_costs_a_law_nothing(short, tmp_path):
    """Bouc-Wen's law for the distance to the weight, which gets less as the wire contracts: the fit to the contraction, turned over."""
    for part in ("train", "holdout"):
        r = read_rig(short / "rig.toml").read(short / f"{part}.csv")
        away = 0.012 - r.channels["displacement"]
        Recording.from_arrays(part, r.time, {**r.channels, "displacement": away}, {"displacement": "mm"}).write(
            tmp_path / f"{part}.csv"
        )
    (tmp_path / "rig.toml").write_text((short / "rig.toml").read_text())
    ends = []
    for folder in (short, tmp_path):
        out = tmp_path / f"out-{folder.name}"
        assert run(folder, "bouc-wen", out).exit_code == 0
        ends.append(json.loads((out / "compare.json").read_text())["models"][0])
    assert ends[1]["rmse_train"] == pytest.approx(ends[0]["rmse_train"], rel=1e-3)
    one, other = (e["fitted"] for e in ends)
    assert other["rest"]["value"] == pytest.approx(0.012 - one["rest"]["value"], abs=2e-5)
    assert other["kw"]["value"] == pytest.approx(-one["kw"]["value"], rel=2e-2)


def test_a_law_without_the_constant_of_the_others_says_so(short, tmp_path):
    """A displacement that reads 0.4 mm too much: what a law whose offset is held cannot know, it can where the offset is free."""
    for part in ("train", "holdout"):
        r = read_rig(short / "rig.toml").read(short / f"{part}.csv")
        shifted = r.channels["displacement"] + 4e-4
        Recording.from_arrays(part, r.time, {**r.channels, "displacement": shifted}, {"displacement": "mm"}).write(
            tmp_path / f"{part}.csv"
        )
    text = (short / "rig.toml").read_text()
    errors = []
    for name, changed in (("held", text), ("free", text.replace("free = [", 'free = ["sensor.displacement_offset", '))):
        (tmp_path / "rig.toml").write_text(changed)
        done = run(tmp_path, "brinson,transfer-function-one-pole", tmp_path / name)
        assert done.exit_code == 0, done.output
        assert ("and brinson none: free sensor.displacement_offset" in done.output) is (name == "held")
        found = {m["name"]: m for m in json.loads((tmp_path / name / "compare.json").read_text())["models"]}["brinson"]
        errors.append(found["rmse_holdout"])
    assert errors[1] < errors[0] and found["fitted"]["sensor.displacement_offset"]["value"] > 0.0


def test_what_holds_a_network_is_said(short, tmp_path):
    done = run(short, "narx", tmp_path / "out")
    assert done.exit_code == 0, done.output
    assert "chosen by cross-validation on quarters of train.csv, holds its weights" in done.output
    (found,) = json.loads((tmp_path / "out" / "compare.json").read_text())["models"]
    assert found["fit_percent_holdout"] > 0.0  # better than the mean


def test_where_no_model_is_better_than_the_mean_none_is_called_best(short, tmp_path):
    """A sensor that reads ten times less in the holdout, about another level."""
    for name in ("rig.toml", "train.csv"):
        shutil.copy(short / name, tmp_path)
    r = read_rig(short / "rig.toml").read(short / "holdout.csv")
    read = 5e-3 + 0.1 * r.channels["displacement"]
    Recording.from_arrays("holdout", r.time, {**r.channels, "displacement": read}, {"displacement": "mm"}).write(
        tmp_path / "holdout.csv"
    )
    done = run(tmp_path, "transfer-function-one-pole,bouc-wen", tmp_path / "out")
    told = " ".join(done.output.split())
    assert done.exit_code == 0, done.output
    assert "No model predicts the holdout better than the mean of the holdout does; the smallest error has" in told
    assert "holdout best" not in told and "By BIC" not in told


@pytest.mark.parametrize(
    ("models", "sentence"),
    [
        ("brinsen", "'brinsen' is not known (did you mean 'brinson'?)"),
        (" , ", "--models names no model"),
        ("", "--models names no model"),
    ],
)
def test_what_cannot_be_compared_is_said(short, tmp_path, models, sentence):
    done = run(short, models, tmp_path / "out")
    assert done.exit_code == 2 and sentence in done.output and not (tmp_path / "out").exists()


def test_the_same_recording_twice_tests_nothing(short, tmp_path):
    words = [str(short / name) for name in ("rig.toml", "train.csv")]
    (tmp_path / "copy.csv").write_text((short / "train.csv").read_text() + "\n")
    done = CliRunner().invoke(
        app,
        [
            "compare",
            *words,
            "--holdout",
            str(tmp_path / "copy.csv"),
            "--models",
            "brinson",
            "--out",
            str(tmp_path / "out"),
        ],
    )
    assert done.exit_code == 2 and "tests nothing" in done.output


def test_a_training_recording_that_is_never_driven_tells_nothing(short, tmp_path):
    (tmp_path / "rig.toml").write_bytes((short / "rig.toml").read_bytes())
    (tmp_path / "holdout.csv").write_bytes((short / "holdout.csv").read_bytes())
    r = read_rig(short / "rig.toml").read(short / "train.csv")
    still = r.channels | {"current": np.zeros(len(r))}
    Recording.from_arrays("train", r.time, still, {"displacement": "mm"}).write(tmp_path / "train.csv")
    done = run(tmp_path, "transfer-function-one-pole", tmp_path / "out")
    assert done.exit_code == 2 and "current is 0 in all rows of train.csv" in done.output


def rotary(folder, overlap: float) -> None:
    """The shipped pair of wires, some rows of it; for ``overlap`` s of each pulse of the first wire the second one is on, too."""
    rig = read_rig(ROOT / "data" / "recordings" / "rotary" / "rig.toml")
    recording = rig.read(ROOT / "data" / "recordings" / "rotary" / "train.csv")
    for name, rows in (("train", slice(0, 1200, 4)), ("holdout", slice(1200, 2400, 4))):
        channels, time = {c: v[rows] for c, v in recording.channels.items()}, recording.time[rows]
        both = (
            np.convolve(channels["current_1"] > 0.0, np.ones(int(overlap / (time[1] - time[0])) + 1))[: len(time)] > 0.0
        )
        second = np.where(channels["current_1"] > 0.0, 0.0, channels["current_2"])
        channels["current_2"] = np.where(both & (overlap > 0.0), 0.2, second)
        Recording.from_arrays(name, time, channels, recording.units).write(folder / f"{name}.csv")
    (folder / "rig.toml").write_text((ROOT / "data" / "recordings" / "rotary" / "rig.toml").read_text())


def test_two_wires_that_pull_by_turns_are_one_input(tmp_path):
    rotary(tmp_path, 0.0)
    done = run(tmp_path, "bouc-wen,transfer-function-one-pole,heating-cooling", tmp_path / "out")
    assert done.exit_code == 0, done.output
    found = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert len(found["models"]) == 3 and "heating-cooling takes one wire" in found["models"].pop()["why"]
    for m in found["models"]:
        assert (
            not m["why"] and "its input is current_1 less current_2" in m["note"] and m["fit_percent_train"] > 10.0
        ), m


def test_two_wires_that_pull_together_leave_operators_out_and_it_says_why(tmp_path):
    rotary(tmp_path, 1.0)
    done = run(tmp_path, "bouc-wen", tmp_path / "out")
    told = " ".join(done.output.split())
    assert (
        done.exit_code == 2
        and "current_1 and current_2 change: both are on at" in told
        and "let the wires pull by turns" in told
    )


def test_what_is_observed_and_not_compared_is_said(short, tmp_path):
    for part in ("train", "holdout"):
        r = read_rig(short / "rig.toml").read(short / f"{part}.csv")
        warm = 20.0 + 60.0 * (r.channels["current"] > 0.1)
        Recording.from_arrays(part, r.time, r.channels | {"temperature": warm}, {"displacement": "mm"}).write(
            tmp_path / f"{part}.csv"
        )
    text = (short / "rig.toml").read_text()
    assert 'observe = ["displacement"]' in text
    (tmp_path / "rig.toml").write_text(
        text.replace('observe = ["displacement"]', 'observe = ["displacement", "temperature"]')
    )
    done = run(tmp_path, "transfer-function-one-pole", tmp_path / "out")
    told = " ".join(done.output.split())
    assert (
        done.exit_code == 0
        and "Compared is displacement alone: the material laws are fitted to temperature as well" in told
    )


def test_an_input_that_only_scatters_is_held_still():
    rng, time = np.random.default_rng(0), np.arange(500) * 0.1
    noise, turns = rng.standard_normal(500), np.where(np.sin(time) > 0.0, 0.5, 0.0)
    channels = {
        "current_1": turns,
        "current_2": 1e-4 * noise,
        "stress": 150e6 + 5e5 * noise,
        "temperature": 60.0 + 40.0 * np.sin(time),
    }
    recording = Recording.from_arrays("one", time, channels, {})
    assert changing_inputs(["current_1", "current_2"], [recording]) == ["current_1"]
    assert changing_inputs(["temperature", "stress"], [recording]) == ["temperature"]
    assert changing_inputs(["current_2"], [recording]) == ["current_2"]
    assert changing_inputs(["current_1", "temperature"], [recording]) == ["current_1", "temperature"]


def test_a_law_takes_over_what_another_knows():
    rig = read_rig(FOLDER / "rig.toml")
    changed = with_material_law(rig, "lagoudas")
    assert float(changed.plant.material.max_transformation_strain) == float(
        rig.plant.material.max_transformation_strain
    )
    assert {"material.n1", "heat.h0"} <= set(changed.fit.free) and changed.fit.model == "lagoudas"
    back = with_material_law(changed, "brinson")
    assert "material.n1" not in back.fit.free and float(back.plant.material.detwinning_finish_stress) == 1e8
    assert with_material_law(rig, "brinson") is rig


def test_fit_percent_is_matlabs():
    y = np.array([0.0, 1.0, 2.0, 3.0])
    assert fit_percent(y, y) == 100.0
    assert fit_percent(y, np.full(4, 1.5)) == pytest.approx(0.0)
    assert fit_percent(np.append(y, np.nan), np.append(y, 7.0)) == 100.0
