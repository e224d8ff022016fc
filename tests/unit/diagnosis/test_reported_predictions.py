"""Predictions that fail, or that no wire has, are reported with their code and without numbers."""

import copy
import dataclasses
import json
import math

import numpy as np
import pytest

from smajax.diagnosis.base_fit import BaseFit
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet, Refit
from smajax.diagnosis.data_split import HOLDOUT, SELECT, TRAIN
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import Conclusion, summarise
from smajax.diagnosis.rising_convection import repeat_if_overheating
from smajax.diagnosis.selection_state import SelectionState
from smajax.files.rig_file import read_rig
from smajax.fitting.levenberg_marquardt import SolverStatus
from smajax.fitting.material_laws import with_law
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.report.diagnosis import diagnosis_document
from smajax.report.diagnosis_page import diagnosis_page
from smajax.report.diagnosis_series import prediction_series
from smajax.simulation.status import SimulationStatus

FOLDER = data_path("recordings", "dead-weight")


@pytest.fixture(scope="module")
def problem():
    """A wire whose holdout has a current by which it melts, and one effect."""
    rig = read_rig(FOLDER / "rig.toml")
    parts = [rig.read(FOLDER / f"{part}.csv").slice(0.0, 15.0) for part in ("train", "select", "holdout")]
    hot = parts[HOLDOUT].channels | {"current": 16.0 * parts[HOLDOUT].channels["current"]}
    parts[HOLDOUT] = dataclasses.replace(parts[HOLDOUT], channels=hot)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.diagnosis.problem.zero_terms", tuple)
        ratcheting = {"ratcheting": catalogue()["ratcheting"]}
        patch.setattr("smajax.diagnosis.effect_parameters.catalogue", lambda: ratcheting)
        settings = dataclasses.replace(rig.fit, noise={"displacement": 2e-5})
        return DiagnosisProblem(rig.plant, parts, settings, interpolation=rig.interpolation)


def refit_of(problem, effect_set):
    values = problem.evaluate(effect_set, problem.nominal, TRAIN, problem.free_effect_parameters(effect_set))
    return Refit(effect_set, problem.nominal, *values, SolverStatus.converged)


def test_a_prediction_beyond_the_limits_has_a_code_and_no_numbers(problem):
    refit = refit_of(problem, EffectSet())
    residual, status = problem.report(refit, SELECT)
    assert status is SimulationStatus.done
    assert residual == pytest.approx(problem.predict(EffectSet(), problem.nominal, SELECT), abs=1e-9)
    residual, status = problem.report(refit, HOLDOUT)
    assert status is SimulationStatus.overheated and np.all(np.isnan(residual))
    # A search still has the numbers: 1000 times the residual.
    assert np.all(np.isfinite(problem.predict(EffectSet(), problem.nominal, HOLDOUT)))
    growing = EffectSet(("ratcheting",), (("effects.ratcheting.strength", 0.1), ("effects.ratcheting.exponent", 1.0)))
    assert problem.report(refit_of(problem, growing), TRAIN)[1] is SimulationStatus.overstrained
    assert math.isnan(CandidateEvaluator(problem, 0).evaluate(refit_of(problem, growing)).rmse_select)


def base_fit_with(problem, h2):
    """A base fit that is the rig's own vector, but for h2 in W/m^2/K^3."""
    point = problem.nominal.copy()
    (i,) = [i for i, u in enumerate(problem.problems[TRAIN].unknowns) if u.name == "heat.h2"]
    point[i] = h2 / problem.problems[TRAIN].unknowns[i].scale
    return BaseFit(point, SolverStatus.converged, {"displacement": (2e-5, "rig file")}, True), i


def test_a_fit_whose_convection_falls_until_the_wire_melts_is_repeated_without_that(problem):
    whole, problem = problem, copy.copy(problem)
    falling, i = base_fit_with(problem, -1e-4)
    repeated = repeat_if_overheating(problem, falling, seed=0, starts=1)
    assert repeated.rising_convection == ("heat.h2",) and repeated.point[i] >= 0.0
    assert problem.bounds[0][i] == problem.base_problem.bounds[0][i] == problem.settings.bounds["heat.h2"][0] == 0.0
    assert problem.settings.bounds["heat.h2"][1] == problem.base_problem.unknowns[i].upper
    settings = with_law(problem.base_problem.plant, problem.settings, "liang-rogers")[1]
    assert settings.bounds["heat.h2"][0] == 0.0
    # The bounds of all other parameters stay, and the problem has nothing left to bound.
    others = np.arange(problem.size) != i
    assert np.array_equal(problem.bounds[0][others], whole.bounds[0][others]) and whole.bounds[0][i] < 0.0
    assert repeat_if_overheating(problem, falling, seed=0, starts=1) is falling


def test_a_fit_is_not_repeated_where_convection_rises_or_the_wire_stays_whole(problem):
    rising, _ = base_fit_with(problem, 1e-3)
    assert repeat_if_overheating(problem, rising, seed=0, starts=1) is rising
    cool = copy.copy(problem)
    cool.problems = [*problem.problems[:HOLDOUT], problem.problems[SELECT]]
    falling, _ = base_fit_with(cool, -1e-4)
    assert repeat_if_overheating(cool, falling, seed=0, starts=1) is falling
    assert "heat.h2" not in problem.settings.bounds
    cool.report = lambda fit, split: (fit.residual, SimulationStatus.diverged)
    assert repeat_if_overheating(cool, falling, seed=0, starts=1).rising_convection == ("heat.h2",)


def test_document_summary_and_page_have_the_code_in_place_of_the_error(problem):
    evaluator, refit = CandidateEvaluator(problem, 0), refit_of(problem, EffectSet())
    fit = evaluator.evaluate(refit)
    state = SelectionState({}, {"displacement": (2e-5, "rig file")}, fit, fit, 1.05, {})
    state.rising_convection = ("heat.h2",)
    diagnosis = summarise(evaluator, state, refit, refit, Conclusion("unresolved", "heat"))
    recordings = [split.recordings[0] for split in problem.splits]
    options = {"evidence": (), "left_out": {}, "misplaced": {}, "simulations": 1, "wall_time": 1.0, "seed": 0}
    document = json.loads(json.dumps(diagnosis_document(diagnosis, recordings, **options), allow_nan=False))
    errors = document["rmse"]["displacement"]
    assert errors["holdout_before"] is errors["holdout_after"] is None and errors["select_after"] > 0.0
    assert errors["holdout_cut_95"] == [None, None]
    assert [(f["recording"], f["when"], f["code"]) for f in document["failures"]] == [
        ("holdout.csv", when, "overheated") for when in ("before", "after")
    ]
    assert "the prediction of holdout.csv failed: overheated: the wire exceeded 1300 degC" in document["summary"]
    assert "On the holdout the error of displacement is unknown before and unknown after" in document["summary"]
    assert document["rising_convection"] == ["heat.h2"]
    assert "Convection was kept from falling with the temperature (heat.h2 of at least 0)" in document["summary"]
    series = prediction_series(recordings, diagnosis)
    assert all(np.all(np.isnan(s.model["displacement"])) == (s.role == "holdout") for s in series)
    run = {"inputs": ["current"], "argv": [], "started": "", "machine": "", "versions": {}, "timings": {}}
    assert "overheated" in diagnosis_page(document, series, run, "")
