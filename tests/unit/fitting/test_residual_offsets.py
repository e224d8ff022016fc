"""Offsets of sensors that only the residual of a fit shows; the recordings are those of exact simulators."""

import dataclasses
from types import SimpleNamespace

import numpy as np
import pytest

import smajax as sma
from smajax.api.bench import rig_findings
from smajax.files.rig_file import read_rig
from smajax.fitting.problem import Problem
from smajax.fitting.residual_offsets import residual_offsets
from smajax.recordings.datasets import data_path

FOLDER = data_path("recordings", "dead-weight")
ROWS = 1000


def problem(recordings: int, *free: str) -> Problem:
    """A fit problem with one channel and unit noise, of which the check reads weights and names only."""
    made = object.__new__(Problem)
    parts = {"data": SimpleNamespace(weight=np.ones((recordings, 1, ROWS))), "channels": ("displacement",)}
    for name, value in (parts | {"shared": free, "per_recording": ()}).items():
        object.__setattr__(made, name, value)
    return made


@pytest.fixture(scope="module")
def rows():
    """A Jacobian of two parameters and white noise, for two recordings."""
    rng = np.random.default_rng(1)
    time = np.tile(np.linspace(0.0, 1.0, ROWS), 2)
    return np.column_stack([np.sin(9.0 * time), 0.6 + np.cos(5.0 * time)]), time, rng.standard_normal(2 * ROWS)


def test_an_offset_of_each_recording_is_found_where_the_parameters_took_a_part_of_it(rows):
    jacobian, _, noise = rows
    offsets = np.repeat([2.0, -1.0], ROWS)
    taken = jacobian @ np.linalg.lstsq(jacobian, offsets + noise, rcond=None)[0]
    (found,) = residual_offsets(problem(2), offsets + noise - taken, jacobian, {"displacement": 1.0})
    assert found.channel == "displacement" and found.share > 0.95
    assert found.values == pytest.approx((2.0, -1.0), abs=0.25)


@pytest.mark.parametrize("cause", ["nothing", "drift", "free"])
def test_nothing_else_is_an_offset(rows, cause):
    jacobian, time, noise = rows
    residual = noise + {"nothing": 0.0 * time, "drift": 4.0 * (time - 0.4), "free": 0.0 * time + 2.0}[cause]
    free = ("sensor.displacement_offset",) if cause == "free" else ()
    assert residual_offsets(problem(2, *free), residual, jacobian, {"displacement": 1.0}) == ()


@pytest.fixture(scope="module")
def rig():
    rig = read_rig(FOLDER / "rig.toml")
    return dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, starts=1))


def shifted(rig, name, offset):
    recording = rig.read(FOLDER / f"{name}.csv")
    return dataclasses.replace(
        recording, channels={**recording.channels, "displacement": recording.channels["displacement"] + offset}
    )


@pytest.mark.slow
def test_a_fit_names_an_offset_that_is_too_small_for_the_first_rows_and_auto_fits_it(rig):
    """0.06 mm, three standard deviations of the noise, of a stroke of 9 mm."""
    recording = shifted(rig, "train", 6e-5)
    assert rig_findings(rig, [recording]) == []
    study, plain = sma.fit(rig, recording), sma.fit(rig, shifted(rig, "train", 0.0))
    assert plain.document["bench"] == []
    (entry,) = study.document["bench"]
    assert entry["code"] == "offset" and entry["text"].startswith(
        "train.csv: an offset of displacement of 0.06 mm explains "
    )
    assert "free sensor.displacement_offset, which fit --auto (auto=True) does" in entry["text"]
    assert str(study).startswith("train.csv: an offset")
    better = sma.fit(rig, recording, auto=True)
    low, high = better.parameters["sensor.displacement_offset"].interval
    assert low < 6e-5 < high
    for name, parameter in plain.parameters.items():
        low, high = better.parameters[name].interval
        assert low < parameter.value < high


@pytest.mark.slow
def test_a_hidden_effect_is_no_offset():
    folder = data_path("recordings", "dead-weight-unexplained")
    rig = read_rig(folder / "rig.toml")
    rig = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, starts=1))
    study = sma.fit(rig, folder / "train.csv")
    assert study.rmse["displacement"]["train"] > 1.5 * study.result.noise_floor["displacement"] * 1e3
    assert study.result.offsets == ()


@pytest.mark.slow
def test_a_diagnosis_names_an_offset_that_explains_the_residual_without_any_effect(rig):
    train, select, holdout = (shifted(rig, name, 6e-5) for name in ("train", "select", "holdout"))
    found = sma.diagnose(rig, train, select=select, holdout=holdout)
    (entry,) = found.document["bench"]
    assert "an offset of displacement of 0.06 mm explains" in entry["text"]
    assert entry["text"].endswith("free sensor.displacement_offset, and diagnose again.")
    assert str(found).startswith(entry["text"])
