"""``smajax compare``: material laws and input-output models on one recording, by the command line."""

import dataclasses
import json
import math
import shutil
import threading

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.comparison import compare
from smajax.comparison.driving_input import changing_inputs
from smajax.comparison.material_models import with_material_law
from smajax.comparison.model_result import ModelResult
from smajax.comparison.ranking import rank_models
from smajax.comparison.scores import fit_percent
from smajax.errors import Cancelled, InputError
from smajax.files.rig_file import read_rig
from smajax.fitting.io_models.fit import IOModelFit
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from tests.conftest import ROOT
from tests.support import plants

FOLDER = ROOT / "data" / "recordings" / "dead-weight"


@pytest.fixture(scope="module")
def short(tmp_path_factory):
    """The shipped dead-weight rig with every eighth row of the first 90 s, for fast fits."""
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
    """Run ``smajax compare`` on the recordings of a folder."""
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


@pytest.mark.slow
def test_models_are_ranked_by_their_predictions(short, tmp_path):
    result = run(short, "brinson,transfer-function-one-pole,bouc-wen", tmp_path / "out")
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "compare.json").read_text())
    names = [m["name"] for m in document["models"]]
    assert names[0] == "brinson" and set(names) == {"brinson", "transfer-function-one-pole", "bouc-wen"}
    errors = [m["rmse_holdout"] for m in document["models"]]
    assert errors == sorted(errors) and document["unit"] == "mm" and errors[0] < 0.3 * errors[1]
    for m in document["models"]:
        assert m["fit_percent_holdout"] < 100.0 and m["parameters"] > 3 and np.isfinite(m["bic"]) and m["wall_s"] > 0.0
        free = [p for p in m["fitted"].values() if p["free"]]
        assert (
            len(free) == m["parameters"]
            and sum(p["lower95"] is not None and p["lower95"] < p["value"] for p in free) > 3
        )
        line = f"{m['name']}: at its bound: {', '.join(m['at_bound'])}"
        assert (line in result.output) is bool(m["at_bound"])
    assert "brinson predicts the holdout best" in result.output
    page = (tmp_path / "out" / "report.html").read_text()
    assert "transfer-function-one-pole" in page and "Fitted parameters" in page and "<td>delay</td>" in page
    again = CliRunner().invoke(app, ["report", str(tmp_path / "out")])
    assert again.exit_code == 0 and (tmp_path / "out" / "report.html").read_text() == page


@pytest.mark.slow
def test_parameters_at_a_bound_are_listed(short, tmp_path):
    """A law with bounds that exclude the true value, and a displacement that precedes its input."""
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
    result = run(tmp_path, "brinson,transfer-function-one-pole", tmp_path / "out")
    assert result.exit_code == 0, result.output
    at_bounds = {
        m["name"]: m["at_bound"] for m in json.loads((tmp_path / "out" / "compare.json").read_text())["models"]
    }
    assert {"heat.h0 (100 W/m^2/K)", "heat.h0 (101 W/m^2/K)"} & set(at_bounds["brinson"])
    assert "delay (0)" in at_bounds["transfer-function-one-pole"]
    page = (tmp_path / "out" / "report.html").read_text()
    for name, at_bound in at_bounds.items():
        assert f"{name}: at its bound: {', '.join(at_bound)}" in result.output and f"{name}: at its bound: " in page


@pytest.mark.slow
def test_model_that_diverges_is_left_out(short, tmp_path, monkeypatch):
    respond = IOModelFit.respond

    def diverge(self, series):
        values = respond(self, series)
        return (
            np.where(series.time > 50.0, np.nan, values)
            if self.spec.name == "bouc-wen" and "holdout" in series.name
            else values
        )

    monkeypatch.setattr(IOModelFit, "respond", diverge)
    result = run(short, "bouc-wen,transfer-function-one-pole", tmp_path / "out")
    assert result.exit_code == 0, result.output
    models = {m["name"]: m for m in json.loads((tmp_path / "out" / "compare.json").read_text())["models"]}
    assert "holdout.csv: its prediction of displacement is not finite at" in models["bouc-wen"]["why"]
    assert models["bouc-wen"]["rmse_holdout"] is None and models["transfer-function-one-pole"]["rmse_holdout"] > 0.0
    assert "Left out: bouc-wen" in result.output


@pytest.mark.slow
@pytest.mark.parametrize("law", ["transfer-function-two-poles", "hammerstein-wiener"])
def test_rows_of_another_step_are_resampled_for_discrete_models(short, tmp_path, law):
    """Every other row of the holdout, with stamps that jitter by a tenth of a row: scored as with all rows, with a note."""
    rig, rng = read_rig(short / "rig.toml"), np.random.default_rng(0)
    r = rig.read(short / "holdout.csv")
    time = (r.time + 0.1 * np.median(np.diff(r.time)) * rng.uniform(-1.0, 1.0, len(r)))[::2]
    channels = {c: np.interp(time, r.time, v) for c, v in r.channels.items()}
    Recording.from_arrays("holdout", time, channels, {"displacement": "mm"}).write(tmp_path / "holdout.csv")
    for name in ("rig.toml", "train.csv"):
        (tmp_path / name).write_bytes((short / name).read_bytes())
    errors = []
    for folder in (short, tmp_path):
        result = run(folder, law, tmp_path / f"out{len(errors)}")
        assert result.exit_code == 0, result.output
        (model,) = json.loads((tmp_path / f"out{len(errors)}" / "compare.json").read_text())["models"]
        errors.append(model["rmse_holdout"])
        assert bool(model["note"]) is (folder is tmp_path)
    assert "holdout.csv resampled for it" in result.output
    assert errors[1] == pytest.approx(errors[0], rel=0.1)


@pytest.mark.slow
def test_parameters_that_few_rows_do_not_determine_are_listed(short, tmp_path):
    """Twelve rows in which the wire is only heated, and fewer rows than there are parameters."""
    for name in ("rig.toml", "holdout.csv"):
        shutil.copy(short / name, tmp_path)
    rows = (short / "train.csv").read_text().splitlines()
    (tmp_path / "train.csv").write_text("\n".join(rows[:13]))
    result = run(tmp_path, "brinson", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "brinson: not determined by the training recording: material.martensite_shift" in result.output
    (tmp_path / "train.csv").write_text("\n".join(rows[:6]))
    result = run(tmp_path, "brinson", tmp_path / "more")
    assert result.exit_code == 2
    assert "train.csv: 5 measured rows do not determine the 6 parameters of brinson: record more rows" in result.output


def test_fit_does_not_depend_on_the_sign_of_the_sensor(short, tmp_path):
    """Bouc-Wen's law for the distance to the weight, which falls as the wire contracts: the same fit with another sign."""
    for part in ("train", "holdout"):
        r = read_rig(short / "rig.toml").read(short / f"{part}.csv")
        away = 0.012 - r.channels["displacement"]
        Recording.from_arrays(part, r.time, {**r.channels, "displacement": away}, {"displacement": "mm"}).write(
            tmp_path / f"{part}.csv"
        )
    (tmp_path / "rig.toml").write_text((short / "rig.toml").read_text())
    models = []
    for folder in (short, tmp_path):
        out = tmp_path / f"out-{folder.name}"
        assert run(folder, "bouc-wen", out).exit_code == 0
        models.append(json.loads((out / "compare.json").read_text())["models"][0])
    assert models[1]["rmse_train"] == pytest.approx(models[0]["rmse_train"], rel=1e-3)
    contraction, distance = (model["fitted"] for model in models)
    assert distance["rest"]["value"] == pytest.approx(0.012 - contraction["rest"]["value"], abs=2e-5)
    assert distance["kw"]["value"] == pytest.approx(-contraction["kw"]["value"], rel=2e-2)


@pytest.mark.slow
def test_law_without_a_free_offset_has_a_note(short, tmp_path):
    """A displacement with an offset of 0.4 mm, fitted with the sensor's offset held and free."""
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
        result = run(tmp_path, "brinson,transfer-function-one-pole", tmp_path / name)
        assert result.exit_code == 0, result.output
        assert ("and brinson none: free sensor.displacement_offset" in result.output) is (name == "held")
        model = {m["name"]: m for m in json.loads((tmp_path / name / "compare.json").read_text())["models"]}["brinson"]
        errors.append(model["rmse_holdout"])
    assert errors[1] < errors[0] and model["fitted"]["sensor.displacement_offset"]["value"] > 0.0


@pytest.mark.slow
def test_ridge_penalty_of_a_network_is_noted(short, tmp_path):
    result = run(short, "narx", tmp_path / "out")
    assert result.exit_code == 0, result.output
    assert "its weights have a ridge penalty of " in result.output
    assert "chosen by cross-validation on quarters of train.csv" in result.output
    (model,) = json.loads((tmp_path / "out" / "compare.json").read_text())["models"]
    assert model["fit_percent_holdout"] > 0.0  # better than the mean


def test_no_model_is_best_if_none_is_better_than_the_mean(short, tmp_path):
    """A sensor with a tenth of the gain and another offset in the holdout."""
    for name in ("rig.toml", "train.csv"):
        shutil.copy(short / name, tmp_path)
    r = read_rig(short / "rig.toml").read(short / "holdout.csv")
    read = 5e-3 + 0.1 * r.channels["displacement"]
    Recording.from_arrays("holdout", r.time, {**r.channels, "displacement": read}, {"displacement": "mm"}).write(
        tmp_path / "holdout.csv"
    )
    result = run(tmp_path, "transfer-function-one-pole,bouc-wen", tmp_path / "out")
    output = " ".join(result.output.split())
    assert result.exit_code == 0, result.output
    assert (
        "No model predicts the holdout better than the mean of the holdout does; the smallest error is that of"
        in output
    )
    assert "holdout best" not in output and "By BIC" not in output


@pytest.mark.parametrize(
    ("models", "sentence"),
    [
        ("brinsen", "'brinsen' is not known (did you mean 'brinson'?)"),
        (" , ", "models names no model"),
        ("", "models names no model"),
    ],
)
def test_unknown_models_are_rejected(short, tmp_path, models, sentence):
    result = run(short, models, tmp_path / "out")
    assert result.exit_code == 2 and sentence in result.output and not (tmp_path / "out").exists()


def test_same_recording_twice_is_rejected(short, tmp_path):
    words = [str(short / name) for name in ("rig.toml", "train.csv")]
    (tmp_path / "copy.csv").write_text((short / "train.csv").read_text() + "\n")
    result = CliRunner().invoke(
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
    assert result.exit_code == 2 and "not an independent test" in result.output


def test_training_recording_without_input_is_rejected(short, tmp_path):
    (tmp_path / "rig.toml").write_bytes((short / "rig.toml").read_bytes())
    (tmp_path / "holdout.csv").write_bytes((short / "holdout.csv").read_bytes())
    r = read_rig(short / "rig.toml").read(short / "train.csv")
    still = r.channels | {"current": np.zeros(len(r))}
    Recording.from_arrays("train", r.time, still, {"displacement": "mm"}).write(tmp_path / "train.csv")
    result = run(tmp_path, "transfer-function-one-pole", tmp_path / "out")
    assert result.exit_code == 2 and "current is 0 in all rows of train.csv" in result.output


def rotary(folder, overlap: float) -> None:
    """Write rows of the shipped rotary rig; the second wire is on as well for ``overlap`` s of each first wire's pulse."""
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


@pytest.mark.slow
def test_two_alternating_wires_are_one_input(tmp_path):
    rotary(tmp_path, 0.0)
    result = run(tmp_path, "bouc-wen,transfer-function-one-pole,heating-cooling", tmp_path / "out")
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "compare.json").read_text())
    assert len(document["models"]) == 3 and "heating-cooling takes one wire" in document["models"].pop()["why"]
    for m in document["models"]:
        assert (
            not m["why"] and "its input is current_1 less current_2" in m["note"] and m["fit_percent_train"] > 10.0
        ), m


def test_two_wires_that_pull_together_are_rejected(tmp_path):
    rotary(tmp_path, 1.0)
    result = run(tmp_path, "bouc-wen", tmp_path / "out")
    output = " ".join(result.output.split())
    assert (
        result.exit_code == 2
        and "current_1 and current_2 change: both are on at" in output
        and "let the wires pull by turns" in output
    )


def test_observed_channels_that_are_not_compared_are_noted(short, tmp_path):
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
    result = run(tmp_path, "transfer-function-one-pole", tmp_path / "out")
    output = " ".join(result.output.split())
    assert (
        result.exit_code == 0
        and "Only displacement is compared: the material laws are fitted to temperature as well" in output
    )


def test_input_that_varies_by_noise_only_is_constant():
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


def test_material_law_keeps_common_parameters():
    rig = read_rig(FOLDER / "rig.toml")
    changed = with_material_law(rig, "lagoudas")
    assert float(changed.plant.material.max_transformation_strain) == float(
        rig.plant.material.max_transformation_strain
    )
    assert {"material.n1", "heat.h0"} <= set(changed.fit.free) and changed.fit.model == "lagoudas"
    back = with_material_law(changed, "brinson")
    assert "material.n1" not in back.fit.free and float(back.plant.material.detwinning_finish_stress) == 1e8
    assert with_material_law(rig, "brinson") is rig


def test_fit_percent_is_that_of_matlab():
    y = np.array([0.0, 1.0, 2.0, 3.0])
    assert fit_percent(y, y) == 100.0
    assert fit_percent(y, np.full(4, 1.5)) == pytest.approx(0.0)
    assert fit_percent(np.append(y, np.nan), np.append(y, 7.0)) == 100.0


def _result(name: str, error: float, reason: str = "") -> ModelResult:
    predictions = () if reason else (np.arange(10.0), np.arange(10.0) + error)
    return ModelResult(name, "input-output", 2, predictions, reason=reason)


def test_models_are_ranked_by_the_holdout_and_failed_ones_come_last():
    recordings = [plants.recording({"displacement": np.arange(10.0)}, np.arange(10.0))] * 2
    results = [_result("a", 0.3), _result("b", 0.0, "it failed"), _result("c", 0.1), _result("d", math.nan)]
    ranked = rank_models(results, recordings, "displacement")
    assert [model.result.name for model in ranked] == ["c", "a", "b", "d"]
    assert ranked[0].scores is not None and ranked[0].scores.rmse[1] == pytest.approx(0.1)
    assert ranked[2].scores is None


@pytest.mark.parametrize("signal", [KeyboardInterrupt, StopIteration])
def test_a_comparison_that_is_stopped_has_the_models_before(signal, monkeypatch):
    def stop(name):
        if name == stopped_at:
            raise signal

    monkeypatch.setattr(compare, "_fit_model", lambda rig, name, *_: _result(name, 0.1))
    rig = read_rig(data_path("recordings", "dead-weight") / "rig.toml")
    stopped_at = "c"
    results = compare.compare_models(rig, ["a", "b", "c", "d"], [], seed=0, progress=stop)
    assert [result.name for result in results] == ["a", "b"]
    stopped_at = "a"
    with pytest.raises(Cancelled, match="before a model was fitted"):
        compare.compare_models(rig, ["a", "b"], [], seed=0, progress=stop)


def test_models_are_fitted_one_per_core(monkeypatch):
    """Each of two waits for the other; a third that is cancelled ends the comparison."""
    barrier = threading.Barrier(2)

    def fit_stub(rig, name, *_):
        if name == "c":
            raise Cancelled("stopped")
        barrier.wait(60.0)
        return _result(name, 0.1)

    monkeypatch.setattr(compare, "_fit_model", fit_stub)
    monkeypatch.setattr("smajax.numerics.ensemble.count_cores", lambda: 2)
    rig, reported = read_rig(data_path("recordings", "dead-weight") / "rig.toml"), []
    results = compare.compare_models(rig, ["a", "b", "c"], [], seed=0, progress=reported.append)
    assert [result.name for result in results] == ["a", "b"] and reported == ["a", "b", "c"]


def test_a_reason_that_models_share_is_said_once(monkeypatch):
    rig = read_rig(data_path("recordings", "dead-weight") / "rig.toml")
    recording = rig.read(data_path("recordings", "dead-weight") / "train.csv").slice(0.0, 2.0)
    idle = dataclasses.replace(
        recording, channels={**recording.channels, "current": np.zeros_like(recording.channels["current"])}
    )
    with pytest.raises(InputError) as caught:
        compare.compare_models(rig, ["bouc-wen", "narx"], [idle, idle], seed=0)
    reason = "takes one input that changes, and here no input changes: vary one"
    assert str(caught.value) == f"no model could be fitted: bouc-wen, narx: {reason}"

    # What one model says of itself stays as it is, also where the sentence begins with its name.
    def refuse(rig, name, *_):
        raise InputError(f"{name} has no start value of material.n1: give it a default")

    monkeypatch.setattr(compare, "fit_input_output_model", refuse)
    with pytest.raises(InputError) as caught:
        compare.compare_models(rig, ["bouc-wen"], [recording, recording], seed=0)
    assert str(caught.value).endswith("bouc-wen: bouc-wen has no start value of material.n1: give it a default")
