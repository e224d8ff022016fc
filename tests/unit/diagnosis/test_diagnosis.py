"""The diagnosis: its statistics on synthetic numbers, and the whole command on recordings by the exact reference."""

import dataclasses
import json
import math
import re
from pathlib import Path
from types import SimpleNamespace

import equinox as eqx
import jax
import jsonschema
import numpy as np
import pytest
import scipy.signal
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.diagnosis import next_experiment, residual_checks
from smajax.diagnosis.acceptance import Rejection, RejectionCode, rejection
from smajax.diagnosis.backward_elimination import drop_unneeded_effects, swap_confusable_effects
from smajax.diagnosis.bootstrap import bootstrap_cut
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
from smajax.diagnosis.outcome import diagnose, first_predicting_refit, improves_holdout
from smajax.diagnosis.prediction_uncertainty import expected_reduced_chi2
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.screening import orthonormal_basis, p_value, project_out, score_test
from smajax.diagnosis.selection_state import SelectionState
from smajax.diagnosis.step_errors import stride_error
from smajax.diagnosis.successive_halving import trusted_candidate
from smajax.diagnosis.support import judge_effects
from smajax.diagnosis.verdict import classify_outcome
from smajax.errors import NumericsError
from smajax.files.parameter_sets import Entry, write_parameters
from smajax.files.rig_file import read_rig
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.noise import rounding_noise
from smajax.fitting.responses import simulate_responses
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.report.diagnosis_series import prediction_series
from smajax.report.diagnosis_summary import sentences
from smajax.report.diagnosis_wording import experiment_text, rejection_text
from smajax.report.documents.schemas import schemas
from smajax.simulation.status import SimulationStatus
from tests.support.browser import drawn_page


def test_score_estimates_a_planted_strength_beyond_the_free_parameters():
    rng = np.random.default_rng(1)
    jacobian, column = rng.standard_normal((400, 3)), rng.standard_normal(400)
    residual = -(jacobian @ [1.0, -2.0, 0.5]) - 0.7 * column + 1e-3 * rng.standard_normal(400)
    q = orthonormal_basis(jacobian)
    score = score_test(q, project_out(q, residual), column, (-3.0, 3.0), 0.999)
    assert score.strength == pytest.approx(0.7, abs=1e-3)
    clipped = score_test(q, project_out(q, residual), column, (-3.0, 0.0), 0.999)
    assert clipped.strength == clipped.gain == 0.0
    assert (
        score_test(q, project_out(q, residual), jacobian @ [1.0, 1.0, 1.0], (-3.0, 3.0), 0.999).absorbed_fraction
        > 0.999
    )


def test_p_value_holds_its_level():
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


def test_equivalence_classes_link_collinear_sensitivities():
    base = np.random.default_rng(0).standard_normal((200, 3))
    columns = {"a": base[:, 0], "b": base[:, 0] + 0.1 * base[:, 1], "c": base[:, 2]}
    assert sorted(map(sorted, equivalence_classes(columns))) == [["a", "b"], ["c"]]


def test_slow_noise_is_estimated_at_rest():
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


def test_cross_correlation_shows_the_lag_of_an_input():
    rng = np.random.default_rng(5)
    current = rng.normal(size=2000)
    statistics = residual_checks.residual_statistics(
        np.append(np.zeros(3), current[:-3]) + 0.1 * rng.normal(size=2000), {"current": current}
    )
    lags = (len(statistics.cross["current"]) - 1) // 2
    assert np.argmax(np.abs(statistics.cross["current"])) - lags == 3
    assert statistics.cross["current"][lags + 3] > 0.9
    white = residual_checks.residual_statistics(rng.normal(size=2000), {"current": current})
    assert max(white.outside.values()) < 0.1


@pytest.fixture(scope="module")
def demo(tmp_path_factory) -> Path:
    """The folder that ``smajax demo`` writes: a diagnosis of a wire with hidden latent heat, by the exact reference."""
    out = tmp_path_factory.mktemp("demo") / "out"
    opened: list[Path] = []
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.app.console.open_in_browser", opened.append)
        result = CliRunner().invoke(app, ["demo", "--out", str(out)])
    assert result.exit_code == 0, result.output
    assert opened == [out / "report.html"]
    assert "The rig has latent-heat" in result.stdout
    return out


@pytest.mark.slow
def test_hidden_latent_heat_is_named_and_the_diagnosed_rig_predicts_to_the_noise(demo):
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
    preflight = {s["key"]: s for s in document["preflight"]}
    assert preflight["quantisation"]["status"] == preflight["wire-crosstalk"]["status"] == "blind"
    assert "rounding" in preflight["quantisation"]["why"] and "two wires" in preflight["wire-crosstalk"]["why"]
    assert (
        preflight["encoder-gain"]["status"] == "absorbed"
        and "material.max_transformation_strain" in preflight["encoder-gain"]["absorbed_by"]
    )
    assert 0.0 < preflight["latent-heat"]["smallest_detectable"] < 1e6
    residual = document["residual"]["displacement"]
    assert residual["before"]["outside"]["residual"] > 0.9 > 0.2 > residual["after"]["outside"]["residual"]
    assert document["noise_floor"]["displacement"]["value"] == pytest.approx(0.02, rel=0.05)
    excluded = {e["key"]: e["above"] for e in document["excluded"]}
    assert len(excluded) > 10 and "latent-heat" not in excluded and 0.0 < excluded["sensor-lag"] < 0.01
    assert [r["role"] for r in document["recordings"]] == ["train", "select", "holdout"]
    assert read_rig(demo / "rig-diagnosed.toml").plant.effects[0].key == "latent-heat"
    assert "latent-heat" in (demo / "report.html").read_text("utf-8")
    assert CliRunner().invoke(app, ["report", str(demo)]).exit_code == 0


@pytest.mark.slow
def test_effects_of_the_rig_file_are_not_candidates(demo, tmp_path):
    """Noise of the rig file is not estimated, and rows that were dropped in reading are listed."""
    source = data_path("recordings", "dead-weight-unexplained")
    text = (demo / "rig-diagnosed.toml").read_text("utf-8")
    text += '\n[effects.backlash]\nstrength = "0 mm"\n'  # as if the effect were not there
    text += '\n[effects.wire-crosstalk]\nstrength = "0.1"\n'  # needs two wires
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
        "Not used: wire-crosstalk of the rig file, which this rig cannot have: it needs two wires."
        in document["summary"]
    )


@pytest.fixture(scope="module")
def schema() -> dict:
    """The published schema of diagnosis.json."""
    return schemas()["diagnosis.schema.json"]


@pytest.mark.slow
def test_document_matches_its_schema(demo, schema):
    jsonschema.validate(json.loads((demo / "diagnosis.json").read_text("utf-8")), schema)
    with pytest.raises(jsonschema.ValidationError):
        jsonschema.validate({"schema": "smajax.diagnosis/2", "verdict": "maybe"}, schema)


@pytest.mark.slow
def test_report_in_a_browser(demo, tmp_path):
    """The page after a browser has drawn it: all figures, the verdict on top, no request to the network."""
    page = drawn_page(demo / "report.html", tmp_path)
    figures = json.loads(re.search(r'id="figures">(.*?)</script>', page, re.DOTALL)[1])  # pyright: ignore[reportOptionalSubscript]
    assert len(figures) > 6
    assert page.count('class="main-svg"') >= 2 * len(figures)
    assert page.index("The rig has latent-heat") < page.index("Error before and after")


@pytest.mark.slow
@pytest.mark.parametrize(
    ("names", "message"),
    [
        (("train", "train", "holdout"), "given twice"),
        (("train", "copy", "holdout"), "same content"),
        (("short", "select", "holdout"), "too few"),
        (("train", "select", "part"), "has rows of train.csv"),
        (("clipped", "select", "holdout"), "displacement stays at its highest value for"),
        (("still", "select", "holdout"), "current never changes"),
    ],
)
def test_unsuitable_recordings_are_rejected(tmp_path, names, message):
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
    assert message in result.stderr
    assert not (tmp_path / "never").exists()


def test_rounding_noise():
    values = np.round(np.linspace(0.0, 1.0, 500), 2)
    assert rounding_noise(values) == pytest.approx(0.01 / math.sqrt(12.0)) and rounding_noise(np.zeros(9)) == 0.0


def test_most_likely_stage_is_the_most_upstream_of_a_tie():
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


@pytest.mark.slow
def test_residuals_are_measured_minus_model_and_the_table_has_that_model(evaluator, fitted):
    problem, rig = evaluator.problem, read_rig(data_path("recordings", "dead-weight-unexplained") / "rig.toml")
    training = problem.splits[0].recordings[0]
    plant = problem.fitted_plant(fitted)
    (response,), _ = simulate_responses([plant], [training], ["train"], problem.channels, rig.interpolation, None)
    residual = {c: v * problem.noise[c] for c, v in problem.series(fitted.residual).items()}
    series = prediction_series([training] * 3, SimpleNamespace(predictions={"before": [residual] * 3}))
    for channel, values in residual.items():
        np.testing.assert_allclose(values, response.residual(channel), atol=1e-3 * problem.noise[channel])
        unit = series[0].measured[channel] / training.channels[channel]
        np.testing.assert_allclose(series[0].residual(channel), values * unit, atol=1e-9)


@pytest.mark.slow
def test_replacement_shapes_are_the_fitted_or_the_usual_ones(evaluator, fitted):
    reversals = [
        s["effects.coulomb-friction.reversal"]
        for s in replacement_shapes(evaluator, "coulomb-friction", "backlash", fitted)
    ]
    assert reversals == [1e-5, 3e-6]
    slow_coating = dataclasses.replace(
        fitted, effect_set=fitted.effect_set.with_effect("coating", {"effects.coating.time_constant": 7.0})
    )
    assert replacement_shapes(evaluator, "end-conduction", "coating", slow_coating) == [
        {"effects.end-conduction.time_constant": 7.0}
    ]


@pytest.mark.slow
def test_largest_gain_is_trusted_near_the_noise_only(evaluator, fitted):
    for value, is_trusted in ((1.5, True), (20.0, False)):
        refit = dataclasses.replace(fitted, residual=np.full(len(fitted.residual), value))
        candidates = [
            Candidate(refit, key, 0.1, (), gain) for key, gain in (("coating", 5.0), ("creep", 80.0), ("backlash", 0.0))
        ]
        trusted = trusted_candidate(evaluator, candidates)
        assert (trusted is candidates[1]) is is_trusted and (is_trusted or trusted is None)
    assert (
        trusted_candidate(evaluator, [Candidate(refit, "creep", 0.1, (), 0.0)]) is None
        and trusted_candidate(evaluator, []) is None
    )


@pytest.mark.slow
def test_search_on_fewer_samples_has_the_same_optimum(evaluator, fitted, monkeypatch):
    problem = evaluator.problem
    start = EffectSet().with_effect("latent-heat", {"effects.latent-heat.strength": 3e7})
    whole, sparse = (evaluator.fit(start, fitted.base, stride, max_steps=40) for stride in (1, 4))
    assert problem.strided_problem(1) is problem.problems[0] is not problem.strided_problem(4)
    assert sparse.residual.shape == whole.residual.shape and sparse.chi2 == pytest.approx(whole.chi2, rel=1e-4)
    assert sparse.values["effects.latent-heat.strength"] == pytest.approx(
        whole.values["effects.latent-heat.strength"], rel=1e-3
    )
    first_step = problem.start_search(start, fitted.base, stride=4).advance(1)
    assert first_step.cost == pytest.approx(problem.start_search(start, fitted.base).advance(1).cost, rel=0.05)
    assert (
        0.0
        < stride_error(problem, fitted, 2)
        < stride_error(problem, fitted, 4)
        < 0.2 * problem.reduced_chi2(fitted.residual, 0)
    )
    # Longer steps are not used near the noise, nor where their error would be a large part of the residual.
    monkeypatch.setattr(evaluator, "_stride_errors", {4: 0.5, 2: 0.1})
    assert [evaluator.stride(chi2) for chi2 in (1.0, 9.0, 20.0, 49.0, 51.0)] == [1, 1, 2, 2, 4]
    # A search that ends far from the noise does not use the other samples.
    monkeypatch.setattr(evaluator, "_stride_errors", {4: 0.0})
    strided = evaluator.fit(EffectSet(), fitted.base, 4)
    assert strided.chi2 > 9.0 * problem.samples and strided.chi2 == problem.fit(EffectSet(), fitted.base, stride=4).chi2
    assert strided.chi2 == pytest.approx(problem.fit(EffectSet(), fitted.base).chi2, rel=0.05)
    monkeypatch.setattr(problem, "_has_clock", False)
    monkeypatch.setattr(problem, "_strided", {})
    assert problem.strided_problem(4) is problem.problems[0] and stride_error(problem, fitted, 4) == math.inf


@pytest.mark.slow
def test_several_steps_for_each_sample_become_one_if_accurate(evaluator, monkeypatch):
    monkeypatch.setattr("smajax.diagnosis.slotted_programs.start_compilation", lambda *_, **__: [])
    usual = evaluator.problem
    parts, plant = [part.recordings[0] for part in usual.splits], usual.base_problem.plant
    rig = read_rig(data_path("recordings", "dead-weight-unexplained") / "rig.toml")
    problem = DiagnosisProblem(plant, parts, rig.fit, interpolation=rig.interpolation, step=0.01)
    fine, evaluated = problem.problems, []
    problem.lengthen_steps(lambda problem: evaluated.append(problem) or False)
    assert problem.problems is fine and len(evaluated) == 1
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
    # Strided problems have even longer steps; one step for each sample stays as it is.
    assert int(problem.strided_problem(2).data.end_index) < 0.6 * int(problem.problems[0].data.end_index)
    before = problem.problems
    problem.lengthen_steps(lambda problem: pytest.fail("there is nothing to lengthen"))
    assert problem.problems is before


@pytest.mark.slow
def test_confusable_effects_are_swapped_near_the_noise(evaluator, fitted, monkeypatch):
    """The first effect may be the wrong one of two similar effects; at the noise, or far from it, nothing is refitted."""

    def trial(*keys, chi2):
        effect_set = EffectSet(keys, tuple((f"effects.{k}.strength", 1.0) for k in keys))
        return CandidateFit(dataclasses.replace(fitted, effect_set=effect_set), chi2, chi2, 1.0)

    refitted: list[str] = []

    def refits(_, fit):
        refitted.append(fit.key)
        return [trial(*fit.keys[:-1], "sensor-lag", chi2=1.01)] if fit.key == "time-skew" else []

    monkeypatch.setattr("smajax.diagnosis.backward_elimination.refit_confusable_effects", refits)
    monkeypatch.setattr(evaluator, "refit_to_convergence", lambda fit: fit)
    first = evaluator.evaluate(fitted)
    for chi2, swapped in ((1.6, ["time-skew"]), (1.02, []), (40.0, [])):
        state = SelectionState(
            {}, {}, first, trial("time-skew", "latent-heat", chi2=chi2), 1.1, {}, equivalent={"time-skew": ("creep",)}
        )
        refitted.clear()
        swap_confusable_effects(evaluator, state)
        assert refitted == swapped
        assert state.accepted == (("latent-heat", "sensor-lag") if swapped else ("time-skew", "latent-heat"))
        assert state.equivalent == ({} if swapped else {"time-skew": ("creep",)})
        assert [(r.key, r.code, r.others) for r in state.rejected] == [
            (k, RejectionCode.swapped, ("sensor-lag",)) for k in swapped
        ]


@pytest.mark.slow
def test_expected_chi2_includes_the_uncertainty_of_the_parameters(evaluator, fitted):
    assert 1.0 <= expected_reduced_chi2(evaluator, fitted, 1) < 1.1


@pytest.mark.slow
def test_nonparametric_term_locates_missing_heat(evaluator, fitted):
    scores = evaluator.scores(fitted)
    shares = evaluator.stage_shares(fitted, scores)
    assert all(0.0 <= v <= 1.0 for v in shares.values())
    assert most_likely_stage(shares) == "heat" and shares["heat"] > 0.5
    term = fit_nonparametric_term(evaluator.problem, fitted, scores.basis, scores.residual, "heat")
    assert term is not None
    assert (term.stage, term.kind, term.unit) == ("heat", "free-heat", "W/m^3")
    assert len(term.positions) == len(term.values) >= 3
    assert term.train_chi2 < 0.8 * evaluator.problem.reduced_chi2(fitted.residual, 0)


@pytest.mark.slow
def test_next_experiment_stays_within_limits_and_distinguishes_effects(evaluator, fitted):
    problem = evaluator.problem
    train = problem.splits[0].recordings[0]
    for recording in next_experiment.input_library(train, ("current",), 3):
        current = recording.channels["current"]
        assert len(recording) == len(train)
        assert train.channels["current"].min() <= current.min() and current.max() <= train.channels["current"].max()
    rivals = {k: {f"effects.{k}.strength": problem.effects[k].typical} for k in ("latent-heat", "heat-capacity")}
    experiment = next_experiment.propose_experiment(problem, fitted, rivals, 0)
    assert experiment is not None and set(experiment.separates) == set(rivals)
    assert (experiment.recording is None) == ("no input within these limits" in experiment_text(experiment))
    if experiment.recording is not None:
        limit = max(float(problem.states(fitted, _first(problem.problems[k])).temperature.max()) for k in (0, 1))
        inputs = problem.problem_for_inputs(experiment.recording)
        assert inputs is not None
        assert float(problem.states(fitted, _first(inputs)).temperature.max()) <= limit + 1.0
    assert next_experiment.propose_experiment(problem, fitted, {"latent-heat": {}}, 0) is None


def _first(problem):
    return jax.tree.map(lambda leaf: leaf[0], problem.data.inputs)


@pytest.mark.slow
def test_cause_is_selected_although_the_base_fit_does_not_converge(evaluator, monkeypatch):
    """Each effect is refitted from the rig's own values at its typical strength; without a cause, nothing is selected."""
    evaluator.problem.wait_for_compilation()
    few = ("latent-heat", "backlash", "encoder-drift", "ambient-drift")
    monkeypatch.setattr(evaluator.problem, "effects", {k: evaluator.problem.effects[k] for k in few})
    monkeypatch.setattr("smajax.diagnosis.base_fit.is_stationary", lambda *_: False)
    monkeypatch.setattr("smajax.diagnosis.candidates.AT_NOISE", 0.0)  # as if the first refits had failed
    messages: list[str] = []
    _, state = select_effects(evaluator.problem, report_progress=messages.append)
    assert not state.base_fit_converged and any("did not converge" in text for text in messages)
    assert "round 1: refitting them from the rig's own values" in messages
    assert state.accepted == ("latent-heat",) and state.current.total_chi2 < 2.2
    state.current = state.base_fit
    monkeypatch.setattr("smajax.diagnosis.outcome.select_effects", lambda *_, **__: (evaluator, state))
    # A structure would be fitted next, whose programs take minutes to compile.
    monkeypatch.setattr("smajax.diagnosis.structured_selection.may_have_structure", lambda *_: False)
    with pytest.raises(NumericsError, match="did not converge") as error:
        diagnose(evaluator.problem)
    assert set(error.value.state) == {u.label for u in evaluator.problem.base_problem.unknowns}


def planted(problem: DiagnosisProblem, fitted: Refit, effect_set: EffectSet, parts: tuple[int, ...]) -> list:
    """The problems of the splits, some with measurements simulated with a set of effects and white noise."""
    problems = list(problem.problems)
    for k in parts:
        change = problem.predict(effect_set, fitted.base, k)
        weight = np.asarray(problems[k].data.weight)
        noise = np.random.default_rng(6 + k).normal(size=weight.shape)
        measured = np.asarray(problems[k].data.measured) - (change.reshape(weight.shape) + noise) / np.where(
            weight > 0.0, weight, np.inf
        )
        problems[k] = dataclasses.replace(
            problems[k], data=eqx.tree_at(lambda d: d.measured, problems[k].data, measured)
        )
    return problems


@pytest.mark.slow
def test_onset_time_is_refined_where_the_cost_is_flat(evaluator, fitted, monkeypatch):
    """The airflow changes while the wire is cold: the selection recording determines the onset, the training hardly."""
    problem, name = evaluator.problem, "effects.airflow-change.instant"
    airflow = EffectSet().with_effect("airflow-change", {"effects.airflow-change.strength": 0.4, name: 26.4})
    monkeypatch.setattr(problem, "problems", planted(problem, fitted, airflow, (0, 1, 2)))
    displaced = airflow.with_values({name: 27.35})
    trial = evaluator.evaluate(
        Refit(displaced, fitted.base, *problem.evaluate(displaced, fitted.base, 0), SolverStatus.converged)
    )
    near = refine_onsets(evaluator, trial)
    assert near.train_chi2 < trial.train_chi2 < 1.1 and abs(near.refit.values[name] - 26.4) < 0.75
    # The derivative at the fitted onset underestimates the error of a prediction; all onsets of equal cost count.
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


@pytest.mark.slow
def test_onset_time_is_scanned_over_the_whole_recording(evaluator, fitted, monkeypatch):
    """A search that starts far from the onset ends elsewhere; one at the noise, or without an onset, is not scanned."""
    problem = evaluator.problem
    airflow = EffectSet().with_effect(
        "airflow-change", {"effects.airflow-change.strength": 0.4, "effects.airflow-change.instant": 21.3}
    )
    monkeypatch.setattr(problem, "problems", planted(problem, fitted, airflow, (0,)))
    displaced = problem.start_search(
        airflow.with_values({"effects.airflow-change.instant": 60.0}), fitted.base
    ).advance(8)
    scanned = [problem.refit_from(s) for s in scan_onset_times(evaluator, displaced)]
    assert len(scanned) == 1 and problem.reduced_chi2(scanned[0].residual, 0) < 1.1 < problem.reduced_chi2(
        problem.refit_from(displaced).residual, 0
    )
    assert scanned[0].values["effects.airflow-change.instant"] == pytest.approx(21.3, abs=0.05)
    assert scan_onset_times(evaluator, problem.start_search(airflow, fitted.base).advance(3)) == []
    assert (
        scan_onset_times(
            evaluator,
            problem.start_search(
                EffectSet().with_effect("backlash", {"effects.backlash.strength": 1e-5}), fitted.base
            ).advance(2),
        )
        == []
    )


@pytest.mark.slow
def test_coating_and_end_conduction_are_equivalent(evaluator, monkeypatch):
    """End conduction with other convection fits a coating as well, but the other parameters have to change much."""
    problem, rng = evaluator.problem, np.random.default_rng(0)
    planted = EffectSet(("coating",), (("effects.coating.strength", 0.2), ("effects.coating.time_constant", 4.0)))
    problems = []
    for k, split in enumerate(problem.problems):
        residual = problem.predict(planted, problem.nominal, k)
        weight = np.asarray(split.data.weight)
        change = np.where(
            weight > 0,
            (residual.reshape(weight.shape) + rng.standard_normal(weight.shape)) / np.where(weight > 0, weight, 1.0),
            0.0,
        )
        problems.append(eqx.tree_at(lambda p: p.data.measured, split, split.data.measured - change))
    monkeypatch.setattr(problem, "problems", problems)
    trial = evaluator.evaluate(problem.fit(planted, problem.nominal, max_steps=10, rtol=1e-8))
    assert trial.at_noise
    (same,) = (t for t in refit_confusable_effects(evaluator, trial) if t.key == "end-conduction")
    assert abs(same.total_chi2 - trial.total_chi2) * len(problem.counted_samples(trial.refit.residual)) < 2.0
    assert evaluator.log_distance_from_typical(trial) < evaluator.log_distance_from_typical(same)


def test_fit_that_diverges_under_another_input_does_not_predict():
    refits = [
        Refit(EffectSet(), np.full(1, k), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged) for k in range(3)
    ]
    chi2 = {0: (1.0, np.inf), 1: (np.nan, 1.0), 2: (1.0, 1.0)}
    problem = SimpleNamespace(
        predict=lambda effect_set, base, k: chi2[int(base[0])][k - 1], reduced_chi2=lambda residual, k: residual
    )
    assert first_predicting_refit(problem, *refits) is refits[2]
    assert first_predicting_refit(problem, *refits[:2]) is refits[1]


@pytest.mark.parametrize(
    ("keys", "train", "select", "holdout", "equivalent", "verdict"),
    [
        ((), 1.0, 1.0, 1.0, (), "nothing-missing"),
        ((), 4.0, 4.0, 4.0, (), "unresolved"),
        ((), 1.0, 1.0, 4.0, (), "unresolved"),  # only the holdout shows it
        (("latent-heat",), 1.0, 1.02, 1.02, (), "named"),
        (("latent-heat",), 1.0, 1.02, 1.02, ("heat-capacity",), "named-up-to-class"),
        (("latent-heat",), 1.0, 4.0, 1.02, (), "partial"),
        (("latent-heat",), 1.0, 1.02, 2.4, (), "partial"),  # a surrogate that fails under another input
        (("latent-heat",), 9.0, 9.0, 9.0, (), "partial"),
        (("latent-heat",), 80.0, 80.0, 80.0, (), "unresolved"),  # explains a fifth and is rejected
    ],
)
def test_verdicts(keys, train, select, holdout, equivalent, verdict):
    """See ``verdict_for``."""
    assert verdict_for(keys, train, select, holdout, equivalent, (1.0, 1.0)) == verdict


def test_verdict_allows_for_the_uncertainty_of_the_parameters():
    verdicts = {
        e: verdict_for(("latent-heat",), 1.0, 4.0, 3.0, (), e) for e in ((1.0, 1.0), (3.5, 1.0), (1.0, 2.8), (3.5, 2.8))
    }
    assert list(verdicts.values()) == ["partial", "partial", "partial", "named"]


@pytest.mark.parametrize(
    ("joint", "holdout", "verdict"),
    [
        ((1.1, 1.1), 1.1, "named"),
        ((1.1, 1.1), 1.35, "partial"),
        ((1.1, 1.4), 1.1, "partial"),
        ((1.4, 1.1), 1.1, "partial"),
    ],
)
def test_joint_fit_can_name_an_effect_that_the_training_fit_cannot(joint, holdout, verdict):
    assert verdict_for(("airflow-change",), 1.0, 60.0, holdout, (), (1.0, 1.0), joint) == verdict


@pytest.mark.parametrize(
    ("keys", "before", "after", "reason"),
    [
        ((), (2.0, 2.0), (1.999, 1.0), "no better than chance"),
        ((), (2.0, 2.0), (1.0, 1.9), "cuts the error on the selection recording by 2.5 %"),
        ((), (1.6, 1.7), (1.0, 1.0), ""),  # the first effect may be small
        (("latent-heat",), (1.6, 1.7), (1.0, 1.0), "by less than the noise, in addition to latent-heat"),
        (("latent-heat",), (1.6, 2.1), (1.0, 1.0), ""),
        (("latent-heat",), (90.0, 80.0), (70.0, 60.0), ""),  # one of several effects
        (
            ("latent-heat",),
            (2.5, 6.4),
            (1.3, 2.2),
            "explains 78 % of the small excess that latent-heat does not explain",
        ),
        (("latent-heat",), (2.5, 6.4), (1.1, 1.3), ""),
    ],
)
def test_rejection_reasons(keys, before, after, reason):
    rejected = rejection(trial(keys, *before), trial((*keys, "backlash"), *after), 4000)
    assert (rejected is not None) == bool(reason)
    assert rejected is None or (rejected.key == "backlash" and reason in rejection_text(rejected))


def test_undetermined_parameter_has_its_scale_as_standard_deviation():
    """Two parameters, the second without influence on the fitted split, and with some on the predicted one."""
    jacobians = {0: np.array([[100.0, 0.0], [100.0, 0.0]]), 1: np.array([[100.0, 3.0], [100.0, 0.0]])}
    problem = SimpleNamespace(
        evaluate=lambda effect_set, base, k, free: (np.zeros(2), jacobians[k]), free_effect_parameters=lambda effect_set: (), series=lambda column, k: {"motion": column},
        shared_count=2, size=2, bounds=(np.full(2, -np.inf), np.full(2, np.inf)),
    )  # fmt: skip
    refit = Refit(EffectSet(), np.zeros(2), np.zeros(2), jacobians[0], SolverStatus.converged)
    assert expected_reduced_chi2(CandidateEvaluator(problem, 0), refit, 1) == pytest.approx(
        1.0 + 0.5 + 0.5 * 3.0**2, rel=1e-3
    )


def test_refit_worse_than_its_parent_is_converged_first():
    held, other, hopeless = trial(("creep",), 12.0, 1.0), trial(("backlash",), 8.0, 8.0), trial(("slack",), 11.0, 30.0)
    evaluator = SimpleNamespace(refit_to_convergence=lambda fit: trial(fit.keys, 9.0, 20.0))
    fits = _converge_worse_fits(evaluator, [held, other, hopeless], trial((), 10.0, 10.0))  # pyright: ignore[reportArgumentType]
    assert [(t.keys, t.train_chi2) for t in fits] == [(("backlash",), 8.0), (("creep",), 9.0)]


@pytest.mark.parametrize(("joint", "kept"), [((1.0, 1.0), True), ((1.0, 40.0), False), ((30.0, 1.0), False)])
def test_open_fits_are_refitted_jointly(joint, kept, monkeypatch):
    """An onset while nothing moves may spoil the cause's prediction; a surrogate cannot fit both splits."""
    cause, surrogate, refitted = trial(("creep",), 0.9, 4000.0), trial(("encoder-gain",), 20.0, 130.0), []
    monkeypatch.setattr("smajax.diagnosis.forward_selection.refit_jointly", lambda problem, refit: refit)
    evaluator = SimpleNamespace(
        problem=None,
        evaluate=lambda refit: refitted.append(refit.effect_set.keys) or trial(refit.effect_set.keys, *joint),
    )
    fits = _refit_open_fits_jointly(evaluator, [surrogate, cause], 1.25)  # pyright: ignore[reportArgumentType]
    assert refitted == [("creep",)] and fits[0] is surrogate
    assert (fits[1].train_chi2, fits[1].select_chi2) == (joint if kept else (0.9, 4000.0))
    named = trial(("creep",), 1.0, 1.0)
    assert _refit_open_fits_jointly(evaluator, [cause, named], 1.25) == [cause, named] and len(refitted) == 1  # pyright: ignore[reportArgumentType]


@pytest.mark.parametrize(
    ("train", "select", "again"),
    [(4.0, 20.0, False), (20.0, 32.0, True), (4.0, 170.0, True), (1.0, 1.0, False)],
)
def test_effects_are_refitted_from_typical_strengths_unless_one_explains_half(train, select, again, monkeypatch):
    """A surrogate may improve the prediction of a biased base fit while the score of the cause is 0 there."""
    strengths: list[list[float]] = []

    def halving(_, near, far=()):
        strengths.append([candidate.strength for candidate in (*near, *far)])
        return [trial(("wire-crosstalk",), train, select)]

    first = trial((), 24.0, 175.0)
    state = SelectionState({}, {}, first, first, 1.05, {"wire-crosstalk": NominalScore(1.0, 0.1, ())})
    problem = SimpleNamespace(shape_grid=lambda key: [()], plausible_range=lambda key: (0.0, 9.0))
    score = SimpleNamespace(minimum_detectable_strength=0.1, strength=0.3, gain=5.0)
    scores = SimpleNamespace(best={"wire-crosstalk": score}, shapes={"wire-crosstalk": ()})
    monkeypatch.setattr("smajax.diagnosis.forward_selection.successive_halving", halving)
    fits = _fit_single_effects(SimpleNamespace(problem=problem), state, scores, lambda text: None)  # pyright: ignore[reportArgumentType]
    assert strengths == ([[0.3, 0.1], [1.0]] if again else [[0.3, 0.1]]) and len(fits) == len(strengths)


def test_unneeded_effect_is_dropped_without_repeating_a_fit():
    """The fit before the last effect exists already; only fits without an earlier effect are made."""
    fitted_keys, pair = [], trial(("creep", "backlash"), 1.0, 1.0)
    problem = SimpleNamespace(samples=1000)
    evaluator = SimpleNamespace(
        problem=problem,
        stride=lambda train: 1,
        fit=lambda effect_set, base, stride: fitted_keys.append(effect_set.keys),
        evaluate=lambda refit: trial(("backlash",), 1.0, 1.0),
    )
    state = SelectionState(
        {}, {}, trial((), 9.0, 9.0), pair, 1.05, {}, accepted_fits=[trial(("creep",), 3.0, 3.0), pair]
    )
    drop_unneeded_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert (state.accepted, fitted_keys) == (("backlash",), [("backlash",)])
    assert state.rejected == [Rejection("creep", RejectionCode.unneeded)]
    evaluator.evaluate, state.current, state.rejected = lambda refit: trial(("backlash",), 3.0, 3.0), pair, []
    drop_unneeded_effects(evaluator, state)  # pyright: ignore[reportArgumentType]
    assert (state.accepted, len(fitted_keys), state.rejected) == (("creep", "backlash"), 2, [])


def test_explained_share_without_a_finite_base_prediction():
    first, better = trial((), 11.0, math.nan), trial(("latent-heat",), 3.0, 40.0)
    assert SelectionState({}, {}, first, first, 1.05, {}).explained_by(better) == pytest.approx(0.8)
    first = trial((), 11.0, 21.0)
    assert SelectionState({}, {}, first, first, 1.05, {}).explained_by(
        trial(("latent-heat",), 3.0, 5.0)
    ) == pytest.approx(0.8)


@pytest.mark.parametrize(
    ("before", "after", "improves"),
    [(2.0, 1.0, True), (1.0, 1.0, False), (1.0, 2.0, False), (math.nan, 1.0, True), (1.0, math.nan, False)],
)
def test_effects_must_improve_the_holdout(before, after, improves):
    noise = np.random.default_rng(1).standard_normal((2, 1000))
    residuals = {(): before * noise[0], ("creep",): after * noise[1]}
    done, failed = SimulationStatus.done, SimulationStatus.overheated
    statuses = {(): failed if math.isnan(before) else done, ("creep",): failed if math.isnan(after) else done}
    problem = SimpleNamespace(
        report=lambda refit, k: (residuals[refit.effect_set.keys], statuses[refit.effect_set.keys]),
        series=lambda residual, k: {"motion": residual},
        channels=("motion",),
    )
    evaluator = SimpleNamespace(problem=problem, seed=0)
    assert improves_holdout(evaluator, trial((), 9.0, 9.0).refit, trial(("creep",), 9.0, 9.0).refit) == improves  # pyright: ignore[reportArgumentType]


def test_interval_of_the_improvement_contains_it_in_19_of_20_cases():
    """Residuals with an autocorrelation of 0.8; their RMSEs are 2 and 1. The interval has a finite number of blocks."""
    covered, rng = 0, np.random.default_rng(0)
    for _ in range(200):
        series = scipy.signal.lfilter([0.6], [1.0, -0.8], rng.standard_normal((2, 2100)))[:, 100:]
        low, high = bootstrap_cut(2.0 * series[0], series[1], seed=0, draws=300)
        covered += low < 1.0 < high
    assert 0.9 < covered / 200 < 0.98
    assert all(math.isnan(end) for end in bootstrap_cut(np.full(400, np.nan), series[1], seed=0))


def trial(keys, train, select):
    return CandidateFit(
        Refit(EffectSet(keys), np.zeros(1), np.zeros(1), np.zeros((1, 1)), SolverStatus.converged), train, select, 0.0
    )


# Predictions whose mean square is the reduced chi-squared of the fit.
EVALUATOR = SimpleNamespace(
    seed=0,
    problem=SimpleNamespace(
        predict=lambda effect_set, base, split: np.ones(200) * (0.1 if effect_set.keys else 1.0),
        counted_samples=lambda residual, split: residual,
    ),
)


def verdict_for(keys, train, select, holdout, equivalent, expected, joint=None):
    """The verdict for the reduced chi-squared of a fit on the three splits, where that of a perfect model is ``expected``.

    ``joint`` is that of the joint fit on the first two splits; by default that of the fit to the training split.
    """
    first = trial((), 100.0, 100.0) if keys else trial((), train, select)
    state = SelectionState(
        {}, {}, first, trial(keys, train, select), 1.05, {}, equivalent={k: equivalent for k in keys}
    )
    judge_effects(EVALUATOR, state)  # pyright: ignore[reportArgumentType]
    verdict = classify_outcome(state, (*(joint or (train, select)), holdout), expected)
    assert bool(state.accepted) == verdict.startswith(("named", "partial"))
    assert len(state.rejected) == (verdict == "unresolved" and bool(keys))
    return verdict
