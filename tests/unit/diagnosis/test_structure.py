"""Structure of the wire in a diagnosis, on a rough rig of the reference simulator, with one effect as a candidate."""

import dataclasses
import json
import tomllib

from experiments.common.rough_recordings import draw_rig, record

import numpy as np
import pytest

from smajax import parameters
from smajax.api.diagnose import DiagnosisStudy
from smajax.diagnosis import structure_choice
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.data_split import HOLDOUT, SELECT, TRAIN
from smajax.diagnosis.joint_refit import _minimise, refit_jointly
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.selection_state import CandidateSummary, SelectionState
from smajax.diagnosis.setup import diagnosed_rig
from smajax.diagnosis.structure import (
    ANGLE,
    CELLS,
    GRAINS,
    SHAPES,
    SPREADS,
    UNEVEN,
    VARIANTS,
    WIDTHS,
    Structure,
    are_settled,
    candidate_keys,
    fit_with_structure,
    held_values,
    holding,
    may_have_structure,
    structured_plant,
    structured_problem,
    with_structure,
)
from smajax.diagnosis.structure_choice import compare_variants, halves_excess, is_clear_improvement, joint_errors
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.report.diagnosis import diagnosis_document
from smajax.report.diagnosis_page import diagnosis_page
from smajax.report.diagnosis_series import prediction_series
from smajax.simulation.run import simulate
from tests.support import plants
from tests.unit.diagnosis.test_support import fit_of


@pytest.fixture(scope="module")
def rough():
    """A drawn dead weight, its recordings, and the problem of its diagnosis."""
    drawn = draw_rig("dead weight", [3, 11])
    rig = read_rig(tomllib.loads(drawn.text))
    recordings = [rig.read(recording) for recording in record(drawn, {})]
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.diagnosis.effect_parameters.catalogue", lambda: {"ratcheting": catalogue()["ratcheting"]})
        settings = dataclasses.replace(rig.fit, noise={"displacement": drawn.noise})
        yield rig, recordings, DiagnosisProblem(rig.plant, recordings, settings, interpolation=rig.interpolation)


@pytest.fixture(scope="module")
def diagnosis(rough):
    problem = rough[2]
    return diagnose(problem, known_noise=problem.noise)


@pytest.fixture(scope="module")
def structured(rough):
    """The same problem with cells and grains."""
    return structured_problem(rough[2], state_of(9.0))


def test_a_training_split_at_the_noise_does_not_exclude_a_structure():
    assert halves_excess(state_of(2.0), fit_of(("ratcheting",), 1.9))
    assert not halves_excess(state_of(9.0), fit_of(("ratcheting",), 8.0))
    assert halves_excess(state_of(9.0), fit_of(("ratcheting",), 4.0))


@pytest.mark.slow
def test_a_joint_refit_also_starts_at_the_rig_s_own_values(rough):
    """A fit of the training split may lie where no search finds the way back to both splits' optimum."""
    problem = rough[2]
    far = problem.nominal.copy()
    names = [unknown.name for unknown in problem.problems[TRAIN].unknowns]
    far[names.index("material.austenite_shift")] -= (
        60.0 / problem.problems[TRAIN].unknowns[names.index("material.austenite_shift")].scale
    )
    start = problem.fit(EffectSet(), problem.nominal, max_steps=1)
    costs = [
        sum(problem.reduced_chi2(problem.predict(EffectSet(), joint.base, k), k) for k in (TRAIN, SELECT))
        for joint in (refit_jointly(problem, dataclasses.replace(start, base=base)) for base in (problem.nominal, far))
    ]
    assert costs[1] <= 1.01 * costs[0]


@pytest.mark.slow
def test_only_joint_refits_fit_the_shapes_of_grains(structured):
    """Fits to the training split hold them at 0."""
    evaluator = CandidateEvaluator(structured, 0)
    first = structured.fit(EffectSet(), structured.nominal, max_steps=1)
    evaluator.base_refit(first.base, first.status)
    names = np.array([unknown.name for unknown in structured.problems[TRAIN].unknowns])
    is_shape = np.isin(names, SHAPES)
    np.testing.assert_array_equal(first.base[is_shape], 0.0)
    without = refit_jointly(structured, first, shapes=False)
    with_shapes = _minimise(structured, without, shapes=True)
    np.testing.assert_array_equal(without.base[is_shape], 0.0)
    assert np.all(np.abs(with_shapes.base[is_shape]) > 1e-3) and np.all(np.abs(with_shapes.base[is_shape]) < 3.0)
    left = [
        [structured.reduced_chi2(structured.predict(EffectSet(), joint.base, k), k) for k in (TRAIN, SELECT, HOLDOUT)]
        for joint in (without, with_shapes)
    ]
    assert sum(left[1][:2]) < 0.8 * sum(left[0][:2]) and left[1][2] < left[0][2]
    free = [evaluator.free_columns(with_shapes, jointly=jointly)[is_shape] for jointly in (False, True)]
    assert not free[0].any() and free[1].all()
    has_prior = np.isfinite(structured.joint_prior.deviations)
    assert all(name.startswith(("grains.", "cells.")) for name in names[has_prior]) and 0 < has_prior.sum() < len(names)


def state_of(chi2: float, ranking: dict[str, tuple[float, float]] | None = None) -> SelectionState:
    state = SelectionState({}, {}, fit_of((), chi2), fit_of((), chi2), 1.05, {})
    for key, (error, gain) in (ranking or {}).items():
        state.ranking[key] = CandidateSummary(None, gain=gain, refit_rmse_select=error)  # pyright: ignore[reportArgumentType]
    return state


@pytest.mark.slow
def test_structure_is_asked_for_where_more_than_noise_remains(rough):
    rig, _, problem = rough
    assert may_have_structure(problem, state_of(9.0))
    assert not may_have_structure(problem, state_of(1.2))
    stopped = state_of(9.0)
    stopped.interrupted = True
    assert not may_have_structure(problem, stopped)
    plant = with_structure(rig.plant)
    assert (plant.cells.count, plant.grains.count) == (CELLS, GRAINS)


def test_candidates_next_to_a_structure_are_the_facts_or_else_the_best_of_the_first_round():
    ranking = {"end-conduction": (0.1, 90.0), "creep": (0.2, 5.0), "slack": (0.3, 50.0), "radiation": (0.9, 1.0)}
    state = state_of(9.0, ranking)
    assert candidate_keys(state) == ("creep", "slack", "radiation")
    state.current = fit_of(("slack",), 4.0)
    assert are_settled(state) and candidate_keys(state) == ("slack",)
    # Cold ends of a wire of one cell may have absorbed another effect.
    state.current = fit_of(("slack", "end-conduction"), 4.0)
    assert not are_settled(state) and candidate_keys(state) == ("slack", "creep", "radiation")


@pytest.mark.slow
def test_variants_run_on_one_program_and_hold_what_they_lack(rough, structured):
    """The variant with neither predicts as the rig without structure; the others do not."""
    _, _, problem = rough
    expected = problem.predict(EffectSet(), problem.nominal, SELECT)
    size, differences = np.sqrt(np.mean(expected**2)), {}
    for variant in VARIANTS:
        held = holding(structured, held_values(variant, has_cells=True))
        lower, upper = held.bounds
        names = [unknown.name for unknown in held.problems[TRAIN].unknowns]
        fixed = {name for name, low, high in zip(names, lower, upper, strict=True) if low == high}
        one_grain = {*SPREADS, *WIDTHS, ANGLE} if variant in ("neither", "cells") else set()
        assert fixed == one_grain | {*SHAPES} | ({UNEVEN} if variant in ("neither", "grains") else set())
        free_jointly = {n for n, low, high in zip(names, *held.joint_bounds, strict=True) if low < high}
        assert free_jointly & {*SHAPES} == ({*SHAPES} if variant in ("grains", "both") else set())
        assert not free_jointly & one_grain
        difference = held.predict(EffectSet(), held.nominal, SELECT) - expected
        differences[variant] = np.sqrt(np.mean(difference**2)) / size
    # Near 0: the insulating wire has a conductivity of 1e-3 W/m/K.
    assert differences["neither"] < 1e-2 * differences["cells"]
    assert min(differences[v] for v in ("cells", "grains", "both")) > 0.02
    assert all((low == high) == (n in SHAPES) for n, low, high in zip(names, *structured.bounds, strict=True))
    assert all(low < high for low, high in zip(*structured.joint_bounds, strict=True))


@pytest.mark.slow
def test_a_rough_rig_needs_a_structure_and_nothing_else(rough, diagnosis):
    rig, _, _ = rough
    assert diagnosis.structure.variant != "neither"
    assert diagnosis.effects == VARIANTS[diagnosis.structure.variant]
    assert {float(parameters.get(diagnosis.plant, name)) for name in WIDTHS} == {1.0}
    assert diagnosis.verdict == "partial" and not diagnosis.holdout_decided
    errors = diagnosis.structure.errors
    assert errors[diagnosis.structure.variant] < 0.95 * errors["neither"]
    rmse = diagnosis.rmse["displacement"]
    assert rmse["select_after"] < 0.95 * rmse["select_before"]
    found = diagnosed_rig(rig, diagnosis.plant, ())
    assert (found.plant.grains is not None) == (diagnosis.structure.grains > 1)
    again = read_rig(tomllib.loads(found.to_toml()))
    assert (again.plant.cells is None, again.plant.grains is None) == (
        found.plant.cells is None,
        found.plant.grains is None,
    )
    assert set(SPREADS) <= set(again.fit.free)


@pytest.mark.parametrize(("start", "width"), [(25e6, 1.0), (0.0, 1.3)])
def test_factors_on_widths_stay_where_the_law_would_leave_its_bounds(start, width):
    plant = with_structure(plants.dead_weight(detwinning_start_stress=start))
    plant = parameters.replace(plant, {"grains.martensite_width": 1.3})
    found = structured_plant(plant, Structure("grains", 1, GRAINS, {"neither": 9.0, "grains": 1.0}))
    assert float(parameters.get(found, "grains.martensite_width")) == pytest.approx(width)
    assert float(parameters.get(found, "material.detwinning_start_stress")) >= 0.0 and found.cells is None


@pytest.mark.slow
def test_error_budget_goes_from_a_naive_forecast_to_the_last_fit(rough, diagnosis):
    _, recordings, _ = rough
    entries = diagnosis.error_budget
    assert [entry.added for entry in entries] == ["naive", "base", "structure"]
    train, holdout = (recordings[k].channels["displacement"] for k in (TRAIN, HOLDOUT))
    naive = np.sqrt(np.mean((holdout - np.mean(train)) ** 2))
    assert entries[0].errors["displacement"]["holdout"] == pytest.approx(naive, rel=1e-9)
    rmse = diagnosis.rmse["displacement"]
    for entry, when in ((entries[1], "before"), (entries[2], "after")):
        for split in ("train", "select", "holdout"):
            assert entry.errors["displacement"][split] == pytest.approx(rmse[f"{split}_{when}"], rel=1e-9)
    last = entries[2]
    fall = rmse["holdout_before"] - rmse["holdout_after"]
    assert last.cut_if_last["displacement"]["holdout"] == pytest.approx(fall, rel=1e-9)
    low, high = last.cut95["displacement"]
    assert low < high and not entries[1].cut95


@pytest.mark.slow
def test_document_and_page_have_structure_and_budget(rough, diagnosis):
    _, recordings, _ = rough
    options = {"evidence": (), "left_out": {}, "misplaced": {}, "simulations": 1, "wall_time": 1.0, "seed": 0}
    document = json.loads(json.dumps(diagnosis_document(diagnosis, recordings, **options), allow_nan=False))
    assert document["structure"]["variant"] == diagnosis.structure.variant
    assert document["effects"] == list(diagnosis.effects)
    errors = document["error_budget"][-1]["channels"]["displacement"]
    assert errors["holdout"] == pytest.approx(document["rmse"]["displacement"]["holdout_after"])
    assert "The wire has" in document["summary"] and "times the noise" in document["summary"]
    study = DiagnosisStudy(document=document, series=(), run={}, files={}, reason="")
    assert study.structure == diagnosis.structure.variant
    assert study.candidates == tuple(s.key for s in diagnosis.supports if not s.is_fact)
    assert list(study.error_budget) == ["naive", "base", "structure"]
    run = {"inputs": ["current"], "argv": [], "started": "", "machine": "", "versions": {}, "timings": {}}
    page = diagnosis_page(document, prediction_series(recordings, diagnosis), run, "")
    assert "Error budget of displacement" in page and '"waterfall"' in page.replace(" ", "")


@pytest.mark.slow
def test_fits_to_both_splits_decide_where_the_training_split_does_not_determine_the_structure(
    rough, structured, diagnosis, monkeypatch
):
    _, recordings, problem = rough
    evaluators = [CandidateEvaluator(p, 0) for p in (problem, structured)]
    base = evaluators[0].evaluate(problem.fit(EffectSet(), problem.nominal))
    state = SelectionState({}, problem.noise, base, base, 1.05, {})
    fit = fit_with_structure(evaluators[1], EffectSet(), base)
    # As if the prediction of the selection split said nothing.
    monkeypatch.setattr(structure_choice, "clearly_better", lambda *_: False)
    assert halves_excess(state, fit) and not is_clear_improvement(evaluators[0], state, evaluators[1], fit)
    assert is_clear_improvement(evaluators[0], state, evaluators[1], fit, jointly=True)
    structure, _, found = compare_variants(evaluators[0], state, evaluators[1], fit, jointly=True)
    assert structure.variant == "both" and structure.jointly and found is fit
    assert structure.errors["both"] - 1.0 < 0.5 * (structure.errors["neither"] - 1.0)
    assert compare_variants(evaluators[0], state, evaluators[1], fit)[0].variant == "neither"
    assert joint_errors((evaluators[1], fit), (evaluators[0], base)) is None
    options = {"evidence": (), "left_out": {}, "misplaced": {}, "simulations": 1, "wall_time": 1.0, "seed": 0}
    document = diagnosis_document(dataclasses.replace(diagnosis, structure=structure), recordings, **options)
    assert document["structure"]["jointly"]
    assert "in fits to training and selection recording together" in document["summary"]


def test_a_wire_of_prescribed_temperature_gets_grains_and_no_cells():
    """Its temperature is an input, the same all along the wire; with cells the simulation would fail."""
    folder = data_path("recordings", "isobaric")
    rig = read_rig(folder / "rig.toml")
    plant = with_structure(rig.plant)
    assert plant.cells is None
    assert plant.grains is not None and plant.grains.count == GRAINS
    strain = simulate(plant, rig.read(folder / "train.csv")).channels["strain"]
    assert np.all(np.isfinite(np.asarray(strain)))
