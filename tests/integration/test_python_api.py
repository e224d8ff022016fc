"""The public names of smajax: loaded lazily, the same results as the commands, callbacks, saved and loaded studies."""

import ast
import dataclasses
import json
import re
import subprocess
import sys
import threading
import tomllib

import numpy as np
import pytest
from typer.testing import CliRunner

import smajax as sma
from smajax.api.sources import rig_text
from smajax.app.cli import app
from smajax.fitting import multi_start
from tests.conftest import ROOT

DATA = ROOT / "data" / "recordings" / "dead-weight"
ISOBARIC = ROOT / "data" / "recordings" / "isobaric" / "train.csv"
# Entries of a document that differ between two runs of the same calculation.
TIMES = ("wall_s", "compile_s")


def python(code: str, *, folder=ROOT, **environment: str) -> subprocess.CompletedProcess:
    """Run Python code in a new process with the package of the checkout."""
    import os

    clean = {k: v for k, v in os.environ.items() if k not in ("XLA_FLAGS", "EQX_ON_ERROR", "JAX_ENABLE_X64")}
    return subprocess.run(
        [sys.executable, "-c", code],
        cwd=folder,
        env={**clean, "PYTHONPATH": str(ROOT), **environment},
        capture_output=True,
        text=True,
    )


@pytest.mark.parametrize(
    "code",
    [
        "import smajax",
        "import sys; from typer.testing import CliRunner; from smajax.app.cli import app; CliRunner().invoke(app, ['--help'])",
    ],
)
def test_importing_smajax_and_its_help_load_neither_jax_nor_plotly(code):
    probe = (
        f"{code}\nimport sys\nprint([m for m in ('jax', 'equinox', 'plotly', 'numpy', 'scipy') if m in sys.modules])"
    )
    result = python(probe)
    assert result.stdout.strip() == "[]", result.stderr


def test_every_public_name_is_there_once():
    tree = ast.parse((ROOT / "smajax" / "__init__.py").read_text("utf-8"))
    typed = {
        alias.name
        for node in ast.walk(tree)
        if isinstance(node, ast.ImportFrom) and node.module.startswith("smajax.")
        for alias in node.names
    }
    assert typed | {"__version__"} == set(sma.__all__)
    assert all(getattr(sma, name) is not None for name in sma.__all__)
    assert set(sma.__all__) <= set(dir(sma))
    with pytest.raises(AttributeError, match="module 'smajax' has no attribute 'fitt'"):
        sma.fitt  # noqa: B018


def test_the_help_of_the_package_lists_the_public_names_on_its_first_screen():
    lines = sma.__doc__.splitlines()
    listed = set(re.findall(r"``(\w+)``", sma.__doc__))
    assert set(sma.__all__) - {"__version__"} <= listed and len(lines) <= 30


@pytest.mark.slow
@pytest.mark.parametrize("name", sma._SUBPACKAGES)
def test_public_modules_are_attributes_as_the_help_says(name):
    """They cannot be submodules: the top of the package has no folder for them."""
    assert f"``{name}``" in sma.__doc__ and "``from smajax import effects``" in sma.__doc__
    result = python(f"from smajax import {name}; print({name}.__name__)")
    assert result.stdout.strip() == sma._SUBPACKAGES[name], result.stderr


def without_times(document):
    """Return a document without the entries that two runs differ in."""
    if isinstance(document, dict):
        return {k: without_times(v) for k, v in document.items() if k not in TIMES}
    return [without_times(v) for v in document] if isinstance(document, list) else document


@pytest.fixture(scope="module")
def files(tmp_path_factory):
    """Return a folder with a rig and two short recordings."""
    folder = tmp_path_factory.mktemp("files")
    (folder / "rig.toml").write_text((DATA / "rig.toml").read_text("utf-8"), "utf-8")
    for name in ("train.csv", "holdout.csv"):
        lines = (DATA / name).read_text("utf-8").splitlines(keepends=True)
        (folder / name).write_text("".join([lines[0], *lines[1::12]]), "utf-8")
    return folder


@pytest.fixture(scope="module")
def fitted(files):
    """Return a fit from Python."""
    return sma.fit(files / "rig.toml", files / "train.csv", holdout=files / "holdout.csv", starts=1)


def test_a_fit_from_python_is_that_of_the_command(files, fitted, tmp_path):
    words = ["fit", files / "rig.toml", files / "train.csv", "--holdout", files / "holdout.csv", "--starts", "1"]
    result = CliRunner().invoke(app, [*map(str, words), "--out", str(tmp_path / "command"), "--quiet"])
    assert result.exit_code == 0, result.output
    fitted.save(tmp_path / "python")
    documents = [json.loads((tmp_path / k / "fit.json").read_text("utf-8")) for k in ("command", "python")]
    assert without_times(documents[0]) == without_times(documents[1])
    names = {path.name for path in (tmp_path / "command").iterdir()}
    assert names == {path.name for path in (tmp_path / "python").iterdir()}
    for name in ("prediction.csv", "fit.toml", "rig-fitted.toml", "rig.toml"):
        assert (tmp_path / "command" / name).read_bytes() == (tmp_path / "python" / name).read_bytes()


def test_a_fit_tells_its_parameters_summary_and_rig(fitted):
    h0 = fitted.parameters["heat.h0"]
    assert h0.interval[0] < h0.value < h0.interval[1] and h0.unit == "W/m^2/K" and not h0.at_bound
    assert str(fitted) == fitted.summary() and "heat.h0" in str(fitted)
    assert fitted.success and fitted.reason == "" and "Fitted 6 parameters" in repr(fitted)
    assert fitted.rmse["displacement"]["holdout"] > 0.0
    assert float(fitted.rig.plant.heat.h0) == h0.value
    assert "heat.h0" in fitted._repr_html_() and "<script" not in fitted._repr_html_()


def test_a_saved_study_is_loaded_again(fitted, tmp_path):
    fitted.save(tmp_path / "first")
    loaded = sma.load(tmp_path / "first")
    assert isinstance(loaded, sma.FitStudy) and str(loaded) == str(fitted)
    assert loaded.parameters == fitted.parameters
    loaded.save(tmp_path / "second")
    for path in (tmp_path / "first").iterdir():
        if path.name not in ("run.json",):
            assert (tmp_path / "second" / path.name).read_bytes() == path.read_bytes(), path.name


def test_a_folder_that_is_no_result_is_refused(tmp_path):
    with pytest.raises(sma.InputError, match="has no run.json: name one that smajax wrote"):
        sma.load(tmp_path)


def test_a_loaded_study_says_why_it_did_not_succeed(fitted, tmp_path):
    record = {**fitted.run, "exit_code": 130, "text": "interrupted"}
    dataclasses.replace(fitted, run=record, reason="interrupted").save(tmp_path / "stopped")
    loaded = sma.load(tmp_path / "stopped")
    assert loaded.reason == "interrupted" and not loaded.success


def stop_after(step):
    """Return a callback that stops a fit after so many steps."""

    def stop(event):
        if event.step == step:
            raise StopIteration

    return stop


def stop_at_tanaka(event):
    if event.text == "fitting tanaka":
        raise StopIteration


@pytest.mark.slow
@pytest.mark.parametrize(
    ("call", "reason"),
    [
        (
            lambda rig, train, holdout: sma.fit(rig, train, starts=2, progress=stop_after(3)),
            "interrupted with the best point so far",
        ),
        (
            lambda rig, train, holdout: sma.compare(
                rig, train, holdout=holdout, models=["transfer-function-one-pole", "tanaka"], progress=stop_at_tanaka
            ),
            "interrupted: tanaka not compared",
        ),
    ],
)
def test_a_study_that_was_stopped_has_the_same_reason_after_loading(call, reason, files, tmp_path):
    study = call(files / "rig.toml", files / "train.csv", files / "holdout.csv")
    study.save(tmp_path / "stopped")
    loaded = sma.load(tmp_path / "stopped")
    assert (study.reason, study.exit_code) == (loaded.reason, loaded.exit_code) == (reason, 130)
    assert json.loads((tmp_path / "stopped" / "run.json").read_text("utf-8"))["reason"] == reason


@pytest.mark.slow
@pytest.mark.parametrize("text", ["tuning: ", "checking"])
def test_a_tuning_that_is_stopped_is_saved_with_the_best_gains(text, tmp_path):
    controller = tmp_path / "controller.toml"
    shipped = (
        (ROOT / "data" / "controllers" / "dead-weight.toml").read_text("utf-8").replace("starts = 4", "starts = 1")
    )
    controller.write_text(shipped.partition("[limits]")[0].replace('"60 s"', '"12 s"').replace('"20 s"', '"4 s"'))
    count = []

    def stop(event):
        count.append(event.text.startswith(text))
        if sum(count) >= 3 or (event.text == text and event.has_result):
            raise StopIteration

    study = sma.tune(DATA / "rig.toml", controller, progress=stop)
    if text == "checking":  # there are gains already
        assert study.success
        return
    assert study.exit_code == 130 and not study.success and study.result.interrupted
    assert study.reason.startswith("the tuning was interrupted, and these are the best gains so far")
    assert study.document["problems"][0] in str(study)
    assert study.metrics["rmse"] < study.document["metrics"]["start"]["rmse"]
    study.save(tmp_path / "out")
    assert (tmp_path / "out" / "controller.h").is_file()
    loaded = sma.load(tmp_path / "out")
    assert (loaded.exit_code, loaded.reason, loaded.gains) == (130, study.reason, study.gains)


@pytest.mark.slow
def test_a_tuning_that_is_stopped_before_its_first_step_has_no_gains():
    def stop(event):
        if event.can_stop:
            raise StopIteration

    with pytest.raises(sma.Cancelled, match="the tuning was cancelled before its first step had ended"):
        sma.tune(DATA / "rig.toml", ROOT / "data" / "controllers" / "dead-weight.toml", progress=stop)


def test_a_property_is_taken_by_its_name_where_there_is_one_stress():
    one = sma.thermal_cycle_properties(ISOBARIC.with_name("cycles.csv"))
    low, high = one["austenite_finish"].interval
    assert low < one["austenite_finish"].value < high and one["austenite_finish"] == one.means[0][1]["austenite_finish"]
    sentence = (
        r"cycles of 3 stresses or recordings \(\d+ MPa, \d+ MPa, \d+ MPa\), each with its own 'austenite_finish': "
        r"take one of \.means, as in study\.means\[0\]\[1\]\['austenite_finish'\], or give a recording under one stress"
    )
    with pytest.raises(sma.InputError, match=sentence):
        sma.thermal_cycle_properties(ISOBARIC)["austenite_finish"]


def test_a_cancelled_analysis_of_cycles_says_what_it_did():
    def stop(event):
        if "cycle 2" in event.text:
            raise StopIteration

    with pytest.raises(sma.Cancelled, match="^cancelled while analysing train.csv: cycle 2 of 6, before there was"):
        sma.thermal_cycle_properties(ISOBARIC, progress=stop)
    events = []
    sma.thermal_cycle_properties(ISOBARIC, progress=events.append)
    assert events[-1].text == "writing the report"


def test_a_dictionary_stands_for_a_rig_file(files):
    sections = tomllib.loads((files / "rig.toml").read_text("utf-8"))
    assert sma.predict(sections, files / "holdout.csv").success


def test_the_rig_of_a_study_goes_on(fitted, files):
    predicted = sma.predict(fitted.rig, files / "holdout.csv")
    assert predicted.success and predicted.channels["displacement"].shape == (501,)
    error = predicted.series[0].residual("displacement")
    assert np.sqrt(np.mean(error**2)) == pytest.approx(fitted.rmse["displacement"]["holdout"], rel=1e-6)


def test_a_callback_gets_phases_and_steps_and_can_stop(files):
    events = []

    def stop_after_two_steps(event):
        events.append(event)
        if event.step == 2:
            raise StopIteration

    study = sma.fit(files / "rig.toml", files / "train.csv", starts=1, progress=stop_after_two_steps)
    assert study.exit_code == 130 and "interrupted" in study.reason and study.document["solver"]["steps"] == 2
    assert events[0].text == "reading" and events[2].can_stop


def test_a_callback_that_raises_at_every_event_keeps_the_best_point(files):
    """As one that looks at a flag, which stays set."""
    flag = []

    def stop_while_set(event):
        if event.step == 2:
            flag.append(True)
        if flag:
            raise StopIteration

    study = sma.fit(files / "rig.toml", files / "train.csv", starts=1, progress=stop_while_set)
    assert study.exit_code == 130 and study.document["solver"]["steps"] == 2 and study.result is not None


@pytest.mark.parametrize(("can_stop", "text"), [(False, "cancelled while reading"), (True, "before its first step")])
def test_work_that_is_cancelled_before_a_result_says_so(files, can_stop, text):
    def stop(event):
        if event.can_stop is can_stop:
            raise StopIteration

    with pytest.raises(sma.Cancelled, match=text):
        sma.fit(files / "rig.toml", files / "train.csv", progress=stop)


def test_ctrl_c_in_a_fit_without_a_callback_is_an_interruption(files, monkeypatch):
    program, steps = multi_start._step_starts, []

    def interrupted(*arguments):
        if threading.current_thread() is threading.main_thread():  # not the compilation in the background
            steps.append(1)
        if len(steps) == 3:
            raise KeyboardInterrupt
        return program(*arguments)

    monkeypatch.setattr(multi_start, "_step_starts", interrupted)
    study = sma.fit(files / "rig.toml", files / "train.csv", starts=1, profile=["heat.h0"])
    assert study.exit_code == 130 and not study.success and "interrupted" in study.reason
    assert study.document["profiles"] == {} and study.document["solver"]["steps"] == 2


def test_a_stop_after_the_result_comes_too_late(files):
    def stop(event):
        if event.text == "writing the report":
            raise StopIteration

    assert sma.predict(files / "rig.toml", files / "train.csv", progress=stop).success


def test_a_changed_rig_is_saved_as_it_is(files):
    rig = sma.read_rig(files / "rig.toml")
    assert rig_text(rig) == (files / "rig.toml").read_text("utf-8")
    held = dataclasses.replace(rig, interpolation="hold")
    assert rig.interpolation == "linear" and 'interpolation = "hold"' in rig_text(held)


def test_a_sweep_that_is_cancelled_keeps_its_chunks(tmp_path):
    def stop(event):
        if event.can_stop:
            raise StopIteration

    sentence = r"stopped after 0 of .* run it again with --resume \(resume=True in Python\) to continue"
    with pytest.raises(sma.Cancelled, match=sentence):
        sma.sweep(ROOT / "data" / "sweeps" / "flexural.toml", folder=tmp_path / "out", progress=stop)
    with pytest.raises(sma.InputError, match="resume: the chunks are next to a result folder"):
        sma.sweep(ROOT / "data" / "sweeps" / "flexural.toml", resume=True)


def small_sweep(folder):
    """Return a sweep of a few designs of an actuator."""
    text = (ROOT / "data" / "sweeps" / "flexural.toml").read_text("utf-8")
    text = text.replace("../actuators", str(ROOT / "data" / "actuators")).replace("designs = 256", "designs = 12")
    (folder / "sweep.toml").write_text(text.replace('["moment", "efficiency"]', "[]"), "utf-8")
    return sma.sweep(folder / "sweep.toml")


STUDIES = {
    "predict": lambda files, folder: sma.predict(files / "rig.toml", files / "holdout.csv"),
    "compare": lambda files, folder: sma.compare(
        files / "rig.toml", files / "train.csv", holdout=files / "holdout.csv", models=["transfer-function"]
    ),
    "properties": lambda files, folder: sma.thermal_cycle_properties(ISOBARIC, model="brinson"),
    "sweep": lambda files, folder: small_sweep(folder),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", STUDIES)
def test_every_study_is_saved_and_loaded(name, files, tmp_path):
    study = STUDIES[name](files, tmp_path)
    study.save(tmp_path / "first")
    loaded = sma.load(tmp_path / "first")
    assert type(loaded) is type(study) and str(loaded) == str(study) and "<" in loaded._repr_html_()
    assert (loaded.reason, loaded.exit_code) == (study.reason, study.exit_code)
    loaded.save(tmp_path / "second")
    for path in (tmp_path / "first").iterdir():
        if path.name != "run.json":
            assert (tmp_path / "second" / path.name).read_bytes() == path.read_bytes(), path.name
    assert loaded.plot().to_json() == sma.load(tmp_path / "second").plot().to_json()
    if name == "sweep":
        assert list(loaded.to_pandas().columns) == list(study.to_pandas().columns)
    if name == "properties":
        assert loaded.means == study.means and "[material." in loaded.file_text("start-values.toml")


def test_mistakes_have_the_sentences_of_the_commands(files):
    with pytest.raises(sma.InputError, match=r"nowhere.toml: there is no such file"):
        sma.fit("nowhere.toml", files / "train.csv")
    with pytest.raises(sma.InputError, match=r"profile heat.h9: this parameter is not free \(did you mean"):
        sma.fit(files / "rig.toml", files / "train.csv", profile=["heat.h9"])
    with pytest.raises(sma.InputError, match="select: one recording is needed, 2 were given"):
        sma.diagnose(files / "rig.toml", files / "train.csv", select=["a.csv", "b.csv"], holdout="c.csv")


# Calls with an argument of a wrong type, and the sentences that refuse them.
A_PLANT = "give a Plant, such as rig.plant of a rig from read_rig"
A_RECORDING = (
    "a Recording, such as read_recording(...) or rig.read(..., observed=False) of a file or of a table in memory"
)
A_STATE = "give the state that init returns, or the first result of step"
WRONG_TYPES = {
    "sma.simulate(rig, inputs)": f"simulate: plant is of type Rig: {A_PLANT}",
    "sma.simulate(plant, table)": "simulate: inputs is of type dict: give Inputs, as discretise returns them, "
    f"or {A_RECORDING}",
    "sma.discretise(rig, recording)": f"discretise: plant is of type Rig: {A_PLANT}",
    "sma.discretise(plant, 'train.csv')": f"discretise: recording is of type str: give {A_RECORDING}",
    "sma.init(rig, signal)": f"init: plant is of type Rig: {A_PLANT}",
    "sma.step(rig, state, signal, 0.1)": f"step: plant is of type Rig: {A_PLANT}",
    "sma.step(plant, (state, None), signal, 0.1)": f"step: state is of type tuple: {A_STATE}",
    "sma.observe(rig, state, signal)": f"observe: plant is of type Rig: {A_PLANT}",
    "sma.observe(plant, signal, signal)": f"observe: state is of type ndarray: {A_STATE}",
    "sma.rollout(rig, loop, reference)": f"rollout: system is of type Rig: {A_PLANT}, or a SampledPlant",
    "sma.rollout(plant, loop.controller, reference)": "rollout: loop is of type PID: give a ClosedLoop, such as "
    "ClosedLoop(controller, channel=...)",
    "dataclasses.replace(plant, wire=0.2)": "Plant: wire cannot be a float: give a Wire or a Coil",
    "dataclasses.replace(plant, drive=sma.CurrentDrive)": "Plant: drive cannot be the class CurrentDrive: give a "
    "CurrentDrive, VoltageDrive, PowerDrive, DutyDrive or NoDrive",
    "dataclasses.replace(plant, material='brinson')": "Plant: material cannot be a str: give a law of "
    "smajax.materials, such as that of load_material",
    "dataclasses.replace(plant, effects=('latent-heat',))": "Plant: effects cannot be a str: give instances of classes "
    "of smajax.effects, such as (LatentHeat(strength=1e8),)",
}


def test_arguments_of_a_wrong_type_are_named_with_what_is_taken():
    """In a new process, since the tests' own checks of types would come first."""
    code = f"""
import dataclasses
import numpy as np
import jax
import smajax as sma
rig = sma.read_rig({str(DATA / "rig.toml")!r})
plant, signal, reference = rig.plant, np.asarray([0.2]), np.full(3, 1e-3)
table = {{"time [s]": 0.1 * np.arange(3), "current [A]": np.full(3, 0.2)}}
recording = rig.read(table, observed=False)
inputs = sma.discretise(plant, recording)
state = sma.init(plant, signal)
loop = sma.ClosedLoop(
    sma.controllers.PID(kp=400.0, ki=50.0, lower=0.0, upper=0.4, period=0.1), channel="displacement"
)
for call in {list(WRONG_TYPES)!r}:
    try:
        eval(call)
    except sma.InputError as error:
        print(error)
"""
    result = python(code, JAX_ENABLE_X64="1")
    assert result.stdout.splitlines() == list(WRONG_TYPES.values()), result.stderr


@pytest.mark.slow
def test_models_are_compared(files):
    ranked = sma.compare(
        files / "rig.toml", files / "train.csv", holdout=files / "holdout.csv", models=["tanaka", "transfer-function"]
    )
    assert ranked.ranking[0]["name"] == "tanaka"
    assert ranked.results and "tanaka" in str(ranked)
