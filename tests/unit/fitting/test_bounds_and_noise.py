"""Parameters at bounds by their gradients and scales, and the noise floor of coarse sensors."""

import dataclasses

import numpy as np
import pytest

from smajax import parameters
from smajax.files.rig_file import parse_rig
from smajax.fitting.bounds import parameters_at_bounds
from smajax.fitting.fit import fit
from smajax.fitting.noise import quantisation_noise
from smajax.plant.drive import DutyDrive, PowerDrive
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate
from tests.support import plants

ROOT_12 = np.sqrt(12.0)


@dataclasses.dataclass(frozen=True)
class Settings:
    free: tuple = ()
    per_recording: tuple = ()
    initial: tuple = ()
    bounds: dict = dataclasses.field(default_factory=dict)
    observe: tuple = ("temperature",)
    noise: dict = dataclasses.field(default_factory=dict)
    starts: int = 1
    seed: int = 0


def heated(drive, signal: str, level: float, *, rows: int = 80, step: float = 0.1):
    """Return a wire under a weight that is heated in pulses, and its exact recording."""
    plant = dataclasses.replace(plants.dead_weight(), drive=drive)
    time = np.arange(rows) * step
    pulses = level * (np.sin(time * 1.7) > 0.0)
    blank = plants.recording({signal: pulses}, time)
    temperature = np.asarray(simulate(plant, discretise(plant, blank)).channels["temperature"])
    return plant, plants.recording({signal: pulses, "temperature": temperature}, time)


def with_temperature(recording, temperature):
    return dataclasses.replace(recording, channels={**recording.channels, "temperature": temperature})


def fitted(plant, recording, **settings):
    result = fit(plant, [recording], Settings(**settings))
    return result, {e.name: e for e in result.estimates}


@pytest.mark.slow
@pytest.mark.parametrize("upper", [1.0, 1e6, 1e12])
def test_the_width_of_the_bounds_decides_neither_a_bound_nor_an_interval(upper):
    plant, exact = heated(PowerDrive(gain=0.03), "power", 20.0)
    noise = 0.05 * np.random.default_rng(6).standard_normal(len(exact))
    recording = with_temperature(exact, exact.channels["temperature"] + noise)
    names = ("drive.gain", "heat.h0")
    start = dataclasses.replace(plant, drive=PowerDrive(gain=0.04))
    _, wide = fitted(start, recording, free=names, bounds={"drive.gain": (0.0, upper)})
    assert not wide["drive.gain"].at_bound and wide["drive.gain"].lower95 < 0.03 < wide["drive.gain"].upper95
    assert wide["heat.h0"].lower95 < 100.6 < wide["heat.h0"].upper95
    _, declared = fitted(start, recording, free=names)
    assert wide["heat.h0"].lower95 == pytest.approx(declared["heat.h0"].lower95, rel=1e-6)


def in_vacuum():
    plant = dataclasses.replace(plants.dead_weight(), drive=PowerDrive())
    return parameters.replace(plant, {"heat.h0": 0.05, "heat.h2": 0.0}), {"power": 0.02}


def with_thick_leads():
    drive = DutyDrive(supply=6.0, lead_resistance=5e-4)
    return dataclasses.replace(plants.dead_weight(), drive=drive), {"duty": 0.3}


def with_a_soft_spring():
    return parameters.replace(plants.bias_spring(), {"spring.stiffness": 5.0}), {"voltage": 3.0}


@pytest.mark.slow
@pytest.mark.parametrize(
    ("rig", "name", "start", "channel", "noise"),
    [
        (in_vacuum, "heat.h0", 1.0, "temperature", 5e-3),
        (with_thick_leads, "drive.lead_resistance", 0.1, "temperature", 1e-4),
        (with_a_soft_spring, "spring.stiffness", 300.0, "stress", 2e4),
    ],
    ids=["vacuum", "leads", "spring"],
)
def test_values_far_below_the_usual_ones_are_found_and_not_at_their_bound(rig, name, start, channel, noise):
    """Below 1e-6 of the width of the bounds that the declarations have: 0.05 of 100,000 W/m^2/K, and others."""
    plant, drive = rig()
    ((signal, level),) = drive.items()
    time = np.arange(120) * 0.1
    channels = {signal: level * (np.sin(time * 1.7) > 0.0)}
    exact = np.asarray(simulate(plant, discretise(plant, plants.recording(channels, time))).channels[channel])
    channels |= {channel: exact + noise * np.random.default_rng(3).standard_normal(len(time))}
    begin = parameters.replace(plant, {name: start})
    result, estimates = fitted(begin, plants.recording(channels, time), free=(name,), observe=(channel,))
    truth, estimate = float(parameters.get(plant, name)), estimates[name]
    assert not estimate.at_bound and estimate.estimate == pytest.approx(truth, rel=0.05)
    assert 0.0 < estimate.lower95 < truth < estimate.upper95
    assert result.rmse(channel) == pytest.approx(noise, rel=0.2)


def test_a_parameter_far_below_its_scale_is_not_at_its_bound():
    """Minimum at 1e-9 of the scale above the bound: between the two the cost rises again."""
    jacobian, vector = np.array([[1e9], [2e9]]), np.array([1e-9])
    bounds = np.zeros(1), np.full(1, 1e6)
    assert not parameters_at_bounds(vector, *bounds, 1e-3 * jacobian[:, 0] * 1e-9, jacobian)[0]


def test_a_parameter_pressed_against_its_bound_is_there_also_between_close_bounds():
    jacobian = np.array([[1.0, 0.0], [0.0, 1.0]])
    lower, upper = np.array([0.0, 0.0]), np.array([1e-8, 1.0])
    held = parameters_at_bounds(np.array([1e-8, 0.0]), lower, upper, np.array([-1.0, 0.5]), jacobian)
    assert held.tolist() == [True, True]
    away = parameters_at_bounds(np.zeros(2), lower, np.ones(2), np.array([-1.0, -0.5]), jacobian)
    assert not np.any(away)


@pytest.mark.slow
@pytest.mark.parametrize(("step", "offset"), [(0.25, 0.0), (0.0625, 0.0), (5.0 / 1023.0 * 100.0, -50.0)])
def test_the_noise_floor_of_a_coarse_thermometer_is_its_rounding(step, offset):
    """A thermocouple chip of 0.25 K, one of 1/16 K, and a 10 bit converter behind an analogue sensor of 100 K/V."""
    plant, exact = heated(DutyDrive(supply=6.0, lead_resistance=4.0), "duty", 0.3, step=0.05)
    coarse = offset + step * np.round((exact.channels["temperature"] - offset) / step)
    result, _ = fitted(plant, with_temperature(exact, coarse), free=("heat.h0",))
    # The differences of a signal that crosses several steps of the sensor a row see somewhat more than the rounding.
    assert 0.999 < result.noise_floor["temperature"] / (step / ROOT_12) < 1.5
    assert result.rmse("temperature") < 1.15 * result.noise_floor["temperature"]


RIG = """
schema = 1
[rig]
kind = "bias-spring"
control = "duty"
parameters = "rotary-table1"
[heat]
h0 = "100 W/m^2/K"
capacity = "2.05 MJ/m^3/K"
[drive]
supply = "5 V"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[spring]
stiffness = "0.5 N/mm"
preload = "0.5 N"
[recording]
sample_period = "100 ms"
[channels]
{column}
duty = {{column = "pwm", full_scale = 255}}
[fit]
free = ["heat.h0"]
observe = ["{channel}"]
starts = 1
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("channel", "column", "to_numbers", "step"),
    [
        (
            "force",
            'force = {column = "x", factor = -0.0087, offset = 7.5, unit = "N"}',
            lambda values: np.round((7.5 - values) / 0.0087),
            0.0087,
        ),
        (
            "temperature",
            'temperature = {column = "x", unit = "degF"}',
            lambda values: 0.5 * np.round((32.0 + 1.8 * values) / 0.5),
            0.5 / 1.8,
        ),
        (
            "displacement",
            'displacement = {column = "x", factor = 25.0, full_scale = 1023, unit = "mm"}',
            lambda values: np.round(values / 25e-3 * 1023),
            25e-3 / 1023,
        ),
    ],
    ids=["counts of a load cell", "half degrees Fahrenheit", "potentiometer"],
)
def test_the_floor_is_the_step_of_the_numbers_in_the_file(channel, column, to_numbers, step, tmp_path):
    """The steps are those of counts or of another unit, and the channels are in SI."""
    rig = parse_rig(RIG.format(column=column, channel=channel))
    time = np.arange(150) * 0.1
    pwm = np.where(np.sin(time * 1.7) > 0.0, 120, 0)
    recording = plants.recording({"duty": pwm / 255}, time)
    exact = np.asarray(simulate(rig.plant, discretise(rig.plant, recording)).channels[channel])
    rows = (f"{number:.10g},{duty}" for number, duty in zip(to_numbers(exact), pwm, strict=True))
    (tmp_path / "log.csv").write_text("\n".join(["x,pwm", *rows]))
    result = fit(parameters.replace(rig.plant, {"heat.h0": 60.0}), [rig.read(tmp_path / "log.csv")], rig.fit)
    assert 0.99 < result.noise_floor[channel] / (step / ROOT_12) < 1.5
    assert result.rmse(channel) < 1.2 * result.noise_floor[channel]


@pytest.mark.slow
def test_noise_above_the_rounding_is_the_floor():
    plant, exact = heated(DutyDrive(supply=6.0, lead_resistance=4.0), "duty", 0.3, rows=300, step=0.05)
    noisy = exact.channels["temperature"] + np.random.default_rng(0).standard_normal(len(exact))
    result, _ = fitted(plant, with_temperature(exact, np.round(noisy / 0.25) * 0.25), free=("heat.h0",))
    assert result.noise_floor["temperature"] == pytest.approx(1.0, rel=0.2)


@pytest.mark.parametrize(
    ("values", "step"),
    [
        (np.round(20 + 30 * np.sin(np.arange(200) / 30), 2), 0.01),
        (3.3 + 0.7 * np.round(100 * np.random.default_rng(0).standard_normal(300)), 0.7),
        (np.append(np.round(np.sin(np.arange(200) / 30), 1), np.nan), 0.1),
        (np.random.default_rng(1).standard_normal(50), 0.0),
        (np.linspace(0.0, 1.0, 20), 0.0),
        (np.zeros(9), 0.0),
        (np.full(3, np.nan), 0.0),
    ],
    ids=["decimals", "counts", "gap", "unrounded", "ramp", "constant", "unmeasured"],
)
def test_steps_of_a_sensor(values, step):
    assert quantisation_noise(values) * ROOT_12 == pytest.approx(step, rel=1e-6, abs=1e-12)
