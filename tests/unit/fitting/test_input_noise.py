"""Noise in the columns that drive a model: how much there is, and what it does to a fit."""

import dataclasses

import numpy as np
import pytest

from smajax.files.rig_file import read_rig
from smajax.fitting.fit import fit
from smajax.fitting.input_noise import input_noise_warnings, row_noise
from tests.conftest import ROOT

FOLDER = ROOT / "data" / "recordings" / "isobaric"


def test_noise_is_distinguished_from_the_signal_of_a_column():
    rng, time = np.random.default_rng(0), np.linspace(0.0, 60.0, 3000)
    sine, ramp, steps = np.sin(time), np.abs(time % 20.0 - 10.0), np.repeat(rng.uniform(0.0, 1.0, 30), 100)
    for column in (sine, ramp, steps, np.round(steps, 1), rng.uniform(0.0, 1.0, 3000)):  # the last is the input itself
        assert row_noise(column) == 0.0
    for column in (sine, ramp, steps):
        assert row_noise(column + 0.01 * rng.standard_normal(3000)) == pytest.approx(0.01, rel=0.1)
    assert row_noise(np.where(np.arange(3000) % 7 == 0, np.nan, sine)) == 0.0


@pytest.mark.slow
@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_warning_states_how_far_noise_in_the_temperatures_biases_a_fit(noise):
    """The same rows fitted without and with the noise are as far apart as the sentence says, twofold."""
    rig = read_rig(FOLDER / "rig.toml")
    settings = dataclasses.replace(
        rig.fit, free=("material.austenite_finish", "material.max_transformation_strain"), starts=1
    )
    clean = rig.read(FOLDER / "train.csv")
    temperature = clean.channels["temperature"]
    away = []
    for seed in range(2):
        shaken = temperature + noise * np.random.default_rng(seed).standard_normal(len(temperature))
        recording = dataclasses.replace(clean, channels={**clean.channels, "temperature": shaken})
        result = fit(rig.plant, [recording], settings, interpolation=rig.interpolation)
        away.append(result.estimates[0].estimate)
        warnings = input_noise_warnings(result, rig.plant, [recording], settings)
        if noise == 0.0:
            assert not warnings
            return
        assert len(warnings) == 1 and warnings[0].startswith("temperature scatters by 0.")
    at_rest = fit(rig.plant, [clean], settings, interpolation=rig.interpolation).estimates[0].estimate
    bias = float(warnings[0].split("austenite_finish by ")[1].split(" K")[0])
    assert 0.4 * bias < np.mean(away) - at_rest < 2.5 * bias
