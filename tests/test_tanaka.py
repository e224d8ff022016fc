"""The one-fraction laws against their published closed forms, and the correction by Elahinia and Ahmadian."""

import math

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.plant.material.base import Fractions
from smajax.plant.material.tanaka import LiangRogers, Tanaka
from smajax.rig import parse_rig
from smajax.simulate import simulate
from tests import plants

VALUES = {k: v for k, v in plants.MATERIAL.items() if not k.startswith("detwinning")}
MS, MF, AS, AF, CA, CM = 50.0, 36.0, 64.0, 80.0, 6.73e6, 6.32e6
LAWS = {"tanaka": Tanaka(**VALUES), "liang-rogers": LiangRogers(**VALUES)}


def forward(law: str, temperature: float, stress: float, start: float) -> float:
    """Martensite after cooling from above its band, as published: from a fraction ``start``."""
    if law == "tanaka":
        return 1.0 - (1.0 - start) * math.exp(min(math.log(0.01) / (MS - MF) * (MS - temperature + stress / CM), 0.0))
    phase = math.pi / (MS - MF) * (temperature - MF - stress / CM)
    return (1.0 - start) / 2 * math.cos(min(max(phase, 0.0), math.pi)) + (1.0 + start) / 2


def reverse(law: str, temperature: float, stress: float, start: float) -> float:
    """Martensite after heating from below its band."""
    if law == "tanaka":
        return start * math.exp(min(math.log(0.01) / (AF - AS) * (temperature - AS - stress / CA), 0.0))
    phase = math.pi / (AF - AS) * (temperature - AS - stress / CA)
    return start / 2 * (math.cos(min(max(phase, 0.0), math.pi)) + 1.0)


def advance(law: str, fractions: tuple[float, float], temperature: tuple[float, float], stress: tuple[float, float]) -> float:
    start, warm, loaded = (tuple(jnp.asarray(float(v)) for v in pair) for pair in (fractions, temperature, stress))
    return float(LAWS[law].evolve(Fractions(*start), warm, loaded).martensite)


@pytest.mark.parametrize("law", LAWS)
@pytest.mark.parametrize("stress", [0.0, 80e6, 200e6])
@pytest.mark.parametrize("start", [0.0, 0.3])
def test_legs_are_the_published_ones(law, stress, start):
    for temperature in np.linspace(20.0, 140.0, 61):
        cooled = advance(law, (start, 0.0), (200.0, temperature), (stress, stress))
        assert cooled == pytest.approx(forward(law, temperature, stress, start), abs=3e-9)
        heated = advance(law, (1.0 - start, 0.0), (-50.0, temperature), (stress, stress))
        assert heated == pytest.approx(reverse(law, temperature, stress, 1.0 - start), abs=3e-9)


@pytest.mark.parametrize("law", LAWS)
def test_many_steps_are_one(law):
    path = np.linspace(100.0, 30.0, 57)
    state = 0.0
    for before, after in zip(path[:-1], path[1:], strict=True):
        state = advance(law, (state, 0.0), (before, after), (80e6, 80e6))
    assert state == pytest.approx(advance(law, (0.0, 0.0), (100.0, 30.0), (80e6, 80e6)), abs=1e-12)


@pytest.mark.parametrize("law", LAWS)
def test_heating_under_a_stress_that_rises_faster_transforms_nothing_back(law):
    """As published, heating alone would decide."""
    partly = reverse(law, 90.0, 100e6, 1.0)
    assert 0.0 < partly < 1.0
    assert advance(law, (partly, 0.0), (90.0, 92.0), (100e6, 100e6 + 3.0 * CA)) == pytest.approx(partly, abs=1e-12)
    assert advance(law, (partly, 0.0), (90.0, 89.0), (100e6, 100e6 - 3.0 * CA)) < partly - 0.01  # unloading transforms while it cools


@pytest.mark.parametrize("law", LAWS)
def test_a_rig_takes_the_law_and_has_its_derivatives(law):
    lines = "\n".join(f'{k} = "{v} {u}"' for k, v, u in (
        ("martensite_start", MS, "degC"), ("martensite_finish", MF, "degC"), ("austenite_start", AS, "degC"), ("austenite_finish", AF, "degC"),
        ("clausius_clapeyron_austenite", CA, "Pa/K"), ("clausius_clapeyron_martensite", CM, "Pa/K"), ("modulus_austenite", 31.5, "GPa"),
        ("modulus_martensite", 20, "GPa"), ("max_strain", 4.1, "%"),
    ))  # fmt: skip
    rig = parse_rig(
        '[rig]\nkind = "bias-spring"\ncontrol = "current"\n[wire]\ndiameter = "0.15 mm"\nlength = "230 mm"\n[spring]\nstiffness = "300 N/m"\n'
        f'preload = "2 N"\n[heat]\nh0 = "100 W/m^2/K"\ncapacity = "2 MJ/m^3/K"\n[material]\n{lines}\n'
        f'[fit]\nmodel = "{law}"\nfree = []\nobserve = ["displacement"]\n'
    )
    recording = plants.recording({"current": plants.pulses(300, 0.05, 0.33)}, np.arange(300) * 0.05)

    def stroke(values):
        return jnp.mean(simulate(parameters.replace(rig.plant, values), recording).channels["displacement"] * 1e3)

    at = {"material.max_strain": 0.041, "material.austenite_shift": 0.0}
    slopes = jax.jacfwd(stroke)(at)
    for name, step in (("material.max_strain", 1e-6), ("material.austenite_shift", 1e-4)):
        ends = [float(stroke(at | {name: at[name] + side * step})) for side in (1, -1)]
        assert float(slopes[name]) == pytest.approx((ends[0] - ends[1]) / (2 * step), rel=1e-3)
    assert float(stroke(at)) > 0.5
