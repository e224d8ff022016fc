"""Set-up of a diagnosis from Python."""

import dataclasses

import numpy as np
import pytest

from smajax.diagnosis import memory as memory_module
from smajax.diagnosis.memory import diagnosis_memory
from smajax.diagnosis.setup import check_recordings, set_up_diagnosis
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording


@pytest.fixture(scope="module")
def folder():
    """A shipped rig whose recordings hold its displacement alone."""
    return data_path("recordings", "dead-weight-unexplained")


def recording(name: str, rows: int = 300, current: float = 0.1, seed: int = 0) -> Recording:
    """A recording of noise; ``current`` is the amplitude of its input."""
    rng = np.random.default_rng(seed)
    channels = {"current": 0.2 + current * rng.standard_normal(rows), "displacement": rng.standard_normal(rows)}
    return Recording.from_arrays(name, np.arange(float(rows)), channels, {})


def test_recordings_of_python_are_checked_as_those_of_files():
    good = [recording(name, seed=k) for k, name in enumerate(("train", "select", "holdout"))]
    check_recordings(good, ("current",))
    for bad, message in (
        ([recording("train", rows=150), *good[1:]], "train: 150 rows are too few for a diagnosis: at least 200"),
        ([good[0], recording("copy"), good[2]], "copy has .* train: name a recording of another input"),
        ([recording("train", current=0.0), *good[1:]], "train: current never changes, so that no effect"),
    ):
        with pytest.raises(InputError, match=message):
            check_recordings(bad, ("current",))


def test_own_parameters_of_recordings_are_refused(folder):
    rig = read_rig(folder / "rig.toml")
    rig = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, per_recording=("heat.h0",)))
    with pytest.raises(InputError, match=r"rig.toml: a diagnosis takes one set of parameters .*fit.per_recording"):
        set_up_diagnosis(rig, [recording(name) for name in ("train", "select", "holdout")])


def test_a_diagnosis_that_does_not_fit_into_the_memory_is_refused_before_anything_is_compiled(folder, monkeypatch):
    rig = read_rig(folder / "rig.toml")
    recordings = [recording(name, 1000, seed=k) for k, name in enumerate(("train", "select", "holdout"))]
    steps, size = diagnosis_memory(rig.plant, recordings, interpolation=rig.interpolation)
    assert steps > 20_000 and size > 1e9
    monkeypatch.setattr(memory_module, "free_memory", lambda: size / 2)
    with pytest.raises(
        InputError, match=rf"train: this diagnosis takes {steps:,} steps and about .* GB of memory, and"
    ):
        set_up_diagnosis(rig, recordings)
