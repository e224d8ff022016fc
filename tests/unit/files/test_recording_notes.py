"""Notes on a recording: what is recorded and not used, inputs that never change, and recorded surroundings."""

import numpy as np
import pytest

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.recordings.recording import Recording

RIG = """
schema = 1
[rig]
kind = "dead-weight"
control = "power"
parameters = "rotary-table1"
[heat]
h0 = "45 W/m^2/K"
capacity = "2.6 MJ/m^3/K"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[load]
mass = "1 kg"
[fit]
free = ["heat.h0"]
observe = ["temperature"]
"""
TWO_WIRES = """
schema = 1
[rig]
kind = "antagonistic-rotary"
control = "current"
parameters = "rotary-table1"
[heat]
h0 = "45 W/m^2/K"
capacity = "2.6 MJ/m^3/K"
[wire]
diameter = "0.15 mm"
length = "230 mm"
prestrain = "3 %"
"""
ROWS = np.linspace(0.0, 1.0, 20)


def notes(text=RIG, observed=True, units=None, **channels):
    recording = Recording.from_arrays("run.csv", np.arange(20.0), channels, units or {})
    return parse_rig(text).read(recording, observed=observed).notes


def test_a_recording_of_inputs_and_fitted_channels_has_no_note():
    assert notes(power=ROWS, temperature=20.0 + ROWS) == ()


def test_what_is_recorded_and_not_used_is_named():
    channels = {"power": ROWS, "temperature": 20 + ROWS, "angle": ROWS, "torque": ROWS, "resistance": 1 + ROWS}
    (foreign, outputs) = notes(**channels)
    assert foreign == "recorded and not used, since a dead-weight rig has no such input or output: angle, torque"
    assert outputs == "recorded and not fitted, since [fit] observe does not name it: resistance"


def test_notes_are_added_once():
    rig = parse_rig(RIG)
    channels = {"power": ROWS, "temperature": 20.0 + ROWS, "angle": ROWS}
    once = rig.read(Recording.from_arrays("run.csv", np.arange(20.0), channels))
    assert rig.read(once).notes == once.notes and len(once.notes) == 1


def test_a_recorded_ambient_temperature_is_an_input():
    channels = {"power": ROWS, "temperature": 20.0 + ROWS, "ambient": 20.0 + ROWS}
    assert notes(**channels) == ()
    (note,) = notes(RIG.replace('"heat.h0"]', '"heat.h0", "environment.ambient"]'), **channels)
    assert "follows the recorded ambient temperature in place of environment.ambient, which is free" in note
    assert note.endswith("take it out of [fit]")
    path = 'schema = 1\n[rig]\nkind = "path"\nparameters = "rotary-table1"\n[fit]\nobserve = ["strain"]'
    (note,) = notes(path, temperature=20 + ROWS, stress=1e8 * ROWS, strain=ROWS / 50, ambient=20 + ROWS)
    assert note.startswith("recorded and not used") and note.endswith(": ambient")


@pytest.mark.parametrize(
    ("power", "expected"),
    [(0.0, "power is 0 in every row: nothing heats the wire"), (0.25, "power is 250 mW in every row")],
)
def test_an_input_that_never_changes_is_named(power, expected):
    units = {"power": "mW"}
    assert notes(units=units, power=np.full(20, power), temperature=20.0 + ROWS) == (expected,)
    assert notes(units=units, observed=False, power=np.full(20, power)) == (expected,)


def test_inputs_of_two_wires_that_never_change_are_named():
    cold = np.zeros(20)
    nothing = "current_1 and current_2 are 0 in every row: nothing heats the wires"
    assert notes(TWO_WIRES, current_1=cold, current_2=cold, angle=ROWS) == (nothing,)
    assert notes(TWO_WIRES, current_1=ROWS, current_2=cold, angle=ROWS) == ("current_2 is 0 A in every row",)


def test_a_path_on_which_nothing_changes_is_named():
    path = 'schema = 1\n[rig]\nkind = "path"\nparameters = "rotary-table1"\n[fit]\nobserve = ["strain"]'
    still = {"temperature": np.full(20, 25.0), "stress": np.full(20, 1e8)}
    (note,) = notes(path, strain=ROWS / 50, **still)
    assert note == "temperature and stress never change"
    assert notes(path, strain=ROWS / 50, temperature=20.0 + ROWS, stress=still["stress"]) == ()


def test_a_recorded_fan_needs_its_effect_and_the_effect_its_column():
    channels = {"power": ROWS, "temperature": 20.0 + ROWS}
    (note,) = notes(**channels, fan=ROWS)
    assert note == "fan is recorded and not used: add [effects.fan-cooling], whose strength can be fitted"
    cooled = RIG + '[effects.fan-cooling]\nstrength = "2"\n'
    assert notes(cooled, **channels, fan=ROWS) == ()
    assert parse_rig(cooled).plant.driving_channels(["fan"]) == ("power", "fan")
    with pytest.raises(InputError, match="fan"):
        notes(cooled, **channels)


@pytest.mark.parametrize("effects", ["", '[effects.fan-cooling]\nstrength = "2"\n'])
def test_a_fan_changes_nothing_where_the_temperature_is_prescribed(effects):
    text = RIG.replace('"power"', '"temperature"').replace('observe = ["temperature"]', 'observe = ["displacement"]')
    text = text.replace('[heat]\nh0 = "45 W/m^2/K"\ncapacity = "2.6 MJ/m^3/K"\n', "").replace("heat.h0", "load.mass")
    (note,) = notes(text + effects, temperature=20.0 + ROWS, displacement=ROWS, fan=ROWS)
    assert note == "recorded and not used, since a dead-weight rig has no such input or output: fan"


@pytest.mark.parametrize(("austenite", "change"), [(1.0, "rises"), (0.6, "falls"), (0.8, None)])
def test_the_sign_of_an_observed_resistance_is_named(austenite, change):
    law = f'[material]\nresistivity_austenite = "{austenite} uohm m"\nresistivity_martensite = "0.8 uohm m"\n'
    text = RIG.replace('observe = ["temperature"]', 'observe = ["resistance"]') + law
    (note,) = notes(text, power=ROWS, resistance=10.0 + ROWS)
    expected = f"the modelled resistance {change} as the wire transforms to austenite"
    assert (expected if change else "does not show the transformation") in note
