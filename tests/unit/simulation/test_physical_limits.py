"""Limits of what is reported: states that no wire has are a failure with its code, not a number."""

import dataclasses
import json

import jax.numpy as jnp
import numpy as np
import pytest
from typer.testing import CliRunner

import smajax as sma
from smajax import parameters
from smajax.app.cli import app
from smajax.errors import NumericsError
from smajax.fitting.fit import fit
from smajax.plant.effects.ratcheting import Ratcheting
from smajax.recordings.datasets import data_path
from smajax.simulation.inputs import discretise
from smajax.simulation.physical_limits import without_impossible_rows
from smajax.simulation.run import simulate, simulate_channels
from smajax.simulation.status import SimulationStatus
from tests.support import plants

FOLDER = data_path("recordings", "dead-weight")
GROWING = '[effects.ratcheting]\nstrength = "0.4 %"\nexponent = "1.5"\n'


def overstrained_plant():
    """Return a wire whose permanent strain exceeds all that an alloy recovers after some cycles."""
    plant = plants.dead_weight(thermal_expansion_martensite=1e-3, thermal_expansion_austenite=1e-3)
    return dataclasses.replace(plant, effects=(Ratcheting(strength=jnp.asarray(4e-3), exponent=jnp.asarray(1.5)),))


@pytest.mark.slow
def test_a_strain_beyond_twice_the_transformation_strain_is_a_failure():
    plant, recording = overstrained_plant(), plants.inputs("dead_weight", 100, 0.1)
    result = simulate(plant, recording, throw=False)
    strain = np.asarray(result.channels["strain"])
    possible = np.asarray(result.possible)
    assert int(result.status) == SimulationStatus.overstrained
    elastic = np.asarray(result.channels["stress"]) / 20e9
    excess = strain - elastic - 2 * 0.041
    assert np.all(excess[~possible] > 0.0) and np.all(excess[possible] < 0.01) and 0 < np.sum(possible) < 100
    with pytest.raises(NumericsError, match="overstrained: a strain exceeded the elastic strain by more than 2 times"):
        simulate(plant, recording)
    # The trial steps of a search use this function, which has no such limit.
    _, status = simulate_channels(plant, discretise(plant, recording), ("displacement",))
    assert int(status) == SimulationStatus.done


@pytest.mark.slow
def test_usual_wires_and_prescribed_strains_are_within_the_limits():
    for kind, make in plants.KINDS.items():
        result = simulate(make(), plants.inputs("rotary" if "rotary" in kind else kind, 120), throw=False)
        assert int(result.status) == SimulationStatus.done and np.all(np.asarray(result.possible)), kind
    little = parameters.replace(plants.dead_weight(), {"material.max_transformation_strain": 1e-4})
    assert int(simulate(little, plants.inputs("dead_weight", 100, 0.1)).status) == SimulationStatus.done


def test_rows_from_the_first_impossible_state_on_have_no_numbers():
    channels = {"strain": np.arange(4.0)}
    assert without_impossible_rows(channels, np.ones(4, bool)) is channels
    cut = without_impossible_rows(channels, np.array([True, False, True, True]))["strain"]
    assert cut[0] == 0.0 and np.all(np.isnan(cut[1:]))


@pytest.mark.slow
def test_a_response_of_an_overheated_wire_has_no_error(monkeypatch):
    """A holdout whose input melts the wire: the fit reports the failure, and neither error nor model values."""
    plant = plants.dead_weight()
    train = plants.inputs("dead_weight", 200)
    model = np.asarray(simulate(plant, train, step=0.05).channels["displacement"])
    train = plants.recording(train.channels | {"displacement": model}, train.time)
    hot = plants.recording(train.channels | {"current": 16.0 * train.channels["current"]}, train.time, "hot.csv")

    class Settings:
        free, per_recording, initial = ("heat.h0",), (), ()
        bounds, observe, noise, starts, seed = {}, ("displacement",), {"displacement": 1e-5}, 1, 0

    result = fit(plant, [train], Settings(), holdout=[hot], step=0.05)  # pyright: ignore[reportArgumentType]
    held = result.responses[1]
    assert held.status is SimulationStatus.overheated
    assert result.rmse("displacement") is not None and result.rmse("displacement", "holdout") is None
    assert np.isnan(held.rmse("displacement")) and np.isnan(held.model["temperature"][-1])
    assert np.nanmax(held.model["temperature"]) < 1300.0


@pytest.mark.slow
def test_python_and_command_line_report_the_failure_and_no_number(tmp_path):
    rig = (FOLDER / "rig.toml").read_text("utf-8")
    rig = rig.replace('thermal_expansion = "10e-6 1/K"', 'thermal_expansion = "-1000e-6 1/K"')
    (tmp_path / "rig.toml").write_text(rig.replace("\n[fit]", f"\n{GROWING}\n[fit]"))
    study = sma.predict(tmp_path / "rig.toml", FOLDER / "train.csv")
    assert not study.success and "overstrained: a strain exceeded" in study.reason
    words = ["simulate", str(tmp_path / "rig.toml"), str(FOLDER / "train.csv"), "--out", str(tmp_path / "out")]
    result = CliRunner().invoke(app, [*words, "--quiet"])
    assert result.exit_code == 3
    run = json.loads((tmp_path / "out" / "run.json").read_text())
    assert run["code"] == "overstrained"
    assert run["channels"]["strain"]["highest"] < 15.0  # %
