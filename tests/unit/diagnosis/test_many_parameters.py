"""Sets of effects with more parameters than the usual compiled program has slots."""

import dataclasses

import equinox as eqx
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.diagnosis import slotted_programs
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.forward_selection import _free_held_parameters
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import effect_intervals
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path

TRUTH = {
    "effects.r-phase.strength": 0.006,
    "effects.r-phase.above": 12.0,
    "effects.r-phase.width": 10.0,
    "effects.r-phase.kept": 0.5,
    "effects.r-phase.hump": 0.1,
    "effects.coating.strength": 0.3,
    "effects.coating.time_constant": 3.0,
}
PAIR = EffectSet(("r-phase", "coating"), tuple(TRUTH.items()))


@pytest.fixture(scope="module")
def problem() -> DiagnosisProblem:
    """The demo's rig and inputs, with measurements simulated with an R-phase and a coating, and white noise."""
    folder = data_path("recordings", "dead-weight-unexplained")
    rig = read_rig(folder / "rig.toml")
    recordings = [rig.read(folder / f"{name}.csv") for name in ("train", "select", "holdout")]
    few = {key: catalogue()[key] for key in (*PAIR.keys, "latent-heat")}  # few effects compile fast
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("smajax.diagnosis.effect_parameters.catalogue", lambda: few)
        problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    problem.wait_for_compilation()
    for k, split in enumerate(problem.problems):
        weight, rng = np.asarray(split.data.weight), np.random.default_rng(k)
        change = problem.predict(PAIR, problem.nominal, k).reshape(weight.shape) + rng.standard_normal(weight.shape)
        measured = np.asarray(split.data.measured) + change / np.where(weight > 0.0, weight, np.inf)
        problem.problems[k] = eqx.tree_at(lambda p: p.data.measured, split, jnp.asarray(measured))
    return problem


def test_all_parameters_are_free_and_have_intervals(problem, monkeypatch):
    compiled: list[int] = []
    start = slotted_programs.start_compilation

    def start_compilation(model, vector):
        compiled.append(model.slot_matrix.shape[1])
        return start(model, vector)

    monkeypatch.setattr(slotted_programs, "start_compilation", start_compilation)
    evaluator = CandidateEvaluator(problem, 0)
    displaced = PAIR.with_values({"effects.coating.time_constant": 5.0, "effects.r-phase.strength": 0.004})
    # A search among candidates uses the usual program and holds what has no slot; nothing else is compiled.
    search = problem.start_search(displaced, problem.nominal).advance(20)
    raced = evaluator.evaluate(problem.refit_from(search))
    assert raced.refit.values["effects.coating.time_constant"] == 5.0 and problem.holds_parameters(raced.refit)
    assert len(problem.free_effect_parameters(PAIR)) == len(TRUTH) > SLOTS and compiled == []
    at_noise = dataclasses.replace(raced, train_chi2=1.0, select_chi2=1.0)
    assert _free_held_parameters(evaluator, at_noise, [raced]) == [raced] and compiled == []
    # The fit that counts frees them all.
    (freed,) = _free_held_parameters(evaluator, raced, [raced])
    assert compiled == [2 * SLOTS] and not problem.holds_parameters(freed.refit)
    assert freed.train_chi2 < raced.train_chi2 and freed.train_chi2 < 1.1
    assert evaluator.with_all_parameters_free(freed) is freed
    intervals = effect_intervals(evaluator, freed.refit)
    assert set(intervals) == set(TRUTH)
    low, high = intervals["effects.coating.time_constant"]
    assert low < TRUTH["effects.coating.time_constant"] < high and high - low < 3.0
    # The next round scores the other effects at this fit.
    assert evaluator.scores(freed.refit).jacobian.shape == (problem.samples, problem.size + len(TRUTH))
    residual, jacobian = problem.evaluate(PAIR, problem.nominal, TRAIN, list(TRUTH))
    assert jacobian.shape == (len(residual), problem.size + len(TRUTH)) and compiled == [2 * SLOTS]
