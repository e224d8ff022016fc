"""The ensemble Kalman filter on exact wires that differ from its own plant."""

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


def filter_of(*channels: str, unknown=(25.0, 4.0), members=32) -> EnsembleKalmanFilter:
    """Its plant is the rig file's; what is not among ``channels`` is not measured."""
    noise = {n: jnp.asarray(s if n in channels else np.inf) for n, s in NOISE.items()}
    spread = {"heat.h0": jnp.asarray(unknown[0]), "environment.ambient": jnp.asarray(unknown[1])}
    return EnsembleKalmanFilter(
        SampledPlant.of(read_rig(RIG).plant, PERIOD), noise, spread, jnp.asarray(LAG), members=members
    )


@eqx.filter_jit
def followed(one: EnsembleKalmanFilter, current, measured):
    """Estimates at the rows after the first, and the ensemble at the end."""

    def step(ensemble, row):
        ensemble = one.step(one.apply_command(ensemble, row[0][None]), row[1])
        return ensemble, one.estimate(ensemble)

    return jax.lax.scan(step, one.reset(), (current, measured))


def bench(convection: float, ambient: float, seed: int):
    """A minute of the exact wire in other air than the filter's, with partial loops, pauses and saturation: inputs, measurements, truth."""
    truth = read_reference(RIG).changed(h0=convection, h2=convection, austenite_shift=0.5)
    truth = dataclasses.replace(truth, wire=truth.wire._replace(ambient=ambient))
    rng = np.random.default_rng(seed)
    levels = rng.uniform(0.15, 0.36, 41) * np.sqrt(convection)
    levels[::4] = 0.03
    current = np.repeat(levels, ROWS // 40)[: ROWS + 1]
    run = simulate(truth, {"time": np.arange(ROWS + 1) * PERIOD, "current": current})
    warm = run.temperature[:, 0]
    probe = np.full(ROWS + 1, warm[0])
    for k in range(ROWS):
        probe[k + 1] = probe[k] + (1.0 - np.exp(-PERIOD / LAG)) * (warm[k + 1] - probe[k])
    exact = {
        "voltage": run.resistance[1:, 0] * current[:-1],
        "temperature": probe[1:],
        "displacement": run.position[1:],
    }
    measured = {n: jnp.asarray(v + NOISE[n] * rng.standard_normal(ROWS)) for n, v in exact.items()}
    return jnp.asarray(current[:-1]), measured, warm[1:], (run.detwinned + run.twinned)[1:, 0]


def rms(error) -> float:
    return float(np.sqrt(np.mean(np.asarray(error)[SETTLED:] ** 2)))


def covered(error, spread) -> float:
    return float(np.mean(np.abs(np.asarray(error)[SETTLED:]) < 1.96 * np.asarray(spread)[SETTLED:]))


BENCHES = ((1.2, 24.0, 3), (0.8, 16.0, 4), (1.2, 18.0, 5), (0.85, 25.0, 6))


def test_a_hidden_temperature_is_found_and_the_spread_is_honest():
    """Convection 15 to 20 % and the ambient 2 to 5 K off, transformation temperatures half a kelvin."""
    errors, shares = {}, {}
    for convection, ambient, seed in BENCHES:
        current, measured, warm, martensite = bench(convection, ambient, seed)
        for channels in ((), ("voltage",), ("temperature",), ("voltage", "temperature")):
            _, found = followed(
                filter_of(*channels, unknown=(25.0, 4.0) if channels else (1e-9, 1e-9)), current, measured
            )
            error = np.asarray(found.mean["temperature"]) - warm
            errors[seed, channels], shares[seed, channels] = (
                rms(error),
                covered(error, found.standard_deviation["temperature"]),
            )
            if "voltage" in channels:
                assert rms(found.martensite[:, 0] - martensite) < 0.01
        assert rms(np.asarray(measured["temperature"]) - warm) > 10.0  # what the thermocouple says by itself
        model = errors[seed, ()]  # what the plant says by itself
        assert model > 8.0 and errors[seed, ("voltage",)] < 0.5 * model
        assert errors[seed, ("temperature",)] < 1.0 and errors[seed, ("voltage", "temperature")] < 1.0
    assert np.mean([errors[seed, ("voltage",)] / errors[seed, ()] for *_, seed in BENCHES]) < 0.4
    for channels in (("voltage",), ("temperature",), ("voltage", "temperature")):
        told = [shares[seed, channels] for *_, seed in BENCHES]
        assert min(told) >= 0.85 and np.mean(told) <= 0.99, (channels, told)


def test_it_learns_what_it_was_not_told():
    """From a wire in other air: the convection and the ambient themselves, and a displacement finer than its sensor."""
    current, measured, _, _ = bench(1.2, 24.0, 3)
    one = filter_of("voltage", "temperature", "displacement")
    end, found = followed(one, current, measured)
    assert float(one.estimated_channel(end, "displacement")) == pytest.approx(
        float(found.mean["displacement"][-1]), rel=1e-12
    )
    ambient, convection = np.mean(np.asarray(end.parameters), axis=0)
    assert ambient == pytest.approx(24.0, abs=3.0) and convection == pytest.approx(120.7, rel=0.12)
    assert bool(jnp.all((found.martensite >= 0.0) & (found.martensite <= 1.0)))


def test_a_measurement_that_falls_out_is_none():
    """A thermocouple that tells nothing for ten seconds leaves what the voltage tells; then it helps again."""
    current, measured, warm, _ = bench(1.2, 24.0, 3)
    rows = np.arange(ROWS)
    away = (rows >= 600) & (rows < 800)
    holed = measured | {"temperature": jnp.where(away, jnp.nan, measured["temperature"])}
    errors = [
        np.asarray(followed(filter_of("voltage", "temperature"), current, m)[1].mean["temperature"]) - warm
        for m in (measured, holed)
    ]
    assert np.all(np.isfinite(errors[1])) and np.array_equal(errors[0][:600], errors[1][:600])
    assert not np.array_equal(errors[0][600:800], errors[1][600:800])
    assert np.sqrt(np.mean(errors[1][away] ** 2)) < 4.0 and np.sqrt(np.mean(errors[1][900:] ** 2)) < 1.0


def test_a_temperature_limiter_by_an_ensemble_in_a_rollout():
    """The wire cools worse than the filter's plant says; a thermocouple with its lag would be late. The derivative is that of differences."""
    one = filter_of("voltage", "temperature", members=8)
    driven = one.system.with_parameters({"heat.h0": 0.8 * one.system.plant.heat.h0})
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(200))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(200, 8e-3)), draws=draws)
    noisy = {n: SensorModel(jnp.asarray(NOISE[n]), jnp.zeros(())) for n in ("voltage", "temperature")}
    instruments = Instruments(noisy, PERIOD, jnp.asarray(LAG))

    def warm(kp):
        controller = pid(kp, 10.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD)
        loop = dataclasses.replace(
            loop_of(controller, "displacement", limiter=limiter, upper=0.5), estimator=one, instruments=instruments
        )
        return rollout(driven, loop, scenario).channels["temperature"]

    # By jacfwd, which compiles to other operations than a plain jvp: of what members agree on, deviations have the derivative 0.
    run = jax.jit(lambda kp: (warm(kp), jax.jacfwd(warm)(kp)))
    (found, slope), ends = run(jnp.asarray(60.0)), [run(jnp.asarray(60.0 + h))[0] for h in (-1e-4, 1e-4)]
    assert 80.0 < float(jnp.max(found)) < 88.0 and float(found[-1]) == pytest.approx(84.0, abs=1.5)
    central = np.asarray(ends[1] - ends[0]) / 2e-4
    np.testing.assert_allclose(slope[:60], central[:60], atol=1e-3 * np.max(np.abs(central[:60])))
    assert np.max(np.abs(central[:60])) > 1e-3
