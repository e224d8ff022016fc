"""Observers and instruments against the exact quantities that they estimate and measure."""

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
    """It settles where a_1 P = -a_2 T_e; an initial error decays with exp(a_2 t), faster with a thermocouple."""
    observer = thermal()
    step = jax.jit(lambda t: observer.step(t, jnp.asarray(6.0)))
    exact, disturbed = observer.reset(25.0), observer.reset(33.0)
    for k in range(1, 401):
        exact, disturbed = step(exact), step(disturbed)
        assert float(disturbed - exact) == pytest.approx(8.0 * (1.0 - 0.05 * 0.09) ** k)
    for _ in range(4000):
        exact = step(exact)
    assert float(exact) == pytest.approx(25.0 + 0.667 * 6.0 / 0.09, abs=1e-6)
    corrected, uncorrected = observer.reset(33.0), observer.reset(33.0)
    for _ in range(100):
        corrected, uncorrected = thermal(gain=0.5).step(corrected, jnp.asarray(6.0), exact), step(uncorrected)
    assert abs(corrected - exact) < abs(uncorrected - exact)
    without_reading = thermal(gain=0.5).step(corrected, jnp.asarray(6.0), jnp.asarray(np.nan))
    assert float(without_reading) == float(step(corrected))


@pytest.mark.parametrize("exponent", [1.0, 2.0, 3.0])
def test_an_exponent_is_safe_below_ambient(exponent):
    observer = thermal(exponent)
    assert (
        float(observer.step(observer.reset(24.0), jnp.zeros(()))) > 24.0
        and float(observer.step(observer.reset(26.0), jnp.zeros(()))) < 26.0
    )
    assert np.isfinite(jax.grad(lambda t: observer.step(t, jnp.asarray(1.0)))(25.0))


def test_an_angle_from_a_biased_gyroscope_and_a_noisy_tilt():
    rng, dt, n = np.random.default_rng(0), 0.05, 4000
    angle_filter = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=dt)
    bias = np.radians(1.0) + np.cumsum(np.radians(0.01) * np.sqrt(dt) * rng.standard_normal(n))
    angle = np.radians(30.0) * np.sin(0.3 * dt * np.arange(n + 1))
    rate = np.diff(angle) / dt + bias + np.radians(0.5) * rng.standard_normal(n)
    tilt = angle[1:] + np.radians(2.0) * rng.standard_normal(n)
    _, estimates = jax.lax.scan(
        lambda s, z: (angle_filter.step(s, *z),) * 2, angle_filter.reset(0.0), (jnp.asarray(rate), jnp.asarray(tilt))
    )
    error = np.asarray(estimates.mean) - np.column_stack([angle[1:], bias])
    settled = error[n // 4 :]
    assert (
        np.degrees(np.sqrt(np.mean(settled[:, 0] ** 2))) < 0.4
        and np.degrees(np.sqrt(np.mean(settled[:, 1] ** 2))) < 0.1
    )
    drift = np.cumsum(rate) * dt - angle[1:]
    assert np.degrees(abs(drift[-1])) > 100.0  # integral of the rate alone
    distance = np.einsum("ki,kij,kj->k", settled, np.linalg.inv(np.asarray(estimates.covariance)[n // 4 :]), settled)
    assert np.mean(distance) == pytest.approx(2.0, rel=0.25)  # two states: the covariance is that of the error


def test_without_a_tilt_the_angle_is_the_integral_of_the_rate():
    """Without tilts the angle is the integral of the rate, and its variance grows; the next tilt corrects the angle."""
    angle_filter = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=0.05)
    state, rate = angle_filter.reset(0.2), jnp.asarray(0.3)
    for k in range(1, 21):
        later = angle_filter.step(state, rate)
        assert float(later.mean[0]) == pytest.approx(0.2 + 0.05 * 0.3 * k) and float(later.mean[1]) == 0.0
        assert float(later.covariance[0, 0]) > float(state.covariance[0, 0])
        state = later
    corrected = angle_filter.step(angle_filter.step(state, rate, jnp.asarray(np.nan)), rate, jnp.asarray(0.53))
    assert abs(float(corrected.mean[0]) - 0.53) < 0.01 and np.all(
        np.linalg.eigvalsh(np.asarray(corrected.covariance)) > 0.0
    )
    assert np.isfinite(jax.grad(lambda r: angle_filter.step(state, r).mean[0])(rate))


@pytest.mark.slow
def test_a_temperature_limiter_without_a_thermometer_uses_an_observer():
    """The two coefficients of the observer are those of the wire's own heat balance with n = 1."""
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    system = SampledPlant.of(rig.plant, 0.02)
    wire, heat = rig.plant.wire, rig.plant.heat
    volume = float(wire.area * wire.length)
    loss = 4.0 * float(heat.convection(jnp.asarray(70.0))) / float(wire.diameter) / 2.046e6
    observer = ThermalObserver(*map(jnp.asarray, (1.0 / (2.046e6 * volume), -loss, 1.0, 20.0, 0.0)), period=0.02)
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    scenario = Scenario.noiseless(np.full(1500, 8e-3))
    loop = wire_loop(kp=200.0, limiter=limiter)
    temperatures = {
        name: np.asarray(eqx.filter_jit(rollout)(system, variant, scenario).channels["temperature"])
        for name, variant in (("thermometer", loop), ("estimate", dataclasses.replace(loop, estimator=observer)))
    }
    assert (
        temperatures["estimate"].max() < 88.0
        and np.max(np.abs(temperatures["estimate"] - temperatures["thermometer"])) < 4.0
    )
    assert np.max(np.abs(temperatures["estimate"] - temperatures["thermometer"])) > 0.01


def test_a_thermocouple_corrects_an_estimate_in_a_loop():
    """An observer with a heat loss too large by a third lets the wire exceed its limit; a slow thermocouple corrects it."""
    rig = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")
    system = SampledPlant.of(rig.plant, 0.02)
    wire, heat = rig.plant.wire, rig.plant.heat
    loss = 4.0 * float(heat.convection(jnp.asarray(70.0))) / float(wire.diameter) / 2.046e6
    numbers = 1.0 / (2.046e6 * float(wire.area * wire.length)), -1.33 * loss, 1.0, 20.0
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    loop, run = wire_loop(kp=200.0, limiter=limiter), eqx.filter_jit(rollout)
    excess = {}
    for gain, lag in ((0.0, 0.0), (0.0, 0.3), (10.0, 0.3)):
        observer = ThermalObserver(*map(jnp.asarray, (*numbers, gain)), period=0.02)
        instruments = Instruments({"temperature": ideal_sensor()}, 0.02, jnp.asarray(lag))
        result = run(
            system,
            dataclasses.replace(loop, estimator=observer, instruments=instruments),
            Scenario.noiseless(np.full(1500, 8e-3)),
        )
        excess[gain, lag] = float(jnp.mean(result.channels["temperature"][1000:])) - 84.0
    assert excess[0.0, 0.3] == excess[0.0, 0.0]  # a gain of 0 ignores the thermocouple
    assert 0.0 < excess[10.0, 0.3] < 0.5 * excess[0.0, 0.0]


def test_instruments_have_lag_delay_quantisation_and_noise():
    """A slow thermocouple, a delayed and quantised voltage; white noise, independent between the instruments."""
    n, period = 4000, 0.05
    sensors = {
        "temperature": SensorModel(jnp.asarray(0.5), jnp.zeros(())),
        "voltage": SensorModel(jnp.asarray(0.02), jnp.asarray(0.01), 2),
    }
    instruments = Instruments(sensors, period, jnp.asarray(0.4))
    temperature = 20.0 + 30.0 * np.clip(np.arange(n) / 200.0 - 1.0, 0.0, 1.0)
    channels = {"temperature_1": temperature, "temperature_2": temperature[::-1], "angle": np.arange(n) * 1.0}
    channels |= {
        f"{name}_{k}": np.full(n, value)
        for k in (1, 2)
        for name, value in (("voltage", 1.0 * k), ("current", 0.25), ("power", 0.25 * k))
    }
    channels = {name: jnp.asarray(v) for name, v in channels.items()}
    draws = np.random.default_rng(3).standard_normal(n)

    def measure(draws):
        state = instruments.reset({name: v[0] for name, v in channels.items()})
        measured = jax.lax.scan(lambda s, row: instruments.step(s, *row), state, (channels, jnp.asarray(draws)))[1]
        return {name: np.asarray(v) for name, v in measured.items()}

    noiseless, noisy = measure(np.zeros(n)), measure(draws)
    reading = np.empty(n)
    reading[0] = temperature[0]
    for k in range(1, n):
        reading[k] = reading[k - 1] + (1.0 - np.exp(-period / 0.4)) * (temperature[k] - reading[k - 1])
    np.testing.assert_allclose(noiseless["temperature_1"], reading, atol=1e-9)
    for name in ("angle", "current_1"):
        np.testing.assert_array_equal(noisy[name], channels[name])
    np.testing.assert_allclose(noisy["voltage_2"] / 0.01, np.round(noisy["voltage_2"] / 0.01), atol=1e-6)
    assert np.all(noisy["voltage_2"][:2] == 2.0) and np.std(noisy["voltage_2"][2:]) == pytest.approx(0.02, rel=0.1)
    np.testing.assert_allclose(noisy["power_2"], noisy["voltage_2"] * 0.25)
    # Means over pulses, one fifth of the time.
    pulsed = {"voltage": jnp.asarray(2.0), "current": jnp.asarray(0.1), "power": jnp.asarray(1.0)}
    voltmeter = Instruments({"voltage": SensorModel(jnp.asarray(0.1), jnp.zeros(()))}, period)
    for draw in (0.0, 1.0):
        state, _ = voltmeter.step(voltmeter.reset(pulsed), pulsed, jnp.asarray(draw))
        assert float(voltmeter.step(state, pulsed, jnp.zeros(()))[1]["power"]) == pytest.approx(1.0 + 0.05 * draw)
    noise = np.stack(
        [(noisy[m] - noiseless[m])[10:] for m in ("temperature_1", "temperature_2", "voltage_1", "voltage_2")]
        + [draws[10:]]
    )
    np.testing.assert_allclose(np.std(noise, axis=1), [0.5, 0.5, 0.02, 0.02, 1.0], rtol=0.06)
    assert np.max(np.abs(np.corrcoef(noise) - np.eye(5))) < 0.06  # independent at a sample
    assert max(abs(np.corrcoef(row[1:], row[:-1])[0, 1]) for row in noise) < 0.06


@pytest.mark.slow
def test_a_temperature_limiter_measures_by_its_thermocouple():
    """A slow thermocouple lets the wire exceed the limit, an observer does not; derivatives are those of differences."""
    system = SampledPlant.of(read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").plant, 0.02)
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=0.02), jnp.asarray(84.0))
    loop = wire_loop(kp=200.0, limiter=limiter)
    coarse = SensorModel(jnp.asarray(0.3), jnp.asarray(0.25), 2)
    slow = Instruments(
        {"temperature": coarse, "voltage": SensorModel(jnp.asarray(5e-3), jnp.zeros(()))}, 0.02, jnp.asarray(1.0)
    )
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(500))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(500, 8e-3)), draws=draws)
    estimate = ThermalObserver.of(system.plant, 84.0, 0.02, gain=0.1)

    @eqx.filter_jit
    def temperatures(kp, observer, instruments):
        variant = dataclasses.replace(loop, estimator=observer, instruments=instruments)
        return rollout(
            system, eqx.tree_at(lambda variant: variant.temperature_limiter.pid.kp, variant, kp), scenario
        ).channels["temperature"]

    gain = jnp.asarray(0.05)
    exact, lagging, estimated = (
        np.asarray(temperatures(gain, *which)) for which in ((None, None), (None, slow), (estimate, slow))
    )
    assert exact.max() < 86.0 and lagging.max() > 90.0 and estimated.max() < 88.0
    fine = eqx.tree_at(lambda m: m.sensors["temperature"].quantum, slow, jnp.zeros(()))
    slope = eqx.filter_jit(jax.jacfwd(lambda kp: temperatures(kp, estimate, fine)))(gain)
    central = np.asarray(temperatures(gain + 1e-6, estimate, fine) - temperatures(gain - 1e-6, estimate, fine)) / 2e-6
    np.testing.assert_allclose(slope, central, atol=1e-4 * np.max(np.abs(central)))
    assert np.max(np.abs(central)) > 1.0


@pytest.mark.slow
def test_a_loop_with_gyroscope_and_tilt_sensor():
    """The command moves much less with the filter than with the noisy tilt alone, in spite of the gyroscope's bias."""
    period, count = 0.05, 1200
    joint = TransferFunction(*map(jnp.asarray, (1.0, 0.0, 2.0, 1.0, 0.9, 0.1, 0.0)), structure="one-pole")
    system = SampledTransferFunction.of(joint, "angle", period)
    angle_filter = AngleKalmanFilter(*map(jnp.asarray, np.radians([0.5, 0.01, 2.0])), period=period)
    sensors = ImuSensor(angle_filter, *map(jnp.asarray, np.radians([0.5, 2.0, 1.0])))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(count))
    wave = 0.5 + 0.2 * np.sin(0.3 * period * np.arange(count))
    scenario = dataclasses.replace(Scenario.noiseless(wave, initial_reference=0.5), draws=draws)

    def run(kp, sensor):
        controller = pid(kp, 2.0, 0.0, tf=0.0, low=-5.0, high=5.0, dt=period)
        return rollout(system, loop_of(controller, sensor=sensor), scenario)

    tilt_sensor = SensorModel(jnp.asarray(np.radians(2.0)), jnp.zeros(()))
    rollouts = {
        name: eqx.filter_jit(run)(jnp.asarray(4.0), imu) for name, imu in (("filter", sensors), ("tilt", tilt_sensor))
    }
    command_steps = {
        name: float(np.std(np.diff(np.asarray(result.command)[:, 0]))) for name, result in rollouts.items()
    }
    errors = {
        n: np.degrees(np.sqrt(np.mean((np.asarray(d.channels["angle"])[300:] - wave[300:]) ** 2)))
        for n, d in rollouts.items()
    }
    assert command_steps["filter"] < 0.2 * command_steps["tilt"] and errors["filter"] < 2.0
    angles, late = np.linspace(0.5, 1.0, 30), dataclasses.replace(sensors, delay=3)
    angle_series = []
    for imu in (sensors, late):
        state, estimates = imu.reset(jnp.asarray(angles[0])), []
        for angle in angles:
            state, estimate = imu.step(state, jnp.asarray(angle), jnp.zeros(()))
            estimates.append(float(estimate))
        angle_series.append(estimates)
    np.testing.assert_allclose(angle_series[1], [angles[0]] * 3 + angle_series[0][:-3], rtol=1e-12)

    unbiased = dataclasses.replace(sensors, bias=jnp.zeros(()))
    state = unbiased.reset(jnp.asarray(angles[0]))
    for angle in [*angles, 0.2]:  # the response is 1, also to a jump
        state, estimate = unbiased.step(state, jnp.asarray(angle), jnp.zeros(()))
        assert float(estimate) == pytest.approx(angle, abs=1e-12)

    coarse = dataclasses.replace(sensors, rate_quantum=np.radians(2.0), tilt_quantum=np.radians(5.0))
    estimate, rounded = (
        float(imu.step(imu.reset(jnp.asarray(0.5)), jnp.asarray(0.52), jnp.asarray(0.3))[1])
        for imu in (sensors, coarse)
    )
    step = np.radians(2.0) * round((0.02 / period + np.radians(1.0)) / np.radians(2.0))
    tilt = np.radians(5.0) * round((0.52 + 0.3 * np.radians(2.0)) / np.radians(5.0))
    by_hand = angle_filter.step(angle_filter.reset(jnp.asarray(0.5)), jnp.asarray(step), jnp.asarray(tilt)).mean[0]
    assert rounded == pytest.approx(float(by_hand), abs=1e-12) and abs(rounded - estimate) > 1e-4

    def error(kp):
        return jnp.mean((run(kp, sensors).channels["angle"] - scenario.reference) ** 2)

    slope, value, gain = jax.jit(jax.grad(error)), jax.jit(error), jnp.asarray(4.0)
    assert float(slope(gain)) == pytest.approx((float(value(gain + 1e-4)) - float(value(gain - 1e-4))) / 2e-4, rel=1e-4)
