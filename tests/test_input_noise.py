"""Noise in the columns that drive a model: how much there is, and what it does to a fit."""

import dataclasses

import numpy as np
import pytest

from smajax.fit.fit import fit
from smajax.fit.input_noise import moved, noise_of
from smajax.rig import read_rig
from tests.conftest import ROOT

FOLDER = ROOT / "data" / "recordings" / "isobaric"


def test_noise_is_told_from_what_a_column_does():
    rng, time = np.random.default_rng(0), np.linspace(0.0, 60.0, 3000)
    sine, ramp, steps = np.sin(time), np.abs(time % 20.0 - 10.0), np.repeat(rng.uniform(0.0, 1.0, 30), 100)
    for column in (sine, ramp, steps, np.round(steps, 1), rng.uniform(0.0, 1.0, 3000)):  # the last is the input itself
        assert noise_of(column) == 0.0
    for column in (sine, ramp, steps):
        assert noise_of(column + 0.01 * rng.standard_normal(3000)) == pytest.approx(0.01, rel=0.1)
    assert noise_of(np.where(np.arange(3000) % 7 == 0, np.nan, sine)) == 0.0


@pytest.mark.parametrize("noise", [0.0, 0.4])
def test_a_fit_is_told_how_far_noise_in_its_temperatures_moves_it(noise):
    """The same rows fitted without and with the noise are as far apart as the sentence says, twofold."""
    rig = read_rig(FOLDER / "rig.toml")
    settings = dataclasses.replace(rig.fit, free=("material.austenite_finish", "material.max_strain"), starts=1)
    clean = rig.read(FOLDER / "train.csv")
    temperature = clean.channels["temperature"]
    away = []
    for seed in range(2):
        shaken = temperature + noise * np.random.default_rng(seed).standard_normal(len(temperature))
        recording = dataclasses.replace(clean, channels={**clean.channels, "temperature": shaken})
        result = fit(rig.plant, [recording], settings, interpolation=rig.interpolation)
        away.append(result.estimates[0].estimate)
        told = moved(result, rig.plant, [recording], settings)
        if noise == 0.0:
            assert not told
            return
        assert len(told) == 1 and told[0].startswith("temperature goes up and down by 0.")
    at_rest = fit(rig.plant, [clean], settings, interpolation=rig.interpolation).estimates[0].estimate
    said = float(told[0].split("austenite_finish by ")[1].split(" K")[0])
    assert 0.4 * said < np.mean(away) - at_rest < 2.5 * said
