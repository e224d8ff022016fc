"""One recording as training, selection and holdout recording: cuts where the wire is at rest, and the warning."""

import dataclasses

import numpy as np
import pytest
from typer.testing import CliRunner

import smajax as sma
from smajax.api.split import split_for_fit, split_recording
from smajax.app import cli
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording

FOLDER = data_path("recordings", "dead-weight")
NOISE = 2e-5  # m


@pytest.fixture(scope="module")
def rig():
    free = ("heat.h0", "material.max_transformation_strain")
    rig = read_rig(FOLDER / "rig.toml")
    return dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=free, starts=1))


@pytest.fixture(scope="module")
def rested(rig):
    """Eight loops of different heights, each followed by 8 s in which the wire cools down."""
    time = np.arange(0.0, 160.0, 0.05)
    phase, loop = time % 20.0, (time // 20.0).astype(int)
    height = np.array([0.3, 0.34, 0.28, 0.32, 0.33, 0.29, 0.31, 0.34])[loop]
    current = np.where(phase < 12.0, height * np.sin(np.pi * np.minimum(phase, 12.0) / 12.0) ** 2, 0.0)
    inputs = Recording.from_arrays("own.csv", time, {"current": current})
    motion = np.asarray(sma.simulate(rig.plant, inputs).channels["displacement"])
    noise = NOISE * np.random.default_rng(0).standard_normal(len(time))
    channels = {"current": current, "displacement": motion + noise}
    return Recording.from_arrays("own.csv", time, channels, {"displacement": "mm"})


def test_parts_begin_at_rest_and_follow_each_other(rig, rested):
    parts = split_recording(rig, rested)
    assert [part.name for part in parts] == ["own.csv (train)", "own.csv (select)", "own.csv (holdout)"]
    for channel in ("current", "displacement"):
        np.testing.assert_array_equal(
            np.concatenate([part.channels[channel] for part in parts]), rested.channels[channel]
        )
    assert len(parts[0]) == pytest.approx(0.5 * len(rested), rel=0.15)
    for part in parts:
        assert part.time[0] == 0.0
        model = np.asarray(sma.simulate(rig.plant, part).channels["displacement"])
        assert np.sqrt(np.mean((model - part.channels["displacement"]) ** 2)) < 1.2 * NOISE
    assert "does not show how the model does with another input" in parts[-1].notes[-1]
    assert "rows 1 to" in parts[0].notes[0]


def test_a_wire_that_never_rests_cannot_be_cut(rig):
    with pytest.raises(InputError, match="--split finds no row between .* let it cool down between loops"):
        split_recording(rig, FOLDER / "train.csv")


@pytest.mark.slow
def test_a_fit_needs_no_rest_since_its_model_runs_through(rig):
    recording = rig.read(FOLDER / "train.csv")
    train, holdout = split_for_fit(rig, recording)
    measured = np.isfinite(holdout.channels["displacement"])
    assert len(train) + np.sum(measured) == len(holdout) == len(recording)
    whole = np.asarray(sma.simulate(rig.plant, recording).channels["displacement"])
    study = sma.fit(rig, recording, split=True)
    residual = whole[measured] - recording.channels["displacement"][measured]
    assert study.rmse["displacement"]["holdout"] < 1e3 * np.sqrt(np.mean(residual**2))  # better than the rig's values
    assert "on another day" in str(study).replace("\n  ", " ")
    roles = [(entry["name"], entry["role"]) for entry in study.document["recordings"]]
    assert roles == [("train.csv (train)", "train"), ("train.csv (holdout)", "holdout")]


def test_a_split_and_other_recordings_exclude_each_other(rig, rested):
    with pytest.raises(InputError, match="fit: holdout is given and split, too"):
        sma.fit(rig, rested, holdout=rested, split=True)
    with pytest.raises(InputError, match="diagnose: select is missing: give --select .* or --split"):
        sma.diagnose(rig, rested, holdout=rested)
    with pytest.raises(InputError, match="compare: holdout is missing"):
        sma.compare(rig, rested)
    with pytest.raises(InputError, match="train: one recording is needed, 2 were given"):
        sma.fit(rig, [rested, rested], split=True)


@pytest.mark.slow
def test_commands_split_a_file(rig, rested, tmp_path):
    rig.write(tmp_path / "rig.toml")
    rested.write(tmp_path / "own.csv")
    options = ["--split", "--out", str(tmp_path / "out")]
    run = CliRunner().invoke(cli.app, ["fit", str(tmp_path / "rig.toml"), str(tmp_path / "own.csv"), *options])
    assert run.exit_code == 0, run.output
    assert "own.csv (holdout): it is a part of the same recording" in run.stdout
    words = ["compare", str(tmp_path / "rig.toml"), str(tmp_path / "own.csv"), "--models", "brinson", *options]
    compared = CliRunner().invoke(cli.app, words)
    assert compared.exit_code == 0, compared.output
    document = sma.load(tmp_path / "out").document
    assert [entry["name"] for entry in document["recordings"]] == ["own.csv (train)", "own.csv (holdout)"]
