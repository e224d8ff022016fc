"""Observers against what they cannot see."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.estimators.angle_kalman_filter import AngleKalmanFilter
from smajax.control.estimators.imu_sensor import ImuSensor
from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.loop.rollout import Scenario, rollout
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampled_plant import SampledPlant, SampledTransferFunction
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel, ideal_sensor
from smajax.files.rig_file import read_rig
from smajax.laws.transfer_function import TransferFunction
from tests.conftest import ROOT
from tests.unit.control.test_control import loop_of, pid, wire_loop


def thermal(exponent=1.0, gain=0.0) -> ThermalObserver:
    return ThermalObserver(*map(jnp.asarray, (0.667, -0.09, exponent, 25.0, gain)), period=0.05)


def test_an_estimated_temperature_is_the_heat_balance():
    """Steady where a_1 P = -a_2 T_e; a wrong start is forgotten with exp(a_2 t), sooner with a thermocouple."""
    law = thermal()
    step = jax.jit(lambda t: law.step(t, jnp.asarray(6.0)))
    right, wrong = law.reset(25.0), law.reset(33.0)
    for k in range(1, 401):
        right, wrong = step(right), step(wrong)
        assert float(wrong - right) == pytest.approx(8.0 * (1.0 - 0.05 * 0.09) ** k)
    for _ in range(4000):
        right = step(right)
    assert float(right) == pytest.approx(25.0 + 0.667 * 6.0 / 0.09, abs=1e-6)
    helped, alone = law.reset(33.0), law.reset(33.0)
    for _ in range(100):
        helped, alone = thermal(gain=0.5).step(helped, jnp.asarray(6.0), right), step(alone)
    assert abs(helped - right) < abs(alone - right)
    unread = thermal(gain=0.5).step(helped, jnp.asarray(6.0), jnp.asarray(np.nan))
    assert float(unread) == float(step(helped))


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0])
def test_an_exponent_is_safe_below_ambient(exponent):
    law = thermal(exponent)
    assert (
        float(law.step(law.reset(24.0), jnp.zeros(()))) > 24.0
        and float(law.step(law.reset(26.0), jnp.zeros(()))) < 26.0
    )
    assert np.isfinite(jax.grad(lambda t: law.step(t, jnp.asarray(1.0)))(25.0))


def test_an_angle_from_a_biased_gyroscope_and_a_noisy_tilt():
    rng, dt, n = np.random.default_rng(0), 0.05, 4000
    law = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=dt)
    bias = np.radians(1.0) + np.cumsum(np.radians(0.01) * np.sqrt(dt) * rng.standard_normal(n))
    angle = np.radians(30.0) * np.sin(0.3 * dt * np.arange(n + 1))
    rate = np.diff(angle) / dt + bias + np.radians(0.5) * rng.standard_normal(n)
    tilt = angle[1:] + np.radians(2.0) * rng.standard_normal(n)
    _, found = jax.lax.scan(lambda s, z: (law.step(s, *z),) * 2, law.reset(0.0), (jnp.asarray(rate), jnp.asarray(tilt)))
    error = np.asarray(found.mean) - np.column_stack([angle[1:], bias])
    later = error[n // 4 :]
    assert np.degrees(np.sqrt(np.mean(later[:, 0] ** 2))) < 0.4 and np.degrees(np.sqrt(np.mean(later[:, 1] ** 2))) < 0.1
    drift = np.cumsum(rate) * dt - angle[1:]
    assert np.degrees(abs(drift[-1])) > 100.0  # by the rate alone
    distance = np.einsum("ki,kij,kj->k", later, np.linalg.inv(np.asarray(found.covariance)[n // 4 :]), later)
    assert np.mean(distance) == pytest.approx(2.0, rel=0.25)  # two states: it knows how well it knows


def test_a_tilt_that_is_missing_leaves_the_rate():
    """Without tilts the angle is the integral, and what is thought of it widens; one missing tilt is forgotten by the next."""
    law = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=0.05)
    state, rate = law.reset(0.2), jnp.asarray(0.3)
    for k in range(1, 21):
        later = law.step(state, rate)
        assert float(later.mean[0]) == pytest.approx(0.2 + 0.05 * 0.3 * k) and float(later.mean[1]) == 0.0
        assert float(later.covariance[0, 0]) > float(state.covariance[0, 0])
        state = later
    seen = law.step(law.step(state, rate, jnp.asarray(np.nan)), rate, jnp.asarray(0.53))
    assert abs(float(seen.mean[0]) - 0.53) < 0.01 and np.all(np.linalg.eigvalsh(np.asarray(seen.covariance)) > 0.0)
    assert np.isfinite(jax.grad(lambda r: law.step(state, r).mean[0])(rate))


def test_a_temperature_limiter_without_a_thermometer_uses_an_estimate():
    """The estimator's two numbers are a fit of n = 1 to the wire's own warming and cooling."""
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    driven = SampledPlant.of(rig.plant, 0.02)
    wire, heat = rig.plant.wire, rig.plant.heat
    volume = float(wire.area * wire.length)
    loss = 4.0 * float(heat.convection(jnp.asarray(70.0))) / float(wire.diameter) / 2.046e6
    estimate = ThermalObserver(*map(jnp.asarray, (1.0 / (2.046e6 * volume), -loss, 1.0, 20.0, 0.0)), period=0.02)
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    scenario = Scenario.noiseless(np.full(1500, 8e-3))
    law = wire_loop(kp=200.0, limiter=limiter)
    hot = {
        name: np.asarray(eqx.filter_jit(rollout)(driven, one, scenario).channels["temperature"])
        for name, one in (("thermometer", law), ("estimate", dataclasses.replace(law, estimator=estimate)))
    }
    assert hot["estimate"].max() < 88.0 and np.max(np.abs(hot["estimate"] - hot["thermometer"])) < 4.0
    assert np.max(np.abs(hot["estimate"] - hot["thermometer"])) > 0.01


def test_a_thermocouple_corrects_an_estimate_in_a_loop():
    """Thought to lose a third more heat than it does, a wire is held above its limit; a thermocouple, though slow, corrects it."""
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    driven = SampledPlant.of(rig.plant, 0.02)
    wire, heat = rig.plant.wire, rig.plant.heat
    loss = 4.0 * float(heat.convection(jnp.asarray(70.0))) / float(wire.diameter) / 2.046e6
    numbers = 1.0 / (2.046e6 * float(wire.area * wire.length)), -1.33 * loss, 1.0, 20.0
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    law, run = wire_loop(kp=200.0, limiter=limiter), eqx.filter_jit(rollout)
    settled = {}
    for gain, lag in ((0.0, 0.0), (0.0, 0.3), (10.0, 0.3)):
        observer = ThermalObserver(*map(jnp.asarray, (*numbers, gain)), period=0.02)
        instruments = Instruments({"temperature": ideal_sensor()}, 0.02, jnp.asarray(lag))
        done = run(
            driven,
            dataclasses.replace(law, estimator=observer, instruments=instruments),
            Scenario.noiseless(np.full(1500, 8e-3)),
        )
        settled[gain, lag] = float(jnp.mean(done.channels["temperature"][1000:])) - 84.0
    assert settled[0.0, 0.3] == settled[0.0, 0.0]  # what is not trusted changes nothing
    assert 0.0 < settled[10.0, 0.3] < 0.5 * settled[0.0, 0.0]


def test_instruments_measure_what_a_rig_would():
    """A slow thermocouple, a late and coarse voltage; noise that is white, and another one for each meter."""
    n, period = 4000, 0.05
    each = {
        "temperature": SensorModel(jnp.asarray(0.5), jnp.zeros(())),
        "voltage": SensorModel(jnp.asarray(0.02), jnp.asarray(0.01), 2),
    }
    instruments = Instruments(each, period, jnp.asarray(0.4))
    warm = 20.0 + 30.0 * np.clip(np.arange(n) / 200.0 - 1.0, 0.0, 1.0)
    seen = {"temperature_1": warm, "temperature_2": warm[::-1], "angle": np.arange(n) * 1.0}
    seen |= {
        f"{name}_{k}": np.full(n, value)
        for k in (1, 2)
        for name, value in (("voltage", 1.0 * k), ("current", 0.25), ("power", 0.25 * k))
    }
    seen = {name: jnp.asarray(v) for name, v in seen.items()}
    draws = np.random.default_rng(3).standard_normal(n)

    def heard(draws):
        first = instruments.reset({name: v[0] for name, v in seen.items()})
        told = jax.lax.scan(lambda s, row: instruments.step(s, *row), first, (seen, jnp.asarray(draws)))[1]
        return {name: np.asarray(v) for name, v in told.items()}

    calm, noisy = heard(np.zeros(n)), heard(draws)
    shown = np.empty(n)
    shown[0] = warm[0]
    for k in range(1, n):
        shown[k] = shown[k - 1] + (1.0 - np.exp(-period / 0.4)) * (warm[k] - shown[k - 1])
    np.testing.assert_allclose(calm["temperature_1"], shown, atol=1e-9)
    for name in ("angle", "current_1"):
        np.testing.assert_array_equal(noisy[name], seen[name])
    np.testing.assert_allclose(noisy["voltage_2"] / 0.01, np.round(noisy["voltage_2"] / 0.01), atol=1e-6)
    assert np.all(noisy["voltage_2"][:2] == 2.0) and np.std(noisy["voltage_2"][2:]) == pytest.approx(0.02, rel=0.1)
    np.testing.assert_allclose(noisy["power_2"], noisy["voltage_2"] * 0.25)
    pulsed = {"voltage": 2.0, "current": 0.1, "power": 1.0}  # means over pulses, one fifth of the time
    one = Instruments({"voltage": SensorModel(jnp.asarray(0.1), jnp.zeros(()))}, period)
    for draw in (0.0, 1.0):
        state, _ = one.step(one.reset(pulsed), pulsed, jnp.asarray(draw))
        assert float(one.step(state, pulsed, jnp.zeros(()))[1]["power"]) == pytest.approx(1.0 + 0.05 * draw)
    noise = np.stack(
        [(noisy[m] - calm[m])[10:] for m in ("temperature_1", "temperature_2", "voltage_1", "voltage_2")] + [draws[10:]]
    )
    np.testing.assert_allclose(np.std(noise, axis=1), [0.5, 0.5, 0.02, 0.02, 1.0], rtol=0.06)
    assert np.max(np.abs(np.corrcoef(noise) - np.eye(5))) < 0.06  # at a sample none tells of another
    assert max(abs(np.corrcoef(row[1:], row[:-1])[0, 1]) for row in noise) < 0.06


def test_a_temperature_limiter_measures_by_its_thermocouple():
    """A slow thermocouple lets the wire overshoot the limit; by the power it does not. The derivative is that of differences."""
    driven = SampledPlant.of(read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").plant, 0.02)
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    law = wire_loop(kp=200.0, limiter=limiter)
    coarse = SensorModel(jnp.asarray(0.3), jnp.asarray(0.25), 2)
    slow = Instruments(
        {"temperature": coarse, "voltage": SensorModel(jnp.asarray(5e-3), jnp.zeros(()))}, 0.02, jnp.asarray(1.0)
    )
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(500))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(500, 8e-3)), draws=draws)
    estimate = ThermalObserver.of(driven.plant, 84.0, 0.02, gain=0.1)

    @eqx.filter_jit
    def warm(kp, observer, instruments):
        one = dataclasses.replace(law, estimator=observer, instruments=instruments)
        return rollout(driven, eqx.tree_at(lambda one: one.temperature_limiter.pid.kp, one, kp), scenario).channels[
            "temperature"
        ]

    at = jnp.asarray(0.05)
    told, slowly, estimated = (np.asarray(warm(at, *which)) for which in ((None, None), (None, slow), (estimate, slow)))
    assert told.max() < 86.0 and slowly.max() > 90.0 and estimated.max() < 88.0
    fine = eqx.tree_at(lambda m: m.sensors["temperature"].quantum, slow, jnp.zeros(()))
    slope = eqx.filter_jit(jax.jacfwd(lambda kp: warm(kp, estimate, fine)))(at)
    central = np.asarray(warm(at + 1e-6, estimate, fine) - warm(at - 1e-6, estimate, fine)) / 2e-6
    np.testing.assert_allclose(slope, central, atol=1e-4 * np.max(np.abs(central)))
    assert np.max(np.abs(central)) > 1.0


def test_a_loop_steers_by_gyroscope_and_tilt():
    """A joint that a tilt alone would shake: the filter keeps its angle and its command calm, in spite of the gyroscope's bias."""
    period, count = 0.05, 1200
    joint = TransferFunction(*map(jnp.asarray, (1.0, 0.0, 2.0, 1.0, 0.9, 0.1, 0.0)), structure="one-pole")
    driven = SampledTransferFunction.of(joint, "angle", period)
    law = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=period)
    sensors = ImuSensor(law, *map(jnp.asarray, np.radians([0.5, 2.0, 1.0])))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(count))
    wave = 0.5 + 0.2 * np.sin(0.3 * period * np.arange(count))
    scenario = dataclasses.replace(Scenario.noiseless(wave, initial_reference=0.5), draws=draws)

    def run(kp, sensor):
        steered = pid(kp, 2.0, 0.0, tf=0.0, low=-5.0, high=5.0, dt=period)
        return rollout(driven, loop_of(steered, sensor=sensor), scenario)

    tilted = SensorModel(jnp.asarray(np.radians(2.0)), jnp.zeros(()))
    ends = {name: eqx.filter_jit(run)(jnp.asarray(4.0), one) for name, one in (("filter", sensors), ("tilt", tilted))}
    moves = {name: float(np.std(np.diff(np.asarray(done.command)[:, 0]))) for name, done in ends.items()}
    errors = {
        n: np.degrees(np.sqrt(np.mean((np.asarray(d.channels["angle"])[300:] - wave[300:]) ** 2)))
        for n, d in ends.items()
    }
    assert moves["filter"] < 0.2 * moves["tilt"] and errors["filter"] < 2.0
    angles, late = np.linspace(0.5, 1.0, 30), dataclasses.replace(sensors, delay=3)
    told = []
    for one in (sensors, late):
        state, each = one.reset(jnp.asarray(angles[0])), []
        for angle in angles:
            state, heard = one.step(state, jnp.asarray(angle), jnp.zeros(()))
            each.append(float(heard))
        told.append(each)
    np.testing.assert_allclose(told[1], [angles[0]] * 3 + told[0][:-3], rtol=1e-12)

    unbiased = dataclasses.replace(sensors, bias=jnp.zeros(()))
    state = unbiased.reset(jnp.asarray(angles[0]))
    for angle in [*angles, 0.2]:  # its response is 1, to a jump as well
        state, heard = unbiased.step(state, jnp.asarray(angle), jnp.zeros(()))
        assert float(heard) == pytest.approx(angle, abs=1e-12)

    coarse = dataclasses.replace(sensors, rate_quantum=np.radians(2.0), tilt_quantum=np.radians(5.0))
    heard, rounded = (
        float(one.step(one.reset(jnp.asarray(0.5)), jnp.asarray(0.52), jnp.asarray(0.3))[1])
        for one in (sensors, coarse)
    )
    step = np.radians(2.0) * round((0.02 / period + np.radians(1.0)) / np.radians(2.0))
    tilt = np.radians(5.0) * round((0.52 + 0.3 * np.radians(2.0)) / np.radians(5.0))
    by_hand = law.step(law.reset(jnp.asarray(0.5)), jnp.asarray(step), jnp.asarray(tilt)).mean[0]
    assert rounded == pytest.approx(float(by_hand), abs=1e-12) and abs(rounded - heard) > 1e-4

    def error(kp):
        return jnp.mean((run(kp, sensors).channels["angle"] - scenario.reference) ** 2)

    slope, value, at = jax.jit(jax.grad(error)), jax.jit(error), jnp.asarray(4.0)
    assert float(slope(at)) == pytest.approx((float(value(at + 1e-4)) - float(value(at - 1e-4))) / 2e-4, rel=1e-4)
