"""Channels that were recorded and are not observed: which of them a diagnosis takes as evidence, and what it makes of them."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.diagnosis.auxiliary_channels import (
    auxiliary_channels,
    saturation_reason,
    with_auxiliary_channels,
    without_channels,
)
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, channels
from tests.reference.make_data import clock, turns
from tests.reference.rig_file import read_rig as reference_rig

UNITS = {"displacement": "mm", "temperature": "degC", "voltage": "V"}


@pytest.fixture(scope="module")
def folder():
    """A shipped rig whose recordings hold its displacement alone."""
    return data_path("recordings", "dead-weight")


def test_evidence_is_what_every_recording_has_at_every_row(folder):
    plant, time = read_rig(folder / "rig.toml").plant, np.linspace(0.0, 1.0, 11)
    given = {
        name: np.sin(time + k)
        for k, name in enumerate(("current", "displacement", "temperature", "voltage", "strain", "power"))
    }
    given |= {"force": np.ones(11), "strain": np.where(time > 0.5, np.nan, time)}
    whole = Recording.from_arrays("whole", time, given, {})
    partly = Recording.from_arrays("partly", time, {k: v for k, v in given.items() if k != "power"}, {})
    taken, left = auxiliary_channels(plant, ("displacement",), [whole, partly])
    assert taken == ("temperature", "voltage")
    assert left == {
        "strain": "whole has rows without it",
        "force": "whole: it never changes",
        "power": "partly does not have it",
    }
    assert auxiliary_channels(plant, ("displacement", "voltage"), [whole])[0] == ("temperature", "power")


def test_evidence_is_taken_up_to_a_gain_and_an_offset(folder):
    rig = read_rig(folder / "rig.toml")
    plant, settings = with_auxiliary_channels(rig.plant, rig.fit, ("temperature",))
    assert settings.observe == (*rig.fit.observe, "temperature")
    assert settings.free == (*rig.fit.free, "sensor.temperature_gain", "sensor.temperature_offset")
    assert float(plant.sensor.gain["temperature"]) == 1.0
    assert with_auxiliary_channels(rig.plant, rig.fit, ()) == (rig.plant, rig.fit)


def test_a_saturated_channel_is_done_without_where_another_is_observed(folder):
    rig, rng = read_rig(folder / "rig.toml"), np.random.default_rng(0)
    settings = dataclasses.replace(
        rig.fit, observe=("displacement", "temperature"), free=(*rig.fit.free, "sensor.temperature_gain")
    )
    values = rng.uniform(0.0, 1.0, 400)
    one = Recording.from_arrays(
        "one", np.arange(400.0), {"displacement": values, "temperature": np.minimum(values, 0.9)}, {}
    )
    assert saturation_reason("displacement", [one]) == ""
    assert saturation_reason("temperature", [one]).startswith("one: temperature stays at its highest value for ")
    assert without_channels(settings, ["temperature"]) == rig.fit


def test_a_slow_thermocouple_is_named_though_its_temperature_is_not_observed(folder, tmp_path):
    """By the exact reference, read through a thermocouple that lags and is calibrated 2 % and 1.5 K off."""
    rig, rng = reference_rig(folder / "rig.toml"), np.random.default_rng(3)
    seconds = clock(40.0)
    for name in ("train", "select", "holdout"):
        current = turns(rng, seconds, rig, (0.0, 0.14), (0.28, 0.35), np.array([[46.0, 62.0], [84.0, 100.0]])).round(4)
        exact = channels(rig, Hidden(probe_lag=0.3), seconds, current)
        seen = {
            "displacement": exact["displacement"] + 2e-5 * rng.standard_normal(len(seconds)),
            "temperature": 1.02 * exact["temperature"] + 1.5 + 0.4 * rng.standard_normal(len(seconds)),
        }
        seen["voltage"] = np.full(len(seconds), 0.1)  # a meter that nobody connected
        recording = Recording.from_arrays(name, seconds, {"current": current, **seen}, {c: UNITS[c] for c in seen})
        recording.write(tmp_path / f"{name}.csv")
    parts = [str(tmp_path / f"{name}.csv") for name in ("train", "select", "holdout")]
    said = CliRunner().invoke(app, ["check", str(folder / "rig.toml"), parts[0]]).output
    assert "displacement [mm] (observed), temperature [degC] (evidence for a diagnosis), voltage [V] (not used)" in said
    words = [
        "diagnose",
        str(folder / "rig.toml"),
        parts[0],
        "--select",
        parts[1],
        "--holdout",
        parts[2],
        "--out",
        str(tmp_path / "out"),
    ]
    result = CliRunner().invoke(app, [*words, "--no-open"])
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text("utf-8"))
    assert document["effects"] == ["thermocouple-lag"] and document["evidence"] == ["temperature"]
    assert document["left_out"] == [{"channel": "voltage", "why": "train.csv: it never changes"}]
    assert "Done without voltage: train.csv: it never changes." in document["summary"]
    assert "error of temperature, recorded and not observed, is" in document["summary"]
    assert (
        document["rmse"]["temperature"]["holdout_after"]
        < 1.2 * 0.4
        < 0.5 * document["rmse"]["temperature"]["holdout_before"]
    )
    assert document["rmse"]["displacement"]["holdout_after"] < 1.2 * 0.02
    entry = next(r for r in document["ranking"] if r["key"] == "thermocouple-lag")
    assert entry["strength"] == pytest.approx(0.3, rel=0.05)
    diagnosed = read_rig(tmp_path / "out" / "rig-diagnosed.toml")
    assert diagnosed.fit.observe == ("displacement", "temperature")
    assert float(diagnosed.plant.sensor.gain["temperature"]) == pytest.approx(1.02, abs=3e-3)
    assert float(diagnosed.plant.sensor.offset["temperature"]) == pytest.approx(1.5, abs=0.2)
