"""Rigs whose wire is heated by water, an oven or a heat gun: the recorded temperature is prescribed."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from smajax import parameters
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.plant.mechanisms.stress_path import StressPath
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate

SECTIONS = {
    "dead-weight": ('[load]\nmass = "200 g"', "displacement"),
    "bias-spring": ('[spring]\nstiffness = "300 N/m"\npreload = "2 N"', "displacement"),
    "testing-machine": ("", "force"),
}
RIG = """
schema = 1
[rig]
kind = "{kind}"
control = "temperature"
parameters = "rotary-table1"
[wire]
diameter = "0.15 mm"
length = "230 mm"
prestrain = "3 %"
{load}
[fit]
free = ["material.austenite_start"]
observe = ["{observe}"]
starts = 1
"""
TIME = np.arange(0.0, 120.0, 0.5)
BATH = np.interp(TIME, [0.0, 40.0, 80.0, 120.0], [20.0, 110.0, 25.0, 100.0])


def rig_text(kind):
    load, observe = SECTIONS[kind]
    return RIG.format(kind=kind, load=load, observe=observe)


def bath(kind, **channels):
    channels = {
        "temperature": BATH,
        **({"strain": np.zeros(len(TIME))} if kind == "testing-machine" else {}),
        **channels,
    }
    return Recording.from_arrays("bath", TIME, channels)


@pytest.mark.slow
@pytest.mark.parametrize("kind", SECTIONS)
def test_the_wire_is_a_material_point_under_its_own_stress(kind):
    plant = parse_rig(rig_text(kind)).plant
    assert plant.signals[0] == "temperature" and "ambient" not in plant.driving_channels(["ambient"])
    response = simulate(plant, bath(kind))
    np.testing.assert_array_equal(response.channels["temperature"], BATH)
    strain, stress = (np.asarray(response.channels[c]) for c in ("strain", "stress"))
    assert np.ptp(strain if kind != "testing-machine" else stress) > 0.0
    first = {f"initial.{name}": getattr(response.state.fractions, name)[0, 0] for name in ("detwinned", "twinned")}
    point = dataclasses.replace(parameters.replace(plant, first), mechanism=StressPath())
    path = simulate(point, Recording.from_arrays("path", None, {"temperature": BATH, "stress": stress}))
    # A path counts the strain from the prestrain, as a testing machine does.
    counted_from = 0.0 if kind == "testing-machine" else 0.03
    np.testing.assert_allclose(path.channels["strain"], strain - counted_from, atol=2e-6)


def test_a_spring_is_in_balance_with_the_wire():
    response = simulate(parse_rig(rig_text("bias-spring")).plant, bath("bias-spring"))
    force, motion = (np.asarray(response.channels[c]) for c in ("force", "displacement"))
    np.testing.assert_allclose(force - force[0], 300.0 * (motion - motion[0]), atol=1e-6)


def test_a_fit_of_a_wire_in_a_bath_recovers_its_law():
    rig = parse_rig(rig_text("dead-weight"))
    truth = parameters.replace(rig.plant, {"material.austenite_start": jnp.asarray(63.0)})
    motion = np.asarray(simulate(truth, bath("dead-weight")).channels["displacement"])
    noise = 2e-5 * np.random.default_rng(0).standard_normal(len(TIME))
    recording = rig.read(bath("dead-weight", displacement=motion + noise))
    (estimate,) = fit(rig.plant, [recording], rig.fit).estimates
    assert estimate.estimate == pytest.approx(63.0, abs=0.2)


@pytest.mark.parametrize("kind", SECTIONS)
def test_the_text_of_the_rig_is_read_back(kind):
    rig = parse_rig(rig_text(kind))
    again = parse_rig(rig.to_toml())
    assert again.plant.signals == rig.plant.signals
    assert again.kind == kind


def test_what_a_prescribed_temperature_excludes_is_refused():
    heat = rig_text("dead-weight") + '[heat]\nh0 = "50 W/m^2/K"\n'
    with pytest.raises(InputError, match=r"\[heat\] does not apply with control = \"temperature\": remove it"):
        parse_rig(heat)
    with pytest.raises(
        InputError, match="prescribes one temperature, and an antagonistic-rotary rig has several wires"
    ):
        parse_rig(RIG.format(kind="antagonistic-rotary", load="", observe="angle"))
    with pytest.raises(InputError, match="fit.observe has temperature, which drives this dead-weight rig"):
        parse_rig(RIG.format(kind="dead-weight", load=SECTIONS["dead-weight"][0], observe="temperature"))
