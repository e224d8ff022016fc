"""Other material laws in a diagnosis: a wrong law and a missing effect, on wires of the reference simulators."""

import dataclasses
import json
import math
import types

from experiments.common.base import ROOT
from experiments.common.hidden_recordings import record
from experiments.diagnosis.other_laws import with_one_resistivity, with_other_law

import numpy as np
import pytest

from smajax import parameters
from smajax.api.diagnose import DiagnosisStudy, diagnose
from smajax.api.load import load
from smajax.diagnosis.other_laws import LawComparison, LawFit, OtherLaws, _cause, is_better
from smajax.files.rig_file import Rig, read_rig
from smajax.fitting.material_laws import law_name, with_law
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording
from smajax.report.diagnosis_summary import sentences
from tests.support import plants

# Rows of each recording, of 4001: the first partial loops.
ROWS = 1500


def residual_of(error: float, seed: int = 0) -> np.ndarray:
    """A residual of white noise with a root mean square."""
    values = np.random.default_rng(seed).standard_normal(1000)
    return error * values / np.sqrt(np.mean(values**2))


@pytest.mark.parametrize(
    ("before", "after", "better"),
    [(2.0, 1.0, True), (2.0, 1.85, False), (2.0, 2.5, False), (2.0, math.nan, False), (math.nan, 2.0, True)],
)
def test_a_law_is_better_by_a_tenth_and_more_than_chance(before, after, better):
    assert is_better(residual_of(before), residual_of(after, 1), 0) is better


def test_a_fall_of_the_error_in_one_block_is_chance():
    before = residual_of(1.0)
    before[:20] *= 20.0
    assert not is_better(before, residual_of(1.0), 0)


@pytest.mark.parametrize(
    ("own", "with_effects", "other", "cause"),
    [
        (10.0, 10.0, 1.0, "law"),
        (10.0, 8.0, 1.2, "law"),
        (10.0, 1.0, 5.0, "effect"),
        (10.0, 3.1, 3.0, "either"),
        (10.0, 10.0, 8.0, "part"),
    ],
)
def test_cause(own, with_effects, other, cause):
    assert _cause(*(residual_of(error, k) for k, error in enumerate((own, with_effects, other))), 0) == cause


@pytest.mark.parametrize(("train_error", "cause"), [(1.0, "either"), (0.5, "either"), (2.0, "law")])
def test_no_law_is_wrong_where_the_training_recording_does_not_determine_the_better_one(
    train_error, cause, monkeypatch
):
    laws, own = OtherLaws.__new__(OtherLaws), types.SimpleNamespace(seed=0)
    plant = plants.dead_weight()
    laws._rig, laws._base, laws._own, laws._skipped = own, None, "brinson", {}  # pyright: ignore[reportAttributeAccessIssue]
    laws.__dict__["_fits"] = [LawFit("tanaka", 4.0, train_error, residual_of(4.0, 1), plant)]
    monkeypatch.setattr("smajax.diagnosis.other_laws._prediction", lambda evaluator, fit: residual_of(20.0))
    found = laws.compare(own, None)  # pyright: ignore[reportArgumentType]
    assert found.cause == cause and found.better == "tanaka" and found.errors == {"brinson": 20.0, "tanaka": 4.0}


def test_parameters_of_both_laws_stay():
    plant = plants.dead_weight(martensite_start=51.0)
    settings = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").fit
    changed, free = with_law(plant, settings, "lagoudas")
    assert law_name(changed) == "lagoudas" and law_name(plant) == "brinson"
    assert float(parameters.get(changed, "material.martensite_start")) == 51.0
    assert set(free.free) == {*settings.free, *(f"material.n{k}" for k in (1, 2, 3, 4))}
    assert with_law(plant, settings, "brinson") == (plant, settings)


def first_rows(recordings: list[Recording]) -> list[Recording]:
    return [
        Recording.from_arrays(
            r.name, r.time[:ROWS], {name: values[:ROWS] for name, values in r.channels.items()}, {"displacement": "mm"}
        )
        for r in recordings
    ]


@pytest.fixture(scope="module")
def rig() -> Rig:
    return read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")


def diagnosed(rig: Rig, recordings: list[Recording], **options) -> DiagnosisStudy:
    """Diagnose with one effect in the catalogue, for speed."""
    train, select, holdout = recordings
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(
            "smajax.diagnosis.effect_parameters.catalogue", lambda: {"latent-heat": catalogue()["latent-heat"]}
        )
        return diagnose(rig, train, select=select, holdout=holdout, **options)


@pytest.fixture(scope="module")
def wrong_law(rig) -> DiagnosisStudy:
    """A wire with Tanaka's law, diagnosed from a rig file with Brinson's."""
    recordings = first_rows(with_other_law("tanaka", np.random.default_rng(0)))
    plain = dataclasses.replace(rig, plant=with_one_resistivity(rig.plant), interpolation="hold")
    return diagnosed(plain, recordings)


@pytest.mark.slow
def test_a_wrong_law_is_named_and_no_effect(wrong_law, tmp_path):
    law = wrong_law.law
    assert law is not None and law["cause"] == "law" and law["better"] == "tanaka"
    errors = law["select_error_over_noise"]
    assert errors["tanaka"] < 1.3 < 3.0 < errors["brinson"]
    assert wrong_law.effects == () and wrong_law.verdict == "unresolved" and wrong_law.structure == "neither"
    assert wrong_law.document["unresolved_stage"] == "material"
    assert sentences(wrong_law.document)[0].startswith("The material law is wrong: without further effects tanaka has")
    wrong_law.save(tmp_path / "found")
    again = read_rig(tmp_path / "found" / "rig-law.toml")
    assert law_name(again.plant) == "tanaka" and again.fit.model == "tanaka"
    assert load(tmp_path / "found").law == json.loads(json.dumps(law))


@pytest.mark.slow
def test_a_missing_effect_is_no_wrong_law(rig):
    hidden = {"latent_heat": 8e7}
    study = diagnosed(rig, first_rows(record(hidden, np.random.default_rng(1))), laws=True)
    assert study.effects == ("latent-heat",) and study.law is not None and study.law["cause"] != "law"
    assert study.law["error_with_effects_over_noise"] < 1.3


@pytest.mark.slow
def test_without_more_than_noise_no_law_is_fitted(rig):
    study = diagnosed(rig, first_rows(record({}, np.random.default_rng(2))))
    assert study.verdict == "nothing-missing" and study.law is None


@pytest.mark.slow
@pytest.mark.parametrize("cause", ["none", "law", "effect", "either", "part"])
def test_sentences(wrong_law, cause):
    better = None if cause == "none" else "tanaka"
    entry = wrong_law.document["law"] | {"cause": cause, "better": better}
    first = sentences(wrong_law.document | {"law": entry})[0]
    start = {
        "none": "No other material law (lagoudas, tanaka, liang-rogers) predicts",
        "law": "The material law is wrong:",
        "effect": "An effect is missing, and the law is not wrong:",
        "either": "The law is wrong or an effect is missing, and these recordings do not show which",
        "part": "Another law explains a small part only:",
    }[cause]
    assert first.startswith(start)


def test_the_better_law_has_the_best_error():
    comparison = LawComparison("", {"": 3.0, "tanaka": 1.5}, 3.0, "tanaka", (1.0, 2.0), "law", None, {})
    assert comparison.best_error == 1.5
    assert dataclasses.replace(comparison, better=None).best_error == math.inf
