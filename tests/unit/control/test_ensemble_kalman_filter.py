"""Ensemble Kalman filter on exact wires that differ from its plant."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.estimators.ensemble_kalman_filter import EnsembleKalmanFilter
from smajax.control.loop.rollout import Scenario, rollout
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.files.rig_file import read_rig
from tests.conftest import ROOT
from tests.reference.rig_file import read_rig as read_reference
from tests.reference.rig_file import simulate
from tests.unit.control.test_control import loop_of, pid

RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
PERIOD, ROWS, SETTLED = 0.05, 1200, 120
NOISE = {"voltage": 2e-3, "temperature": 0.5, "displacement": 2e-5}
LAG = 0.6


def filter_of(*channels: str, deviations=(25.0, 4.0), members=32) -> EnsembleKalmanFilter:
    """A filter whose plant is that of the rig file; only ``channels`` are measured."""
    noise = {n: jnp.asarray(s if n in channels else np.inf) for n, s in NOISE.items()}
    parameter_deviations = {"heat.h0": jnp.asarray(deviations[0]), "environment.ambient": jnp.asarray(deviations[1])}
    return EnsembleKalmanFilter(
        SampledPlant.of(read_rig(RIG).plant, PERIOD), noise, parameter_deviations, jnp.asarray(LAG), members=members
    )


@eqx.filter_jit
def run_filter(kalman_filter: EnsembleKalmanFilter, current, measured):
    """Estimates at the rows after the first, and the ensemble at the end."""

    def step(ensemble, row):
        ensemble = kalman_filter.step(kalman_filter.apply_command(ensemble, row[0][None]), row[1])
        return ensemble, kalman_filter.estimate(ensemble)

    return jax.lax.scan(step, kalman_filter.reset(), (current, measured))


def bench(convection: float, ambient: float, seed: int):
    """A minute of the exact wire in other surroundings, with partial loops and pauses: inputs, measurements, truth."""
    truth = read_reference(RIG).changed(h0=convection, h2=convection, austenite_shift=0.5)
    truth = dataclasses.replace(truth, wire=truth.wire._replace(ambient=ambient))
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.15, 0.36, 41) * np.sqrt(convection)
    levels[::4] = 0.03
    current = np.repeat(levels, ROWS // 40)[: ROWS + 1]
    run = simulate(truth, {"time": np.arange(ROWS + 1) * PERIOD, "current": current})
    temperature = run.temperature[:, 0]
    thermocouple = np.full(ROWS + 1, temperature[0])
    for k in range(ROWS):
        thermocouple[k + 1] = thermocouple[k] + (1.0 - np.exp(-PERIOD / LAG)) * (temperature[k + 1] - thermocouple[k])
    exact = {
        "voltage": run.resistance[1:, 0] * current[:-1],
        "temperature": thermocouple[1:],
        "displacement": run.position[1:],
    }
    measured = {n: jnp.asarray(v + NOISE[n] * rng.standard_normal(ROWS)) for n, v in exact.items()}
    return jnp.asarray(current[:-1]), measured, temperature[1:], (run.detwinned + run.twinned)[1:, 0]


def rms(error) -> float:
    return float(np.sqrt(np.mean(np.asarray(error)[SETTLED:] ** 2)))


def covered(error, deviation) -> float:
    return float(np.mean(np.abs(np.asarray(error)[SETTLED:]) < 1.96 * np.asarray(deviation)[SETTLED:]))


BENCHES = ((1.2, 24.0, 3), (0.8, 16.0, 4), (1.2, 18.0, 5), (0.85, 25.0, 6))


@pytest.mark.slow
def test_a_hidden_temperature_is_estimated_with_its_deviation():
    """With errors of 15 to 20 % in convection, 2 to 5 K in ambient, half a kelvin in transformation temperatures."""
    errors, coverage = {}, {}
    for convection, ambient, seed in BENCHES:
        current, measured, temperature, martensite = bench(convection, ambient, seed)
        for channels in ((), ("voltage",), ("temperature",), ("voltage", "temperature")):
            _, estimates = run_filter(
                filter_of(*channels, deviations=(25.0, 4.0) if channels else (1e-9, 1e-9)), current, measured
            )
            error = np.asarray(estimates.mean["temperature"]) - temperature
            errors[seed, channels], coverage[seed, channels] = (
                rms(error),
                covered(error, estimates.standard_deviation["temperature"]),
            )
            if "voltage" in channels:
                assert rms(estimates.martensite[:, 0] - martensite) < 0.01
        assert rms(np.asarray(measured["temperature"]) - temperature) > 10.0  # the thermocouple alone
        plant_error = errors[seed, ()]  # the plant alone
        assert plant_error > 8.0 and errors[seed, ("voltage",)] < 0.5 * plant_error
        assert errors[seed, ("temperature",)] < 1.0 and errors[seed, ("voltage", "temperature")] < 1.0
    assert np.mean([errors[seed, ("voltage",)] / errors[seed, ()] for *_, seed in BENCHES]) < 0.4
    for channels in (("voltage",), ("temperature",), ("voltage", "temperature")):
        coverages = [coverage[seed, channels] for *_, seed in BENCHES]
        assert min(coverages) >= 0.85 and np.mean(coverages) <= 0.99, (channels, coverages)


def test_it_estimates_the_convection_and_the_ambient_temperature():
    """From a wire in other surroundings; the estimated channel is that of the estimate."""
    current, measured, _, _ = bench(1.2, 24.0, 3)
    kalman_filter = filter_of("voltage", "temperature", "displacement")
    end, estimates = run_filter(kalman_filter, current, measured)
    assert float(kalman_filter.estimated_channel(end, "displacement")) == pytest.approx(
        float(estimates.mean["displacement"][-1]), rel=1e-12
    )
    ambient, convection = np.mean(np.asarray(end.parameters), axis=0)
    assert ambient == pytest.approx(24.0, abs=3.0) and convection == pytest.approx(120.7, rel=0.12)
    assert bool(jnp.all((estimates.martensite >= 0.0) & (estimates.martensite <= 1.0)))


def test_a_measurement_that_drops_out_is_skipped():
    """Without the thermocouple for ten seconds the filter goes on with the voltage; then it uses both again."""
    current, measured, temperature, _ = bench(1.2, 24.0, 3)
    rows = np.arange(ROWS)
    missing = (rows >= 600) & (rows < 800)
    with_dropout = measured | {"temperature": jnp.where(missing, jnp.nan, measured["temperature"])}
    errors = [
        np.asarray(run_filter(filter_of("voltage", "temperature"), current, m)[1].mean["temperature"]) - temperature
        for m in (measured, with_dropout)
    ]
    assert np.all(np.isfinite(errors[1])) and np.array_equal(errors[0][:600], errors[1][:600])
    assert not np.array_equal(errors[0][600:800], errors[1][600:800])
    assert np.sqrt(np.mean(errors[1][missing] ** 2)) < 4.0 and np.sqrt(np.mean(errors[1][900:] ** 2)) < 1.0


@pytest.mark.slow
def test_a_temperature_limiter_by_an_ensemble_in_a_rollout():
    """The wire cools more slowly than the filter's plant, and a thermocouple lags; derivatives are those of differences."""
    kalman_filter = filter_of("voltage", "temperature", members=8)
    system = kalman_filter.system.with_parameters({"heat.h0": 0.8 * kalman_filter.system.plant.heat.h0})
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(200))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(200, 8e-3)), draws=draws)
    noisy = {n: SensorModel(jnp.asarray(NOISE[n]), jnp.zeros(())) for n in ("voltage", "temperature")}
    instruments = Instruments(noisy, PERIOD, jnp.asarray(LAG))

    def temperatures(kp):
        controller = pid(kp, 10.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD)
        loop = dataclasses.replace(
            loop_of(controller, "displacement", limiter=limiter, upper=0.5),
            estimator=kalman_filter,
            instruments=instruments,
        )
        return rollout(system, loop, scenario).channels["temperature"]

    # By jacfwd, which compiles to other operations than a plain jvp; where all members are equal, deviations have slope 0.
    run = jax.jit(lambda kp: (temperatures(kp), jax.jacfwd(temperatures)(kp)))
    (limited, slope), ends = run(jnp.asarray(60.0)), [run(jnp.asarray(60.0 + h))[0] for h in (-1e-4, 1e-4)]
    assert 80.0 < float(jnp.max(limited)) < 88.0 and float(limited[-1]) == pytest.approx(84.0, abs=1.5)
    central = np.asarray(ends[1] - ends[0]) / 2e-4
    np.testing.assert_allclose(slope[:60], central[:60], atol=1e-3 * np.max(np.abs(central[:60])))
    assert np.max(np.abs(central[:60])) > 1e-3
