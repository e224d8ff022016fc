"""The rig of an import: its kind by the recorded channels, what it fits, and the values in it that recordings give."""

import numpy as np
import pytest

from smajax.errors import InputError
from smajax.files.rig_draft import RigDraft, draft_rig, suggest_kind, template_kinds
from smajax.files.rig_draft.start_values import thermal_start
from smajax.files.rig_file import parse_rig
from smajax.recordings.recording import Recording

TIME = np.linspace(0.0, 60.0, 601)
RISING = np.linspace(0.1, 1.0, len(TIME))
DUTY = 0.4 * (TIME % 20 < 8)
# Channels that are recorded, whether there is a clock, and kind, control and fitted channels of the rig.
RIGS = {
    "duty and temperature": ("duty temperature", True, ("dead-weight", "duty", ("temperature",))),
    "current and displacement": ("current displacement", True, ("dead-weight", "current", ("displacement",))),
    "current, voltage and all": (
        "current voltage displacement temperature force",
        True,
        ("bias-spring", "current", ("displacement", "temperature")),
    ),
    "power, strain and stress": ("power strain stress", True, ("testing-machine", "power", ("stress",))),
    "power and resistance": ("power resistance", True, ("dead-weight", "power", ("resistance",))),
    "two currents and an angle": ("current_1 current_2 angle", True, ("antagonistic-rotary", "current", ("angle",))),
    "a path": ("temperature stress strain", False, ("path", None, ("strain",))),
    "a path with a clock": ("temperature stress strain force", True, ("path", None, ("strain",))),
    "an oven": ("temperature displacement", True, ("dead-weight", "temperature", ("displacement",))),
    "an oven and a strain": ("temperature strain", True, ("dead-weight", "temperature", ("strain",))),
}
# Channels, whether there is a clock, and why there is no rig.
NO_RIGS = {
    "no clock": ("duty temperature", False, "duty heats the wire in the course of time, and the recording has no time"),
    "an oven without a clock": ("temperature strain", False, "give any time between two rows, as in --sample-period '1 s'"),
    "nothing that heats": ("resistance displacement", True, "neither an input that heats the wire"),
    "nothing that is fitted": ("duty ambient", True, "duty is recorded, and nothing that a fit could follow"),
    "an angle of one wire": ("duty angle", True, "for an angle name the kind of the rig by --rig, such as elbow"),
    "temperature alone": ("temperature", True, "a fit needs what heats the wire, or its motion"),
    "two currents": ("current_1 current_2 displacement", True, "name the kind of the rig by --rig"),
}  # fmt: skip


def recording(names: str, clock: bool = True, **columns: np.ndarray) -> Recording:
    """A recording with channels that rise in units of their own."""
    size = {"temperature": 60.0, "stress": 1e8, "strain": 0.04, "displacement": 0.01}
    channels = {name: RISING * size.get(name, 1.0) + 20 * (name == "temperature") for name in names.split()} | columns
    return Recording.from_arrays("run", TIME, channels) if clock else Recording("run", TIME, channels, {}, "", False)


def draft(names: str, clock: bool = True, **arguments: object) -> RigDraft:
    return draft_rig([recording(names, clock)], "", "run-rig.toml", **arguments)


@pytest.mark.parametrize("what", RIGS)
def test_the_channels_suggest_the_rig(what):
    names, clock, (kind, control, observed) = RIGS[what]
    result = draft(names, clock)
    assert (result.kind.kind, result.kind.control, result.rig.fit.observe) == (kind, control, observed)
    assert result.rig.fit.free and parse_rig(result.text).fit.free == result.rig.fit.free
    assert result.rig.read(recording(names, clock)).channels.keys() == set(names.split())


@pytest.mark.parametrize("what", NO_RIGS)
def test_channels_that_suggest_no_rig_say_what_is_missing(what):
    names, clock, sentence = NO_RIGS[what]
    with pytest.raises(InputError) as refusal:
        suggest_kind([recording(names, clock)])
    assert sentence in str(refusal.value)


@pytest.mark.parametrize("kind", template_kinds())
def test_every_kind_with_a_template_can_be_named(kind):
    numbers = {name: f"{name}_1 {name}_2" for name in ("current", "temperature")}
    pair = kind in ("antagonistic-rotary", "coil-antagonistic", "hip")
    names = f"{numbers['current'] if pair else 'current'} {numbers['temperature'] if pair else 'temperature'} "
    result = draft(names + "angle displacement strain stress", kind=kind)
    assert result.rig.kind == kind and result.kind.reason == "it was named"
    assert set(result.rig.fit.observe) <= {"angle", "displacement", "strain", "stress", *names.split()}


def test_values_of_the_user_take_their_place_and_others_are_marked():
    result = draft("duty temperature", values={"wire.diameter": "0.5 mm", "drive.supply": "6 V"})
    assert [a.name for a in result.assumptions] == ["wire.length", "load.mass"]
    assert float(result.rig.plant.wire.diameter) == pytest.approx(0.5e-3)
    assert result.rig.fit.free == ("heat.h0", "heat.capacity")  # the supply is known
    lines = result.text.splitlines()
    assert 'diameter = "0.5 mm"' in lines and 'supply = "6 V"' in lines
    assert 'length = "230 mm"                 # assumed: no recording gives it' in lines
    assert 'ambient = "26 degC"               # the first temperature of the recording' in lines


@pytest.mark.parametrize(
    ("arguments", "sentence"),
    [
        ({"kind": "dead-wait"}, "rig = 'dead-wait' is not a kind of rig (did you mean 'dead-weight'?)"),
        ({"kind": "hip"}, "no recorded channel heats the wire of a hip rig"),
        ({"kind": "testing-machine"}, "a testing-machine rig needs strain, and the recording has duty, temperature"),
        ({"values": {"wire.diametr": "1 mm"}}, "wire.diametr is not known (did you mean 'diameter'?)"),
        ({"values": {"wire.diameter": "1 kg"}}, "wire.diameter"),
        ({"values": {"diameter": "1 mm"}}, "'diameter' is not the name of a value: write it like 'wire.diameter = 0.5 mm'"),
    ],
)  # fmt: skip
def test_a_kind_or_value_that_is_not_possible_is_refused(arguments, sentence):
    with pytest.raises(InputError) as refusal:
        draft("duty temperature", **arguments)
    assert sentence in str(refusal.value)


@pytest.mark.parametrize(
    ("names", "comment"),
    [("duty displacement", "start value, as no recording gives it"), ("duty temperature", "start value, from")],
)
def test_a_supply_that_is_not_given_is_fitted_and_named(names, comment):
    columns = {"duty": DUTY} | ({"temperature": 20.0 + 30.0 * (1.0 - np.exp(-TIME / 9.0))} if "temp" in names else {})
    result = draft_rig([recording(names, **columns)], "", "run-rig.toml")
    (supply,) = [a for a in result.assumptions if a.name == "drive.supply"]
    assert supply.is_fitted and "drive.supply" in result.rig.fit.free and supply.value.endswith(" V")
    assert not any(a.is_fitted for a in result.assumptions if a is not supply)
    (line,) = [line for line in result.text.splitlines() if line.startswith("supply = ")]
    assert comment in line
    current = draft("current displacement")
    assert not any(a.name == "drive.supply" for a in current.assumptions)


def test_forces_and_stresses_say_diameter_preload_and_mass():
    run = recording("power strain stress", force=RISING * 1e8 * np.pi / 4 * 0.4e-3**2)
    result = draft_rig([run], "", "run-rig.toml")
    assert float(result.rig.plant.wire.diameter) == pytest.approx(0.4e-3)
    run = recording("duty displacement", force=2.0 + RISING)
    assert draft_rig([run], "", "x.toml").rig.plant.mechanism.spring.preload == pytest.approx(2.1)
    run = recording("duty displacement", force=2.0 + RISING / 50)
    result = draft_rig([run], "", "x.toml")
    assert result.kind.kind == "dead-weight" and 'mass = "0.205 kg"' in result.text


def test_a_slope_over_a_constant_stress_is_not_free():
    slope = "material.clausius_clapeyron_austenite"
    assert slope in draft("temperature stress strain", False).rig.fit.free
    run = recording("temperature strain", stress=1.5e8 + 5e6 * np.sin(TIME))
    assert slope not in draft_rig([run], "", "x.toml").rig.fit.free


def test_a_loop_at_one_temperature_fits_the_stress():
    run = recording("stress strain", temperature=22.0 + RISING)
    assert draft_rig([run], "", "x.toml").rig.fit.observe == ("stress",)


def test_start_values_are_those_of_the_heat_balance():
    heating, loss, ambient = 30.0, 0.2, 24.0
    duration = TIME[1] - TIME[0]
    temperature = [ambient]
    for duty in DUTY[:-1]:  # exact for an input that is held
        steady = ambient + heating / loss * duty
        temperature.append(steady + (temperature[-1] - steady) * np.exp(-loss * duration))
    run = recording("", temperature=np.array(temperature), duty=DUTY)
    start = thermal_start([run], "duty", ambient)
    assert start is not None
    assert (start.heating, start.loss) == pytest.approx((heating, loss), rel=1e-3)
    rig = draft_rig([run], "", "x.toml").rig
    assert rig.plant.heat.h0 == pytest.approx(loss * 2.046e6 * 0.15e-3 / 4, rel=1e-2) and rig.plant.heat.h2 == 0
    cooled = recording("", temperature=temperature[::-1] - TIME, duty=DUTY)
    assert thermal_start([cooled], "duty", 100.0) is None
