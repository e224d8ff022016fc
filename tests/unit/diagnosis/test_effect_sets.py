"""Sets of effects beyond the usual: more parameters than the compiled program has slots, and effects of a user."""

import dataclasses
import math
from types import SimpleNamespace

import jax
import jax.numpy as jnp
import jsonschema
import numpy as np
import pytest

from smajax import parameters
from smajax.diagnosis import effect_parameters, slotted_programs
from smajax.diagnosis.bootstrap import bootstrap_cut
from smajax.diagnosis.candidate_evaluation import CandidateEvaluator
from smajax.diagnosis.candidates import EffectSet
from smajax.diagnosis.compiled_model import SLOTS
from smajax.diagnosis.data_split import TRAIN
from smajax.diagnosis.forward_selection import _free_held_parameters
from smajax.diagnosis.outcome import diagnose
from smajax.diagnosis.problem import DiagnosisProblem
from smajax.diagnosis.result import _cuts, effect_intervals
from smajax.files.rig_file import read_rig
from smajax.parameters import parameter
from smajax.plant.effects import catalogue
from smajax.plant.effects.base import HeatEffect
from smajax.recordings.datasets import data_path
from smajax.report.diagnosis import diagnosis_document
from smajax.report.diagnosis_page import diagnosis_page
from smajax.report.diagnosis_series import prediction_series
from smajax.report.diagnosis_summary import sentences
from smajax.report.documents.schemas import schemas

PAIR = EffectSet(
    ("r-phase", "coating"),
    (
        ("effects.r-phase.strength", 0.006),
        ("effects.r-phase.above", 12.0),
        ("effects.r-phase.width", 10.0),
        ("effects.r-phase.kept", 0.5),
        ("effects.r-phase.hump", 0.1),
        ("effects.coating.strength", 0.3),
        ("effects.coating.time_constant", 3.0),
    ),
)
FREE = {name for name, _ in PAIR.values}
PERIOD = 11.0


class PeriodicDraught(HeatEffect):
    """A draught that comes and goes, as a user would add it: with what an effect must have, and no more."""

    strength: jax.Array = parameter("1", "amplitude of the draught, as a share of convection", -1.0, 1.0, 0.0)
    key = "periodic-draught"
    typical = 0.1
    source = "a fan that turns"

    def power(self, state, memory, context):
        """Return the heat added to the wires, W/m^3."""
        conductance = context.heat.conductance(context.environment.ambient, context.wire)
        excess = state.temperature - context.environment.ambient
        return -self.strength * conductance * excess * jnp.sin(2.0 * math.pi / PERIOD * state.time)


@pytest.fixture(scope="module")
def rig():
    """The demo's rig, with the user's effect at strength 0; few other effects, since these compile fast."""
    few = {key: catalogue()[key] for key in (*PAIR.keys, "latent-heat")}
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(effect_parameters, "catalogue", lambda: few)
        rig = read_rig(data_path("recordings", "dead-weight-unexplained") / "rig.toml")
        yield dataclasses.replace(rig, plant=dataclasses.replace(rig.plant, effects=(PeriodicDraught(),)))


@pytest.fixture(scope="module")
def recordings(rig):
    """The demo's recordings, whose outputs are replaced by simulated ones."""
    folder = data_path("recordings", "dead-weight-unexplained")
    return [rig.read(folder / f"{name}.csv") for name in ("train", "select", "holdout")]


def problem_with(rig, recordings, effect_set: EffectSet) -> tuple[DiagnosisProblem, list]:
    """A problem, and its recordings, with displacements simulated with effects and white noise of 0.02 mm."""
    problem = DiagnosisProblem(rig.plant, recordings, rig.fit, interpolation=rig.interpolation)
    problem.wait_for_compilation()
    simulated = []
    for k, recording in enumerate(recordings):
        change = problem.series(problem.predict(effect_set, problem.nominal, k), k)["displacement"]
        exact = recording.channels["displacement"] - change * problem.noise["displacement"]
        noisy = exact + 2e-5 * np.random.default_rng(k).standard_normal(len(exact))
        channels = {**recording.channels, "displacement": noisy}
        simulated.append(dataclasses.replace(recording, channels=channels, sha256=str(k)))
    return DiagnosisProblem(rig.plant, simulated, rig.fit, interpolation=rig.interpolation), simulated


@pytest.mark.slow
def test_all_parameters_are_free_and_have_intervals(rig, recordings, monkeypatch):
    problem, _ = problem_with(rig, recordings, PAIR)
    problem.wait_for_compilation()
    problem.set_noise({"displacement": 2e-5})
    compiled: list[int] = []
    start = slotted_programs.start_compilation

    def start_compilation(model, vector, **options):
        compiled.append(model.slot_matrix.shape[1])
        return start(model, vector, **options)

    monkeypatch.setattr(slotted_programs, "start_compilation", start_compilation)
    evaluator = CandidateEvaluator(problem, 0)
    displaced = PAIR.with_values({"effects.coating.time_constant": 5.0, "effects.r-phase.strength": 0.004})
    # A search among candidates uses the usual program and holds what has no slot; nothing else is compiled.
    search = problem.start_search(displaced, problem.nominal).advance(20)
    partial_fit = evaluator.evaluate(problem.refit_from(search))
    assert partial_fit.refit.values["effects.coating.time_constant"] == 5.0 and problem.holds_parameters(
        partial_fit.refit
    )
    assert len(problem.free_effect_parameters(PAIR)) == len(FREE) > SLOTS and compiled == []
    at_noise = dataclasses.replace(partial_fit, train_chi2=1.0, select_chi2=1.0)
    assert _free_held_parameters(evaluator, at_noise, [partial_fit]) == [partial_fit] and compiled == []
    # The fit that is reported has all of them free.
    (free_fit,) = _free_held_parameters(evaluator, partial_fit, [partial_fit])
    assert compiled == [2 * SLOTS] and not problem.holds_parameters(free_fit.refit)
    assert free_fit.train_chi2 < partial_fit.train_chi2 and free_fit.train_chi2 < 1.1
    assert evaluator.with_all_parameters_free(free_fit) is free_fit
    intervals = effect_intervals(evaluator, free_fit.refit)
    assert set(intervals) == FREE
    low, high = intervals["effects.coating.time_constant"]
    assert low < 3.0 < high and high - low < 3.0
    # The next round scores the other effects at this fit.
    assert evaluator.scores(free_fit.refit).jacobian.shape == (problem.samples, problem.size + len(FREE))
    residual, jacobian = problem.evaluate(PAIR, problem.nominal, TRAIN, sorted(FREE))
    assert jacobian.shape == (len(residual), problem.size + len(FREE)) and compiled == [2 * SLOTS]


@pytest.mark.slow
def test_effect_of_a_user_is_named(rig, recordings):
    truth = EffectSet(("periodic-draught",), (("effects.periodic-draught.strength", 0.15),))
    problem, simulated = problem_with(rig, recordings, truth)
    diagnosis = diagnose(problem)
    assert diagnosis.effects == ("periodic-draught",) and diagnosis.verdict == "named"
    assert {d.key for d in diagnosis.detectability} == {*PAIR.keys, "latent-heat", "periodic-draught"}
    (estimate,) = diagnosis.estimates
    assert estimate.name == "effects.periodic-draught.strength" and estimate.unit == "1"
    assert estimate.interval is not None and estimate.interval[0] < 0.15 < estimate.interval[1]
    plant = problem.fitted_plant(diagnosis.after)
    assert [type(effect) for effect in plant.effects] == [PeriodicDraught]
    assert float(parameters.get(plant, estimate.name)) == pytest.approx(0.15, rel=0.05)
    document = diagnosis_document(
        diagnosis, simulated, evidence=(), left_out={}, misplaced={}, simulations=1, wall_time=1.0, seed=0
    )
    jsonschema.validate(document, schemas()["diagnosis.schema.json"])
    assert "amplitude of the draught" in document["summary"] and document["holdout"] == {
        "decided": False,
        "removed": [],
        "decided_by": None,
        "interval_of": "all rows",
    }
    assert document["effect_parameters"][0]["lower95"] == estimate.interval[0] and not document["interrupted"]
    page = page_of(document, simulated, diagnosis)
    assert "effects.periodic-draught.strength" in page and "before any choice by the holdout" in page
    words_of_the_holdout(document, lambda changed: page_of(changed, simulated, diagnosis))
    words_of_further_parameters(document)
    halves_of_the_holdout(diagnosis, simulated)


def halves_of_the_holdout(diagnosis, recordings) -> None:
    """Where the first half of the holdout decided, the interval of the fall is of the second one."""
    decided = dataclasses.replace(diagnosis, holdout_decided=True)
    options = {"evidence": (), "left_out": {}, "misplaced": {}, "simulations": 1, "wall_time": 1.0, "seed": 0}
    entry = diagnosis_document(decided, recordings, **options)["holdout"]
    assert entry == {"decided": True, "removed": [], "decided_by": "first half", "interval_of": "second half"}
    rows = np.arange(400)
    noise = np.random.default_rng(0).standard_normal(400)
    before, after = {"displacement": 2.0 * noise}, {"displacement": np.where(rows < 200, 0.5, 1.5) * noise}
    predictions = {"before": [{}, {}, before], "after": [{}, {}, after]}
    evaluator = SimpleNamespace(seed=0)
    whole, half = (_cuts(evaluator, predictions, decides)["displacement"] for decides in (False, True))
    assert half == bootstrap_cut(2.0 * noise[200:], 1.5 * noise[200:], 0) and half[1] < whole[0]


def words_of_further_parameters(document) -> None:
    """The summary has the fitted values of an effect's parameters besides its strength."""
    key = document["effects"][0]
    entry = {"name": f"effects.{key}.tau", "value": 12.345, "unit": "s", "meaning": "time constant"}
    parameters = [*document["effect_parameters"], entry | {"lower95": 12.0, "upper95": 12.5}]
    text = " ".join(sentences(document | {"effect_parameters": parameters}))
    assert "Its tau is 12.35 s (95 %: 12 to 12.5 s): time constant." in text
    parameters[-1] = entry | {"lower95": None, "upper95": None}
    text = " ".join(sentences(document | {"effect_parameters": parameters}))
    assert "Its tau" not in text and f"do not determine effects.{key}.tau" in text


def words_of_the_holdout(document, page) -> None:
    """Summary and page say which part the holdout had; documents of earlier versions say nothing about it."""
    assert "after selection" not in document["summary"]
    stays = document | {"verdict": "partial", "holdout": {"decided": True, "removed": []}, "interrupted": True}
    text = " ".join(sentences(stays))
    assert "decided that the effects stay" in text and "after selection" in text and "was stopped" in text
    assert "More than noise remains." in text or "another effect." in text
    assert "after selection: the holdout decided that the effects stay" in page(stays)  # of an earlier version
    halves = {"decided_by": "first half", "interval_of": "second half"}
    split = stays | {"holdout": stays["holdout"] | halves}
    text = " ".join(sentences(split))
    assert "The first half of the holdout decided that the effects stay" in text
    assert "the interval of their fall is of the second half, which had no part in the choice: check" in text
    assert "on the second half of the holdout, which had no part in the choice, falls by" in page(split)
    removed = stays | {"effects": [], "holdout": {"decided": True, "removed": ["creep"]}, "verdict": "unresolved"}
    assert "rejected creep, which did not reduce its error" in " ".join(sentences(removed))
    earlier = {k: v for k, v in document.items() if k not in ("holdout", "effect_parameters", "interrupted")}
    assert "selection" not in " ".join(sentences(earlier)) and "by the holdout" not in page(earlier)


def page_of(document, recordings, diagnosis) -> str:
    """The page of a document."""
    run = {"argv": [], "started": "", "machine": "", "versions": {}, "timings": {}}
    series = prediction_series(recordings, diagnosis)
    return diagnosis_page(document, series, run | {"inputs": ["current"]}, "")
