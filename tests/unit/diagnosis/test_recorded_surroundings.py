"""A diagnosis follows recorded surroundings, and has the fan as a candidate where one is recorded and changes."""

import dataclasses

import numpy as np
import pytest

from smajax.diagnosis.problem import DiagnosisProblem
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording


@pytest.fixture
def problem_of(monkeypatch):
    """A function that returns the problem of recordings of the shipped dead weight, with few effects."""
    subset = {key: catalogue()[key] for key in ("coating", "fan-cooling")}
    monkeypatch.setattr("smajax.diagnosis.problem.zero_terms", tuple)
    monkeypatch.setattr("smajax.diagnosis.effect_parameters.catalogue", lambda: subset)

    def build(*columns):
        folder = data_path("recordings", "dead-weight")
        rig = read_rig(folder / "rig.toml")
        recording = rig.read(folder / "train.csv").slice(0.0, 4.0)
        recordings = [dataclasses.replace(recording, channels={**recording.channels, **c}) for c in columns]
        settings = dataclasses.replace(rig.fit, noise=dict.fromkeys(rig.fit.observe, 2e-5))
        return recording, DiagnosisProblem(rig.plant, recordings, settings, interpolation=rig.interpolation)

    return build


@pytest.mark.slow
def test_a_recorded_fan_is_a_candidate_and_the_inputs_keep_their_shape(problem_of):
    rows = 200
    surroundings = {"ambient": np.linspace(20.0, 24.0, rows), "fan": np.repeat([0.0, 0.5], rows // 2)}
    recording, problem = problem_of(surroundings, surroundings)
    assert sorted(problem.effects) == ["coating", "fan-cooling"]
    assert problem.problems[0].data.inputs.surroundings == ("ambient", "fan")
    assert problem.strided_problem(2).data.inputs.surroundings == ("ambient", "fan")
    proposal = Recording.from_arrays("next", recording.time, {"current": recording.channels["current"]})
    inputs = problem.problem_for_inputs(proposal).data.inputs
    assert inputs.before.shape == problem.problems[0].data.inputs.before.shape
    assert np.all(np.isnan(inputs.before[..., 1:]))


@pytest.mark.slow
@pytest.mark.parametrize("fan", [np.full(200, 0.5), None])
def test_a_fan_that_never_changes_or_is_not_recorded_is_no_candidate(problem_of, fan):
    _, problem = problem_of({} if fan is None else {"fan": fan})
    assert sorted(problem.effects) == ["coating"]
