"""Plausible ranges: the table with its sources, and what a fit says of estimates outside."""

import dataclasses
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

import smajax as sma
from smajax import parameters
from smajax.files.plausible_ranges import HYSTERESIS, hysteresis, implausible_values, plausible_range
from smajax.files.rig_file import read_rig
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.recordings.datasets import data_path
from smajax.simulation.run import simulate
from tests.support import plants

ROOT = Path(__file__).resolve().parents[3]
TABLE = tomllib.loads(data_path("plausible-ranges.toml").read_text("utf-8"))
NAMES = [
    *(f"{section}.{key}" for section in ("material", "heat") for key in TABLE[section]),
    *(f"effects.{key}.{name}" for key, entries in TABLE["effects"].items() for name in entries),
]


def unit_of(name):
    if name == HYSTERESIS:
        return "K"
    if name.startswith("effects."):
        _, key, field = name.split(".")
        return declarations(catalogue()[key])[field].unit
    return parameters.declaration(plants.dead_weight(), name).unit


@pytest.mark.parametrize("name", NAMES)
def test_a_range_has_units_and_a_source_of_the_references(name):
    allowed = plausible_range(name, unit_of(name))
    assert allowed is not None and allowed.lower < allowed.upper
    keys = set(re.findall(r"^@\w+\{(\w+),", (ROOT / "docs" / "references.bib").read_text("utf-8"), re.MULTILINE))
    assert allowed.source.startswith(("as that of", "estimate: ")) or any(key in allowed.source for key in keys)
    assert plausible_range(f"{name}@a.csv", unit_of(name)) == allowed


def test_expansions_are_judged_by_phase():
    """Textured martensite may have a negative expansion; cubic austenite has none, and no alloy -139e-6 1/K."""
    names = ["material.thermal_expansion_austenite", "material.thermal_expansion_martensite"]

    def outside(austenite, martensite):
        plant = parameters.replace(plants.dead_weight(), dict(zip(names, (austenite, martensite), strict=True)))
        return [v.name for v in implausible_values(plant, names)]

    assert outside(11e-6, -14e-6) == []
    assert outside(-14e-6, 6.6e-6) == names[:1]
    assert outside(11e-6, -139e-6) == names[1:]
    assert outside(-14e-6, -139e-6) == names


def test_the_hysteresis_is_judged_where_a_transformation_is_fitted():
    plant = parameters.replace(plants.dead_weight(), {"material.austenite_shift": 100.0})
    assert hysteresis(plant) == pytest.approx(72.0 + 100.0 - 43.0)
    (value,) = implausible_values(plant, ["material.austenite_shift", "heat.h0", "no.such"])
    assert value.name == HYSTERESIS and value.plausible.excess(value.value) == pytest.approx((129.0 - 90.0) / 89.0)
    assert "material.hysteresis = 129 K lies outside of 1 K to 90 K, the plausible range" in value.sentence
    assert implausible_values(plant, ["heat.h0"]) == []


def test_shipped_rigs_are_plausible():
    for path in sorted(data_path("recordings").glob("*/rig.toml")):
        rig = read_rig(path)
        assert implausible_values(rig.plant, rig.fit.names) == [], path


def test_a_play_of_the_transmission_is_none_of_a_test_frame():
    reason = catalogue()["backlash"].unavailable_reason
    for make in (plants.stress_path, plants.strain_path, plants.testing_machine):
        assert "prescribed strain or stress" in reason(make().capabilities(("strain",)))
    for make in (plants.dead_weight, plants.bias_spring, plants.light_rotary, plants.rotary, plants.limb):
        assert reason(make().capabilities(())) == ""


@pytest.mark.slow
def test_a_fit_says_which_estimates_no_alloy_can_have(tmp_path):
    """The true wire has an expansion of -500e-6 1/K: the fit finds it, with the interval of the data, and says so."""
    folder = data_path("recordings", "dead-weight")
    rig = read_rig(folder / "rig.toml")
    recording = rig.read(folder / "train.csv").slice(0.0, 15.0)
    fit = dataclasses.replace(rig.fit, free=("material.thermal_expansion",), starts=1)
    truth = parameters.replace(rig.plant, {"material.thermal_expansion": -2e-4})
    motion = np.asarray(simulate(truth, recording, interpolation=rig.interpolation).channels["displacement"])
    noisy = motion + 2e-5 * np.random.default_rng(0).standard_normal(len(motion))
    recording = dataclasses.replace(recording, channels=recording.channels | {"displacement": noisy})
    study = sma.fit(dataclasses.replace(rig, fit=fit, text=None), recording)
    entry = study.document["parameters"]["material.thermal_expansion"]
    assert entry["lower95"] < -2e-4 < entry["upper95"] and entry["plausible"] == pytest.approx([5e-6, 17e-6])
    (outside,) = study.document["implausible"]
    assert outside["code"] == "implausible" and outside["name"] == "material.thermal_expansion"
    sentence = "implausible: material.thermal_expansion = "
    assert any(warning.startswith(sentence) for warning in study.document["warnings"])
    assert sentence in " ".join(study.summary().split())
    study.save(tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text("utf-8")
    assert "an alloy can have" in page and "lies outside of" in page
