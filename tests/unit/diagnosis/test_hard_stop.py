"""A motion that ends at a stop: the diagnosis names the stop, its place, and whether it holds the wire."""

import json

import numpy as np
import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.diagnosis.effect_parameters import possible_effects
from smajax.files.rig_file import read_rig
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording
from tests.reference.hidden import Hidden, displacement
from tests.reference.rig_file import read_rig as reference_rig

STOP, NOISE = 5e-3, 2e-5
FOLDER = data_path("recordings", "dead-weight")


def test_places_of_a_stop_are_shares_of_the_recorded_motion():
    rig = read_rig(FOLDER / "rig.toml")
    recording = rig.read(FOLDER / "train.csv")
    capabilities = rig.plant.capabilities(("displacement",))
    _, effects = possible_effects(rig.plant, (), [recording], capabilities)
    motion = recording.channels["displacement"]
    assert float(effects["hard-stop"].place) == pytest.approx(np.max(motion - motion[0]))
    still = Recording.from_arrays("still", recording.time, {"current": recording.channels["current"]}, {})
    _, effects = possible_effects(rig.plant, (), [still], capabilities)
    assert float(effects["hard-stop"].place) == 5e-3


@pytest.mark.slow
def test_a_hard_stop_is_named_first(tmp_path):
    """A plateau with noise on it, nothing clipped exactly, of a wire that the stop holds."""
    rng, truth = np.random.default_rng(3), reference_rig(FOLDER / "rig.toml").changed(h0=1.04, austenite_shift=1.0)
    for part in ("train", "select", "holdout"):
        seconds = np.arange(0.0, 40.0, 0.05)
        levels = np.where(np.arange(17) % 2, rng.uniform(0.28, 0.35, 17), rng.uniform(0.0, 0.14, 17))
        current = np.interp(seconds, np.linspace(0.0, 40.0, 17), levels).round(4)
        motion = displacement(truth, Hidden(stop=STOP), seconds, current)
        assert np.mean(motion > STOP - 1e-9) > 0.1
        rows = np.column_stack([seconds, current, 1e3 * (motion + NOISE * rng.standard_normal(len(seconds)))])
        head = "time [s],current [A],displacement [mm]"
        np.savetxt(tmp_path / f"{part}.csv", rows, delimiter=",", fmt="%.7g", header=head, comments="")
    files = [str(tmp_path / f"{part}.csv") for part in ("train", "select", "holdout")]
    words = ["diagnose", str(FOLDER / "rig.toml"), files[0], "--select", files[1], "--holdout", files[2]]
    result = CliRunner().invoke(app, [*words, "--out", str(tmp_path / "out"), "--quiet"])
    assert result.exit_code == 0, result.output
    document = json.loads((tmp_path / "out" / "diagnosis.json").read_text())
    assert document["effects"] == ["hard-stop"] and document["verdict"] == "named"
    values = {p["name"].rpartition(".")[2]: p["value"] for p in document["effect_parameters"]}
    assert values["place"] == pytest.approx(STOP, abs=NOISE)
    assert values["strength"] > 0.99 and values["held"] > 0.98
    errors, noise = document["rmse"]["displacement"], 1e3 * NOISE
    assert errors["holdout_after"] < 1.2 * noise < 0.5 * errors["holdout_before"]
