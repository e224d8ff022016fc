"""The diagnosis: its statistics on made-up numbers, and the whole command on truth from the exact reference."""

import dataclasses
import json
import math
import re
import shutil
import subprocess
from importlib.resources import files
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jsonschema
import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.diagnosis import next_experiment, residual_checks
from smajax.diagnosis.acceptance import rejection_reason
from smajax.diagnosis.backward_elimination import drop_unneeded_effects, swap_confusable_effects
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import Candidate, CandidateFit, EffectSet, Refit
from smajax.diagnosis.confusable_effects import refit_confusable_effects, replacement_shapes
from smajax.diagnosis.detectability import NominalScore
from smajax.diagnosis.equivalence import equivalence_classes
from smajax.diagnosis.forward_selection import (
    _converge_worse_fits,
    _fit_single_effects,
    _refit_open_fits_jointly,
    select_effects,
)
from smajax.diagnosis.joint_refit import refit_jointly
from smajax.diagnosis.localisation import STAGES, most_likely_stage
from smajax.diagnosis.nonparametric_fit import fit_nonparametric_term
from smajax.diagnosis.onset_times import onset_prediction_error, refine_onsets, scan_onset_times
from smajax.diagnosis.outcome import (
    classify_outcome,
    diagnose,
    first_predicting_refit,
    improves_holdout,
    reject_if_little_explained,
)
from smajax.diagnosis.prediction_uncertainty import expected_reduced_chi2
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import orthonormal_basis, p_value, project_out, score_test
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.step_errors import stride_error
from smajax.diagnosis.successive_halving import trusted_candidate
from smajax.errors import NumericsError
from smajax.files.parameter_sets import Entry, write_parameters
from smajax.files.rig_file import read_rig
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.noise import rounding_noise
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.report.diagnosis_summary import sentences


def test_a_score_finds_a_planted_strength_beside_what_is_absorbed():
    rng = np.random.default_rng(1)
    jacobian, column = rng.standard_normal((400, 3)), rng.standard_normal(400)
    residual = -(jacobian @ [1.0, -2.0, 0.5]) - 0.7 * column + 1e-3 * rng.standard_normal(400)
    q = orthonormal_basis(jacobian)
    one = score_test(q, project_out(q, residual), column, (-3.0, 3.0), 0.999)
    assert one.strength == pytest.approx(0.7, abs=1e-3)
    clipped = score_test(q, project_out(q, residual), column, (-3.0, 0.0), 0.999)
    assert clipped.strength == clipped.gain == 0.0
    assert (
        score_test(q, project_out(q, residual), jacobian @ [1.0, 1.0, 1.0], (-3.0, 3.0), 0.999).absorbed_fraction
        > 0.999
    )


def test_false_alarms_stay_at_their_rate():
    """The simulated maximum holds its level for correlated, partly one-sided columns."""
    rng = np.random.default_rng(2)
    shared = rng.standard_normal((300, 1))
    columns = {f"{k}": c for k, c in enumerate((0.8 * shared + 0.6 * rng.standard_normal((300, 6))).T)}
    plausible = {k: (0.0, 9.0) if int(k) % 2 else (-9.0, 9.0) for k in columns}
    empty = np.zeros((300, 0))
    alarms = 0
    for _ in range(200):
        noise = rng.standard_normal(300)
        gain = max(score_test(empty, noise, c, plausible[k], 0.999).gain for k, c in columns.items())
        alarms += p_value(columns, plausible, gain, seed=3, draws=1000) < 0.05
    assert 2 <= alarms <= 22


def test_classes_are_linked_by_their_cosines():
    base = np.random.default_rng(0).standard_normal((200, 3))
    columns = {"a": base[:, 0], "b": base[:, 0] + 0.1 * base[:, 1], "c": base[:, 2]}
    assert sorted(map(sorted, equivalence_classes(columns))) == [["a", "b"], ["c"]]


def test_noise_is_seen_at_rest_where_it_is_slower_than_the_sampling():
    rng = np.random.default_rng(4)
    steps = np.repeat([0.0, 1.0], 1500)
    white = rng.normal(0.0, 0.3, 3000)
    assert residual_checks.estimate_noise(white, {"current": steps})[0] == pytest.approx(0.3, rel=0.1)
    slow = np.zeros(3000)
    for k in range(1, 3000):
        slow[k] = 0.7 * slow[k - 1] + 0.3 * np.sqrt(1.0 - 0.49) * rng.normal()
    value, source = residual_checks.estimate_noise(slow, {"current": steps})
    assert source == "rest" and value == pytest.approx(0.3, rel=0.2)
    busy = residual_checks.estimate_noise(slow, {"current": rng.normal(size=3000)})
    assert busy[1] == "residual differences" and busy[0] < 0.22


def test_a_residual_that_follows_an_input_is_seen_to():
    rng = np.random.default_rng(5)
    pushed = rng.normal(size=2000)
    seen = residual_checks.residual_statistics(
        np.append(np.zeros(3), pushed[:-3]) + 0.1 * rng.normal(size=2000), {"current": pushed}
    )
    lags = (len(seen.cross["current"]) - 1) // 2
    assert np.argmax(np.abs(seen.cross["current"])) - lags == 3
    assert seen.cross["current"][lags + 3] > 0.9
    white = residual_checks.residual_statistics(rng.normal(size=2000), {"current": pushed})
    assert max(white.outside.values()) < 0.1


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    """The folder that ``smajax demo`` writes: a diagnosis of recordings by the exact reference, of a wire with hidden latent heat."""
    out = tmp_path_factory.mktemp("demo") / "out"
    opened: list[Path] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.app.console.open_in_browser", opened.append)
        result = CliRunner().invoke(app, ["demo", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert opened == [out / "report.html"]
    assert "The rig has latent-heat" in result.stdout
    return out


def test_hidden_latent_heat_is_named_and_the_rig_with_it_predicts_to_the_noise(demo):
    document = json.loads((demo / "diagnosis.json").read_text("utf-8"))
    assert document["effects"] == ["latent-heat"] and document["base_fit_at_rest"]
    assert "did not converge" not in " ".join(sentences(document))
    assert "Without effects the fit did not converge" in " ".join(sentences(document | {"base_fit_at_rest": False}))
    assert document["verdict"] in ("named", "named-up-to-class")
    rmse = document["rmse"]["displacement"]
    assert rmse["holdout_after"] < 0.022 < 3 * 0.022 < rmse["holdout_before"]
    assert rmse["holdout_cut_95"][0] > 0.0
    entry = next(r for r in document["ranking"] if r["key"] == "latent-heat")
    assert entry["strength"] == pytest.approx(5e7, rel=0.02)
    assert entry["refit_rmse_select"] < 0.022
    assert entry["lower95"] < entry["strength"] < entry["upper95"]
    assert {r["key"] for r in document["ranking"]} == set(catalogue())
    seen = {s["key"]: s for s in document["preflight"]}
    assert seen["quantisation"]["status"] == seen["wire-crosstalk"]["status"] == "blind"
    assert "rounding" in seen["quantisation"]["why"] and "two wires" in seen["wire-crosstalk"]["why"]
    assert (
        seen["encoder-gain"]["status"] == "absorbed"
        and "material.max_transformation_strain" in seen["encoder-gain"]["absorbed_by"]
    )
    assert 0.0 < seen["latent-heat"]["smallest_detectable"] < 1e6
    looks = document["residual"]["displacement"]
    assert looks["before"]["outside"]["residual"] > 0.9 > 0.2 > looks["after"]["outside"]["residual"]
    assert document["noise_floor"]["displacement"]["value"] == pytest.approx(0.02, rel=0.05)
    excluded = {e["key"]: e["above"] for e in document["excluded"]}
    assert len(excluded) > 10 and "latent-heat" not in excluded and 0.0 < excluded["sensor-lag"] < 0.01
    assert [r["role"] for r in document["recordings"]] == ["train", "select", "holdout"]
    assert read_rig(demo / "rig-diagnosed.toml").plant.effects[0].key == "latent-heat"
    assert "latent-heat" in (demo / "report.html").read_text("utf-8")
    assert CliRunner().invoke(app, ["report", str(demo)]).exit_code == 0


def test_what_the_rig_file_has_is_not_found_again(demo, tmp_path):
    """Nor is noise estimated that the rig file gives; what was dropped in reading is said."""
    source = data_path("recordings", "dead-weight-unexplained")
    text = (demo / "rig-diagnosed.toml").read_text("utf-8")
    text += '\n[effects.backlash]\nstrength = "0 mm"\n'  # which is the same as nothing
    text += '\n[effects.wire-crosstalk]\nstrength = "0.1"\n'  # which one wire cannot have
    text = text.replace("[fit]\n", '[fit]\nnoise = { displacement = "0.021 mm" }\n')
    text = re.sub(r"(?m)^free = \[", 'free = ["effects.wire-crosstalk.strength", ', text)
    (tmp_path / "rig.toml").write_text(text, "utf-8")
    write_parameters(tmp_path / "fit.toml", {"heat.h0": Entry(99.0, "W/m^2/K")}, {})
    rows = (source / "train.csv").read_text().splitlines()
    rows[700] = rows[700].rpartition(",")[0] + ","
    (tmp_path / "train.csv").write_text("\n".join(rows))
    parts = [
        str(tmp_path / "train.csv"),
        "--select",
        str(source / "select.csv"),
        "--holdout",
        str(source / "holdout.csv"),
    ]
    out = tmp_path / "out"
    words = [
        "diagnose",
        str(tmp_path / "rig.toml"),
        *parts,
        "--start",
        str(tmp_path / "fit.toml"),
        "--quiet",
        "--drop-bad-rows",
    ]
    result = CliRunner().invoke(app, [*words, "--out", str(out)])
    assert result.exit_code == 0, result.output
    document = json.loads((out / "diagnosis.json").read_text("utf-8"))
    assert document["verdict"] == "nothing-missing" and document["effects"] == []
    assert document["noise_floor"]["displacement"] == {"value": pytest.approx(0.021), "unit": "mm", "from": "rig file"}
    entry = next(r for r in document["ranking"] if r["key"] == "latent-heat")
    assert entry["why"] == "the rig file has it" and entry["strength"] is None
    assert next(r for r in document["ranking"] if r["key"] == "backlash")["status"] == "testable"
    assert document["rmse"]["displacement"]["holdout_before"] < 0.022
    assert [e.key for e in read_rig(out / "rig-diagnosed.toml").plant.effects] == ["latent-heat"]
    assert "1 of" in document["recordings"][0]["notes"][0] and "dropped on request" in document["summary"]
    assert document["left_out"] == [{"effect": "wire-crosstalk", "why": "it needs two wires"}]
    assert (
        "Done without wire-crosstalk of the rig file, which this rig cannot have: it needs two wires."
        in document["summary"]
    )


@pytest.fixture(scope="module")
def schema() -> dict:
    """The published schema of diagnosis.json."""
    return json.loads((files("smajax.report") / "diagnosis.schema.json").read_text("utf-8"))


def test_the_contract_example_is_as_the_schema_says(schema, shared):
    example = json.loads((shared / "design" / "examples" / "diagnosis.json").read_text("utf-8"))
    example["schema"] = "smajax.diagnosis/2"  # the keys of schema 1
    assert not list(jsonschema.Draft202012Validator(schema).iter_errors(example))


def test_the_document_is_as_its_schema_says(demo, schema):
    jsonschema.validate(json.loads((demo / "diagnosis.json").read_text("utf-8")), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"schema": "smajax.diagnosis/2", "verdict": "maybe"}, schema)


def test_the_report_in_a_browser(demo, tmp_path):
    """The page as a browser leaves it: all pictures drawn, the verdict on top, nothing asked from the network."""
    browser = next(filter(None, map(shutil.which, ("chromium", "chromium-browser", "google-chrome"))), None)
    if browser is None:
        pytest.skip("there is no Chromium on this machine")
    words = [
        browser,
        "--headless",
        "--no-sandbox",
        "--disable-gpu",
        f"--user-data-dir={tmp_path}",
        "--virtual-time-budget=20000",
    ]
    shown = subprocess.run(
        [*words, "--dump-dom", (demo / "report.html").as_uri()], capture_output=True, text=True, timeout=120
    )
    page = shown.stdout
    figures = json.loads(re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)[1])  # pyright: ignore[reportOptionalSubscript]
    assert len(figures) > 6
    assert page.count('class="main-svg"') >= 2 * len(figures)
    assert page.index("The rig has latent-heat") < page.index("Error before and after")


@pytest.mark.parametrize(
    ("names", "said"),
    [
        (("train", "train", "holdout"), "given twice"),
        (("train", "copy", "holdout"), "same content"),
        (("short", "select", "holdout"), "too few"),
        (("train", "select", "part"), "has rows of train.csv"),
        (("clipped", "select", "holdout"), "displacement stays at its highest value for"),
        (("still", "select", "holdout"), "current never changes"),
    ],
)
def test_recordings_that_test_nothing_are_refused(tmp_path, names, said):
    source = data_path("recordings", "dead-weight-unexplained")
    for name in ("rig.toml", "train.csv", "select.csv", "holdout.csv"):
        (tmp_path / name).write_bytes((source / name).read_bytes())
    (tmp_path / "copy.csv").write_bytes((source / "train.csv").read_bytes())
    (tmp_path / "short.csv").write_text("\n".join((source / "train.csv").read_text().splitlines()[:60]))
    rows = [line.split(",") for line in (source / "train.csv").read_text().splitlines()]
    clipped = [rows[0], *([t, i, f"{min(float(x), 8.0):g}"] for t, i, x in rows[1:])]
    (tmp_path / "clipped.csv").write_text("\n".join(map(",".join, clipped)))
    part = [rows[0], *([f"{float(t) + 7.0:g}", i, x] for t, i, x in rows[500:1500])]
    (tmp_path / "part.csv").write_text("\n".join(map(",".join, part)))
    (tmp_path / "still.csv").write_text("\n".join(map(",".join, [rows[0], *([t, "0.3", x] for t, _, x in rows[1:])])))
    train, select, holdout = (str(tmp_path / f"{name}.csv") for name in names)
    words = ["diagnose", str(tmp_path / "rig.toml"), train, "--select", select, "--holdout", holdout]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "never"), "--quiet"])
    assert result.exit_code == 2
    assert said in result.stderr
    assert not (tmp_path / "never").exists()


def test_rounding_is_noise():
    values = np.round(np.linspace(0.0, 1.0, 500), 2)
    assert rounding_noise(values) == pytest.approx(0.01 / math.sqrt(12.0)) and rounding_noise(np.zeros(9)) == 0.0


def test_the_stage_to_look_at_comes_first_on_the_way_and_not_by_default():
    nothing = dict.fromkeys(STAGES, 0.0)
    assert most_likely_stage(nothing) is None
    assert most_likely_stage(nothing | {"material": 0.05, "mechanism": 0.07}) == "material"
    assert most_likely_stage(nothing | {"heat": 0.3, "sensor": 0.8}) == "sensor"
    assert most_likely_stage(nothing | {"mechanism": 0.75, "sensor": 0.8}) == "mechanism"


@pytest.fixture(scope="module")
def evaluator() -> CandidateEvaluator:
    """An evaluator on the demo's recordings."""
    folder = data_path("recordings", "dead-weight-unexplained")
    rig = read_rig(folder / "rig.toml")
    recordings = [rig.read(folder / f"{name}.csv") for name in ("train", "select", "holdout")]
    return CandidateEvaluator(DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation), 0)


@pytest.fixture(scope="module")
def fitted(evaluator) -> Refit:
    """The rig fitted without effects, nearly."""
    evaluator.problem.wait_for_compilation()
    return evaluator.problem.fit(EffectSet(), evaluator.problem.nominal, max_steps=8)


def test_an_effect_in_another_ones_place_is_tried_in_its_usual_shapes_or_in_that_ones(evaluator, fitted):
    turns = [
        s["effects.coulomb-friction.reversal"]
        for s in replacement_shapes(evaluator, "coulomb-friction", "backlash", fitted)
    ]
    assert turns == [1e-5, 3e-6]
    slow = dataclasses.replace(
        fitted, effect_set=fitted.effect_set.with_effect("coating", {"effects.coating.time_constant": 7.0})
    )
    assert replacement_shapes(evaluator, "end-conduction", "coating", slow) == [
        {"effects.end-conduction.time_constant": 7.0}
    ]


def test_what_promises_most_is_trusted_near_the_noise_only(evaluator, fitted):
    for times, trusts in ((1.5, True), (20.0, False)):
        refit = dataclasses.replace(fitted, residual=np.full(len(fitted.residual), times))
        offers = [
            Candidate(refit, key, 0.1, (), gain) for key, gain in (("coating", 5.0), ("creep", 80.0), ("backlash", 0.0))
        ]
        found = trusted_candidate(evaluator, offers)
        assert (found is offers[1]) is trusts and (trusts or found is None)
    assert (
        trusted_candidate(evaluator, [Candidate(refit, "creep", 0.1, (), 0.0)]) is None
        and trusted_candidate(evaluator, []) is None
    )


def test_a_search_on_fewer_samples_ends_where_one_on_all_does(evaluator, fitted, monkeypatch):
    problem = evaluator.problem
    start = EffectSet().with_effect("latent-heat", {"effects.latent-heat.strength": 3e7})
    whole, sparse = (evaluator.fit(start, fitted.base, stride, max_steps=40) for stride in (1, 4))
    assert problem.strided_problem(1) is problem.problems[0] is not problem.strided_problem(4)
    assert sparse.residual.shape == whole.residual.shape and sparse.chi2 == pytest.approx(whole.chi2, rel=1e-4)
    assert sparse.values["effects.latent-heat.strength"] == pytest.approx(
        whole.values["effects.latent-heat.strength"], rel=1e-3
    )
    looked = problem.start_search(start, fitted.base, stride=4).advance(1)
    assert looked.cost == pytest.approx(problem.start_search(start, fitted.base).advance(1).cost, rel=0.05)
    assert (
        0.0
        < stride_error(problem, fitted, 2)
        < stride_error(problem, fitted, 4)
        < 0.2 * problem.reduced_chi2(fitted.residual, 0)
    )
    # Longer steps are for what stands out: not near the noise, nor where they would themselves be most of what is left.
    monkeypatch.setattr(evaluator, "_stride_errors", {4: 0.5, 2: 0.1})
    assert [evaluator.stride(left) for left in (1.0, 9.0, 20.0, 49.0, 51.0)] == [1, 1, 2, 2, 4]
    # Nor need a search that ends far from the noise see the other samples.
    monkeypatch.setattr(evaluator, "_stride_errors", {4: 0.0})
    left = evaluator.fit(EffectSet(), fitted.base, 4)
    assert left.chi2 > 9.0 * problem.samples and left.chi2 == problem.fit(EffectSet(), fitted.base, stride=4).chi2
    assert left.chi2 == pytest.approx(problem.fit(EffectSet(), fitted.base).chi2, rel=0.05)
    monkeypatch.setattr(problem, "_has_clock", False)
    monkeypatch.setattr(problem, "_strided", {})
    assert problem.strided_problem(4) is problem.problems[0] and stride_error(problem, fitted, 4) == math.inf


def test_several_steps_a_sample_become_one_where_that_is_affordable(evaluator, monkeypatch):
    monkeypatch.setattr("smajax.diagnosis.problem.start_compilation", lambda *_: [])
    usual = evaluator.problem
    parts, plant = [part.recordings[0] for part in usual.splits], usual.base_problem.plant
    rig = read_rig(data_path("recordings", "dead-weight-unexplained") / "rig.toml")
    problem = DiagnosisProblem(plant, parts, rig.fit, interpolation=rig.interpolation, step=0.01)
    fine, asked = problem.problems, []
    problem.lengthen_steps(lambda problem: asked.append(problem) or False)
    assert problem.problems is fine and len(asked) == 1
    problem.lengthen_steps(lambda problem: True)
    for short, longer, single in zip(fine, problem.problems, usual.problems, strict=True):
        steps = [int(problem.data.end_index) for problem in (longer, single, short)]
        assert len(usual.splits[0].recordings[0]) <= steps[0] <= steps[1] < 0.6 * steps[2]
        assert all(np.array_equal(getattr(short.data, f), getattr(longer.data, f)) for f in ("measured", "weight"))
        rows = np.asarray(longer.data.inputs.sample_indices[0])
        assert np.array_equal(
            np.asarray(longer.data.inputs.time[0])[rows],
            np.asarray(single.data.inputs.time[0])[single.data.inputs.sample_indices[0]],
        )
    # The searches' fewer samples lie on steps that are longer still; one step a sample stays as it is.
    assert int(problem.strided_problem(2).data.end_index) < 0.6 * int(problem.problems[0].data.end_index)
    before = problem.problems
    problem.lengthen_steps(lambda problem: pytest.fail("there is nothing to lengthen"))
    assert problem.problems is before


def test_what_nearly_explains_the_residual_is_swapped_for_what_it_is_confused_with(evaluator, fitted, monkeypatch):
    """An effect that was found alone may have been the wrong one of two that are alike; at the noise, or far from it, nothing is tried."""

    def trial(*keys, left):
        hypothesis = EffectSet(keys, tuple((f"effects.{k}.strength", 1.0) for k in keys))
        return CandidateFit(dataclasses.replace(fitted, effect_set=hypothesis), left, left, 1.0)

    tried: list[str] = []

    def refits(_, asked):
        tried.append(asked.key)
        return [trial(*asked.keys[:-1], "sensor-lag", left=1.01)] if asked.key == "time-skew" else []

    monkeypatch.setattr("smajax.diagnosis.backward_elimination.refit_confusable_effects", refits)
    monkeypatch.setattr(evaluator, "refit_to_convergence", lambda one: one)
    first = evaluator.evaluate(fitted)
    for left, asked in ((1.6, ["time-skew"]), (1.02, []), (40.0, [])):
        state = SelectionState(
            {}, {}, first, trial("time-skew", "latent-heat", left=left), 1.1, {}, equivalent={"time-skew": ("creep",)}
        )
        tried.clear()
        swap_confusable_effects(evaluator, state)
        assert tried == asked
        assert state.accepted == (("latent-heat", "sensor-lag") if asked else ("time-skew", "latent-heat"))
        assert state.equivalent == ({} if asked else {"time-skew": ("creep",)})
        assert [k for k, _ in state.rejected] == asked


def test_a_prediction_may_miss_by_what_the_parameters_miss(evaluator, fitted):
    assert 1.0 <= expected_reduced_chi2(evaluator, fitted, 1) < 1.1


def test_a_free_term_says_where_heat_is_missing(evaluator, fitted):
    scores = evaluator.scores(fitted)
    shares = evaluator.stage_shares(fitted, scores)
    assert all(0.0 <= v <= 1.0 for v in shares.values())
    assert most_likely_stage(shares) == "heat" and shares["heat"] > 0.5
    shape = fit_nonparametric_term(evaluator.problem, fitted, scores.basis, scores.residual, "heat")
    assert shape is not None
    assert (shape.stage, shape.kind, shape.unit) == ("heat", "free-heat", "W/m^3")
    assert len(shape.positions) == len(shape.values) >= 3
    assert shape.train_chi2 < 0.8 * evaluator.problem.reduced_chi2(fitted.residual, 0)


def test_the_next_input_keeps_its_limits_and_sets_rivals_apart(evaluator, fitted):
    problem = evaluator.problem
    train = problem.splits[0].recordings[0]
    for made in next_experiment.input_library(train, ("current",), 3):
        current = made.channels["current"]
        assert len(made) == len(train)
        assert train.channels["current"].min() <= current.min() and current.max() <= train.channels["current"].max()
    rivals = {k: {f"effects.{k}.strength": problem.effects[k].typical} for k in ("latent-heat", "heat-capacity")}
    found = next_experiment.propose_experiment(problem, fitted, rivals, 0)
    assert found is not None and set(found.separates) == set(rivals)
    assert (found.recording is None) == ("no input within these limits" in found.advice)
    if found.recording is not None:
        limit = max(float(problem.states(fitted, _first(problem.problems[k])).temperature.max()) for k in (0, 1))
        inputs = problem.problem_for_inputs(found.recording)
        assert inputs is not None
        assert float(problem.states(fitted, _first(inputs)).temperature.max()) <= limit + 1.0
    assert next_experiment.propose_experiment(problem, fitted, {"latent-heat": {}}, 0) is None


def _first(problem):
    return jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)


def test_a_cause_is_found_where_the_first_fit_does_not_come_to_rest(evaluator, monkeypatch):
    """From the rig's own values each effect is tried in its usual strength; only without a cause is nothing selected."""
    evaluator.problem.wait_for_compilation()
    few = ("latent-heat", "backlash", "encoder-drift", "ambient-drift")
    monkeypatch.setattr(evaluator.problem, "effects", {k: evaluator.problem.effects[k] for k in few})
    monkeypatch.setattr("smajax.diagnosis.base_fit.is_stationary", lambda *_: False)
    monkeypatch.setattr("smajax.diagnosis.candidates.AT_NOISE", 0.0)  # as if the first refits had not found it
    said: list[str] = []
    _, state = select_effects(evaluator.problem, report_progress=said.append)
    assert not state.base_fit_converged and any("did not converge" in text for text in said)
    assert "round 1: refitting them from the rig's own values" in said
    assert state.accepted == ("latent-heat",) and state.current.total_chi2 < 2.2
    state.current = state.base_fit
    monkeypatch.setattr("smajax.diagnosis.outcome.select_effects", lambda *_, **__: (evaluator, state))
    with pytest.raises(NumericsError, match="did not converge") as caught:
        diagnose(evaluator.problem)
    assert set(caught.value.state) == {u.label for u in evaluator.problem.base_problem.unknowns}


def planted(problem: DiagnosisProblem, fitted: Refit, effect_set: EffectSet, parts: tuple[int, ...]) -> list:
    """The problems of the splits, some with measurements that a set of effects and white noise make."""
    problems = list(problem.problems)
    for k in parts:
        blown = problem.predict(effect_set, fitted.base, k)
        weight = np.asarray(problems[k].data.weight)
        noise = np.random.default_rng(6 + k).normal(size=weight.shape)
        measured = np.asarray(problems[k].data.measured) + (blown.reshape(weight.shape) + noise) / np.where(
            weight > 0.0, weight, np.inf
        )
        problems[k] = dataclasses.replace(
            problems[k], data=eqx.tree_at(lambda d: d.measured, problems[k].data, measured)
        )
    return problems


def test_an_instant_at_which_nothing_moves_is_looked_for_where_the_cost_is_flat(evaluator, fitted, monkeypatch):
    """The draught sets in while the wire is cold: the training recording tells hardly when, the selection recording does."""
    problem, name = evaluator.problem, "effects.airflow-change.instant"
    draught = EffectSet().with_effect("airflow-change", {"effects.airflow-change.strength": 0.4, name: 26.4})
    monkeypatch.setattr(problem, "problems", planted(problem, fitted, draught, (0, 1, 2)))
    astray = draught.with_values({name: 27.35})
    trial = evaluator.evaluate(
        Refit(astray, fitted.base, *problem.evaluate(astray, fitted.base, 0), SolverStatus.converged)
    )
    near = refine_onsets(evaluator, trial)
    assert near.train_chi2 < trial.train_chi2 < 1.1 and abs(near.refit.values[name] - 26.4) < 0.75
    # Where the search has left it, its slope does not tell what it may do to a prediction; where the cost is flat, all instants count.
    assert (
        onset_prediction_error(evaluator.problem, near.refit, 0)
        < 0.05
        < 0.2
        < onset_prediction_error(evaluator.problem, near.refit, 2)
    )
    both = refit_jointly(evaluator.problem, trial.refit)
    assert both.values[name] == pytest.approx(26.4, abs=0.15)
    assert onset_prediction_error(evaluator.problem, both, 2, (0, 1)) < onset_prediction_error(
        evaluator.problem, near.refit, 2
    )
    assert refine_onsets(evaluator, evaluator.evaluate(fitted)).refit is fitted


def test_an_instant_is_looked_for_over_the_whole_recording(evaluator, fitted, monkeypatch):
    """A search that has set in far from the draught's instant ends beside it; one at the noise, or without an instant, is left alone."""
    problem = evaluator.problem
    draught = EffectSet().with_effect(
        "airflow-change", {"effects.airflow-change.strength": 0.4, "effects.airflow-change.instant": 21.3}
    )
    monkeypatch.setattr(problem, "problems", planted(problem, fitted, draught, (0,)))
    astray = problem.start_search(draught.with_values({"effects.airflow-change.instant": 60.0}), fitted.base).advance(8)
    found = [problem.refit_from(s) for s in scan_onset_times(evaluator, astray)]
    assert len(found) == 1 and problem.reduced_chi2(found[0].residual, 0) < 1.1 < problem.reduced_chi2(
        problem.refit_from(astray).residual, 0
    )
    assert found[0].values["effects.airflow-change.instant"] == pytest.approx(21.3, abs=0.05)
    assert scan_onset_times(evaluator, problem.start_search(draught, fitted.base).advance(3)) == []
    assert (
        scan_onset_times(
            evaluator,
            problem.start_search(
                EffectSet().with_effect("backlash", {"effects.backlash.strength": 1e-5}), fitted.base
            ).advance(2),
        )
        == []
    )


def test_a_coating_and_the_ends_of_a_wire_are_one_class(evaluator, monkeypatch):
    """A node that follows half the wire's excess is one that follows all of it, and convection beside it: the fit has a long way to go."""
    problem, rng = evaluator.problem, np.random.default_rng(0)
    planted = EffectSet(("coating",), (("effects.coating.strength", 0.2), ("effects.coating.time_constant", 4.0)))
    problems = []
    for k, split in enumerate(problem.problems):
        residual = problem.predict(planted, problem.nominal, k)
        weight = np.asarray(split.data.weight)
        moved = np.where(
            weight > 0,
            (residual.reshape(weight.shape) + rng.standard_normal(weight.shape)) / np.where(weight > 0, weight, 1.0),
            0.0,
        )
        problems.append(eqx.tree_at(lambda p: p.data.measured, split, split.data.measured + moved))
    monkeypatch.setattr(problem, "problems", problems)
    trial = evaluator.evaluate(problem.fit(planted, problem.nominal, max_steps=10, rtol=1e-8))
    assert trial.at_noise
    (same,) = (t for t in refit_confusable_effects(evaluator, trial) if t.key == "end-conduction")
    assert abs(same.total_chi2 - trial.total_chi2) * len(problem.counted_samples(trial.refit.residual)) < 2.0
    assert evaluator.log_distance_from_typical(trial) < evaluator.log_distance_from_typical(same)


def test_a_fit_that_runs_away_under_another_input_is_not_predicted_with():
    refits = [
        Refit(EffectSet(), np.full(1, k), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged) for k in range(3)
    ]
    left = {0: (1.0, np.inf), 1: (np.nan, 1.0), 2: (1.0, 1.0)}
    problem = SimpleNamespace(
        predict=lambda effect_set, base, k: left[int(base[0])][k - 1], reduced_chi2=lambda residual, k: residual
    )
    assert first_predicting_refit(problem, *refits) is refits[2]
    assert first_predicting_refit(problem, *refits[:2]) is refits[1]


@pytest.mark.parametrize(
    ("keys", "train", "select", "held", "equivalent", "word"),
    [
        ((), 1.0, 1.0, 1.0, (), "nothing-missing"),
        ((), 4.0, 4.0, 4.0, (), "unresolved"),
        ((), 1.0, 1.0, 4.0, (), "unresolved"),  # only the third input shows it
        (("latent-heat",), 1.0, 1.02, 1.02, (), "named"),
        (("latent-heat",), 1.0, 1.02, 1.02, ("heat-capacity",), "named-up-to-class"),
        (("latent-heat",), 1.0, 4.0, 1.02, (), "partial"),
        (("latent-heat",), 1.0, 1.02, 2.4, (), "partial"),  # a stand-in that does not hold under another input
        (("latent-heat",), 9.0, 9.0, 9.0, (), "partial"),
        (("latent-heat",), 80.0, 80.0, 80.0, (), "unresolved"),  # explains a fifth: no cause, and taken back
    ],
)
def test_the_words_of_a_verdict(keys, train, select, held, equivalent, word):
    """See ``judged``."""
    assert judged(keys, train, select, held, equivalent, (1.0, 1.0)) == word


def test_the_parameters_own_uncertainty_excuses_a_miss():
    told = {e: judged(("latent-heat",), 1.0, 4.0, 3.0, (), e) for e in ((1.0, 1.0), (3.5, 1.0), (1.0, 2.8), (3.5, 2.8))}
    assert list(told.values()) == ["partial", "partial", "partial", "named"]


@pytest.mark.parametrize(
    "both, held, word",
    [
        ((1.1, 1.1), 1.1, "named"),
        ((1.1, 1.1), 1.35, "partial"),
        ((1.1, 1.4), 1.1, "partial"),
        ((1.4, 1.1), 1.1, "partial"),
    ],
)
def test_one_fit_that_does_for_two_recordings_and_predicts_the_third_names_what_one_alone_does_not(both, held, word):
    assert judged(("airflow-change",), 1.0, 60.0, held, (), (1.0, 1.0), both) == word


@pytest.mark.parametrize(
    ("keys", "before", "after", "why"),
    [
        ((), (2.0, 2.0), (1.999, 1.0), "no better than chance"),
        ((), (2.0, 2.0), (1.0, 1.9), "cuts the error on the selection recording by 2.5 %"),
        ((), (1.6, 1.7), (1.0, 1.0), ""),  # the first effect may be small
        (("latent-heat",), (1.6, 1.7), (1.0, 1.0), "by less than the noise, in addition to latent-heat"),
        (("latent-heat",), (1.6, 2.1), (1.0, 1.0), ""),
        (("latent-heat",), (90.0, 80.0), (70.0, 60.0), ""),  # one of several, so that much is left
        (("latent-heat",), (2.5, 6.4), (1.3, 2.2), "explains 78 % of the little that latent-heat left"),
        (("latent-heat",), (2.5, 6.4), (1.1, 1.3), ""),
    ],
)
def test_what_is_said_against_an_effect(keys, before, after, why):
    said = rejection_reason(trial(keys, *before), trial((*keys, "backlash"), *after), 4000)
    assert why in said and bool(said) == bool(why)


def test_what_no_recording_tells_may_be_as_far_off_as_is_typical():
    """Two parameters, the second without any influence on what was fitted, and with some on what is predicted."""
    jacobians = {0: np.array([[100.0, 0.0], [100.0, 0.0]]), 1: np.array([[100.0, 3.0], [100.0, 0.0]])}
    problem = SimpleNamespace(
        evaluate=lambda effect_set, base, k, free: (np.zeros(2), jacobians[k]), free_effect_parameters=lambda effect_set: (), series=lambda column, k: {"motion": column},
        shared_count=2, size=2, bounds=(np.full(2, -np.inf), np.full(2, np.inf)),
    )  # fmt: skip
    refit = Refit(EffectSet(), np.zeros(2), np.zeros(2), jacobians[0], SolverStatus.converged)
    assert expected_reduced_chi2(CandidateEvaluator(problem, 0), refit, 1) == pytest.approx(
        1.0 + 0.5 + 0.5 * 3.0**2, rel=1e-3
    )


def test_a_refit_that_is_worse_than_without_its_effect_is_taken_to_its_end_first():
    held, other, hopeless = trial(("creep",), 12.0, 1.0), trial(("backlash",), 8.0, 8.0), trial(("slack",), 11.0, 30.0)
    evaluator = SimpleNamespace(refit_to_convergence=lambda one: trial(one.keys, 9.0, 20.0))
    found = _converge_worse_fits(evaluator, [held, other, hopeless], trial((), 10.0, 10.0))  # pyright: ignore[reportArgumentType]
    assert [(t.keys, t.train_chi2) for t in found] == [(("backlash",), 8.0), (("creep",), 9.0)]


@pytest.mark.parametrize(("joint", "kept"), [((1.0, 1.0), True), ((1.0, 40.0), False), ((30.0, 1.0), False)])
def test_what_the_training_recording_leaves_open_is_asked_of_the_selection_recording(joint, kept, monkeypatch):
    """An instant at which nothing moves may spoil the cause's prediction; a surrogate, fitted to both, does for one of them at most."""
    cause, surrogate, asked = trial(("creep",), 0.9, 4000.0), trial(("encoder-gain",), 20.0, 130.0), []
    monkeypatch.setattr("smajax.diagnosis.forward_selection.refit_jointly", lambda problem, refit: refit)
    evaluator = SimpleNamespace(
        problem=None,
        evaluate=lambda refit: asked.append(refit.effect_set.keys) or trial(refit.effect_set.keys, *joint),
    )
    found = _refit_open_fits_jointly(evaluator, [surrogate, cause], 1.25)  # pyright: ignore[reportArgumentType]
    assert asked == [("creep",)] and found[0] is surrogate
    assert (found[1].train_chi2, found[1].select_chi2) == (joint if kept else (0.9, 4000.0))
    named = trial(("creep",), 1.0, 1.0)
    assert _refit_open_fits_jointly(evaluator, [cause, named], 1.25) == [cause, named] and len(asked) == 1  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("train", "select", "again"),
    [(4.0, 20.0, False), (20.0, 32.0, True), (4.0, 170.0, True), (1.0, 1.0, False)],
)
def test_effects_are_tried_afresh_unless_one_explains_half_of_what_was_fitted_and_of_all(
    train, select, again, monkeypatch
):
    """A surrogate may mend a prediction that a biased first fit spoilt while the cause, from that fit, promises nothing."""
    strengths: list[list[float]] = []

    def halving(_, near, far=()):
        strengths.append([candidate.strength for candidate in (*near, *far)])
        return [trial(("wire-crosstalk",), train, select)]

    first = trial((), 24.0, 175.0)
    state = SelectionState({}, {}, first, first, 1.05, {"wire-crosstalk": NominalScore(1.0, 0.1, ())})
    problem = SimpleNamespace(shape_grid=lambda key: [()], plausible_range=lambda key: (0.0, 9.0))
    one = SimpleNamespace(minimum_detectable_strength=0.1, strength=0.3, gain=5.0)
    scores = SimpleNamespace(best={"wire-crosstalk": one}, shapes={"wire-crosstalk": ()})
    monkeypatch.setattr("smajax.diagnosis.forward_selection.successive_halving", halving)
    found = _fit_single_effects(SimpleNamespace(problem=problem), state, scores, lambda text: None)  # pyright: ignore[reportArgumentType]
    assert strengths == ([[0.3, 0.1], [1.0]] if again else [[0.3, 0.1]]) and len(found) == len(strengths)


def test_an_effect_that_is_not_missed_is_dropped_and_no_fit_made_twice():
    """The fit before the last effect is known; only those without an earlier one are made."""
    made, pair = [], trial(("creep", "backlash"), 1.0, 1.0)
    problem = SimpleNamespace(samples=1000)
    evaluator = SimpleNamespace(
        problem=problem,
        stride=lambda train: 1,
        fit=lambda h, base, stride: made.append(h.keys),
        evaluate=lambda refit: trial(("backlash",), 1.0, 1.0),
    )
    state = SelectionState(
        {}, {}, trial((), 9.0, 9.0), pair, 1.05, {}, accepted_fits=[trial(("creep",), 3.0, 3.0), pair]
    )
    drop_unneeded_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert (state.accepted, made) == (("backlash",), [("backlash",)])
    assert state.rejected == [("creep", "is no longer needed next to the other effects")]
    evaluator.evaluate, state.current, state.rejected = lambda refit: trial(("backlash",), 3.0, 3.0), pair, []
    drop_unneeded_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert (state.accepted, len(made), state.rejected) == (("creep", "backlash"), 2, [])


def test_what_the_first_fit_cannot_predict_is_not_counted_as_explained():
    first, better = trial((), 11.0, math.nan), trial(("latent-heat",), 3.0, 40.0)
    assert SelectionState({}, {}, first, first, 1.05, {}).explained_by(better) == pytest.approx(0.8)
    first = trial((), 11.0, 21.0)
    assert SelectionState({}, {}, first, first, 1.05, {}).explained_by(
        trial(("latent-heat",), 3.0, 5.0)
    ) == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("before", "after", "helps"), [(2.0, 1.0, True), (1.0, 1.0, False), (1.0, 2.0, False), (math.nan, 1.0, True)]
)
def test_effects_that_leave_the_holdout_as_it_was_are_no_partial_answer(before, after, helps):
    noise = np.random.default_rng(1).standard_normal((2, 1000))
    left = {(): before * noise[0], ("creep",): after * noise[1]}
    problem = SimpleNamespace(
        predict=lambda effect_set, base, k: left[effect_set.keys],
        series=lambda residual, k: {"motion": residual},
        channels=("motion",),
    )
    evaluator = SimpleNamespace(problem=problem, seed=0)
    assert improves_holdout(evaluator, trial((), 9.0, 9.0).refit, trial(("creep",), 9.0, 9.0).refit) == helps  # pyright: ignore[reportArgumentType]


def trial(keys, train, select):
    return CandidateFit(
        Refit(EffectSet(keys), np.zeros(1), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged), train, select, 0.0
    )


def judged(keys, train, select, held, equivalent, expected, both=None):
    """The word for mean squares of a fit on the three recordings, where ``expected`` may be left on the second and third.

    ``both`` are those of a fit to the first two together, on these; by default, as those of the fit to the first one.
    """
    first = trial((), 100.0, 100.0) if keys else trial((), train, select)
    state = SelectionState(
        {}, {}, first, trial(keys, train, select), 1.05, {}, equivalent={k: equivalent for k in keys}
    )
    reject_if_little_explained(state)
    word = classify_outcome(state, (*(both or (train, select)), held), expected)
    assert bool(state.accepted) == word.startswith(("named", "partial"))
    assert len(state.rejected) == (word == "unresolved" and bool(keys))
    return word
