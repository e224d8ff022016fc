"""Parameters at bounds by their gradients and scales, and the noise floor of coarse sensors."""

import dataclasses

import numpy as np
import pytest

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


@pytest.mark.parametrize(("step", "offset"), [(0.25, 0.0), (0.0625, 0.0), (5.0 / 1023.0 * 100.0, -50.0)])
def test_the_noise_floor_of_a_coarse_thermometer_is_its_rounding(step, offset):
    """A thermocouple chip of 0.25 K, one of 1/16 K, and a 10 bit converter behind an analogue sensor of 100 K/V."""
    plant, exact = heated(DutyDrive(supply=6.0, lead_resistance=4.0), "duty", 0.3, step=0.05)
    coarse = offset + step * np.round((exact.channels["temperature"] - offset) / step)
    result, _ = fitted(plant, with_temperature(exact, coarse), free=("heat.h0",))
    # The differences of a signal that crosses several steps of the sensor a row see somewhat more than the rounding.
    assert 0.999 < result.noise_floor["temperature"] / (step / ROOT_12) < 1.5
    assert result.rmse("temperature") < 1.15 * result.noise_floor["temperature"]


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
