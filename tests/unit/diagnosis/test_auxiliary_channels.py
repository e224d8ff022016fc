"""Auxiliary channels: recorded channels that are not observed, and their use in a diagnosis."""

import dataclasses
import json

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.diagnosis.auxiliary_channels import (
    auxiliary_channels,
    saturation,
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


def test_auxiliary_channels_are_complete_and_predicted(folder):
    plant, time = read_rig(folder / "rig.toml").plant, np.linspace(0.0, 1.0, 11)
    channels = {
        name: np.sin(time + k)
        for k, name in enumerate(("current", "displacement", "temperature", "voltage", "strain", "power"))
    }
    channels |= {"force": np.ones(11), "strain": np.where(time > 0.5, np.nan, time)}
    whole = Recording.from_arrays("whole", time, channels, {})
    partly = Recording.from_arrays("partly", time, {k: v for k, v in channels.items() if k != "power"}, {})
    usable, unusable = auxiliary_channels(plant, ("displacement",), [whole, partly])
    assert usable == ("temperature", "voltage")
    assert {channel: fault.text for channel, fault in unusable.items()} == {
        "strain": "whole has rows without it",
        "force": "whole: it never changes",
        "power": "partly does not have it",
    }
    assert auxiliary_channels(plant, ("displacement", "voltage"), [whole])[0] == ("temperature", "power")


def test_auxiliary_channels_have_free_gain_and_offset(folder):
    rig = read_rig(folder / "rig.toml")
    plant, settings = with_auxiliary_channels(rig.plant, rig.fit, ("temperature",))
    assert settings.observe == (*rig.fit.observe, "temperature")
    assert settings.free == (*rig.fit.free, "sensor.temperature_gain", "sensor.temperature_offset")
    assert float(plant.sensor.gain["temperature"]) == 1.0
    assert with_auxiliary_channels(rig.plant, rig.fit, ()) == (rig.plant, rig.fit)


def test_saturated_channel_is_left_out_where_another_is_observed(folder):
    rig, rng = read_rig(folder / "rig.toml"), np.random.default_rng(0)
    settings = dataclasses.replace(
        rig.fit, observe=("displacement", "temperature"), free=(*rig.fit.free, "sensor.temperature_gain")
    )
    values = rng.uniform(0.0, 1.0, 400)
    recording = Recording.from_arrays(
        "one", np.arange(400.0), {"displacement": values, "temperature": np.minimum(values, 0.9)}, {}
    )
    assert saturation("displacement", [recording]) is None
    fault = saturation("temperature", [recording])
    assert fault is not None and fault.code == "saturated-high" and fault.share == pytest.approx(0.1, abs=0.05)
    assert fault.text.startswith("one: temperature stays at its highest value for ")
    assert without_channels(settings, ["temperature"]) == rig.fit


@pytest.mark.slow
def test_thermocouple_lag_is_named_although_temperature_is_not_observed(folder, tmp_path):
    """Recordings by the exact reference, with a thermocouple that lags and has a gain of 1.02 and an offset of 1.5 K."""
    rig, rng = reference_rig(folder / "rig.toml"), np.random.default_rng(3)
    seconds = clock(40.0)
    for name in ("train", "select", "holdout"):
        current = turns(rng, seconds, rig, (0.0, 0.14), (0.28, 0.35), np.array([[46.0, 62.0], [84.0, 100.0]])).round(4)
        exact = channels(rig, Hidden(probe_lag=0.3), seconds, current)
        measured = {
            "displacement": exact["displacement"] + 2e-5 * rng.standard_normal(len(seconds)),
            "temperature": 1.02 * exact["temperature"] + 1.5 + 0.4 * rng.standard_normal(len(seconds)),
        }
        measured["voltage"] = np.full(len(seconds), 0.1)  # a meter that is not connected
        recording = Recording.from_arrays(
            name, seconds, {"current": current, **measured}, {c: UNITS[c] for c in measured}
        )
        recording.write(tmp_path / f"{name}.csv")
    parts = [str(tmp_path / f"{name}.csv") for name in ("train", "select", "holdout")]
    output = CliRunner().invoke(app, ["check", str(folder / "rig.toml"), parts[0]]).output
    assert (
        "displacement [mm] (observed), temperature [degC] (auxiliary in a diagnosis), voltage [V] (not used)" in output
    )
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
    assert "Not used: voltage: train.csv: it never changes." in document["summary"]
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
