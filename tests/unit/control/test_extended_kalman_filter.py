"""Extended Kalman filter against the linear one, against finite differences, and on wires that differ from its plant."""

import dataclasses

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest
import scipy.linalg

from smajax.control.estimators.extended_kalman_filter import ExtendedKalmanFilter
from smajax.control.loop.rollout import Scenario, rollout
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampled_plant import SampledPlant, SampledTransferFunction
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import SensorModel
from smajax.files.rig_file import read_rig
from smajax.laws.transfer_function import TransferFunction
from tests.conftest import ROOT
from tests.unit.control.test_control import loop_of, pid

RECORDINGS = ROOT / "data" / "recordings"
PERIOD = 0.05
AIR = {"heat.h0": 25.0, "environment.ambient": 4.0}


def instruments_of(lag=0.0, **sensors) -> Instruments:
    """Instruments, each by its noise, quantum and delay in samples."""
    return Instruments(
        {n: SensorModel(*map(jnp.asarray, numbers[:2]), *numbers[2:]) for n, numbers in sensors.items()},
        PERIOD,
        jnp.asarray(lag),
    )


def plant_of(kind: str) -> SampledPlant:
    return SampledPlant.of(read_rig(RECORDINGS / kind / "rig.toml").plant, PERIOD)


@eqx.filter_jit
def run_filter(kalman_filter: ExtendedKalmanFilter, commands, measured):
    """States and estimates at the samples after the first, under commands of shape (n, wires)."""

    def step(state, row):
        state = kalman_filter.step(kalman_filter.apply_command(state, row[0]), row[1])
        return state, (state, kalman_filter.estimate(state))

    return jax.lax.scan(step, kalman_filter.reset(), (commands, measured))[1]


def levels(rng, low: float, high: float, count: int, hold: int) -> np.ndarray:
    """Commands held for ``hold`` samples each, a pause in every fourth, shape (count, 1)."""
    values = rng.uniform(low, high, -(-count // hold))
    values[::4] = 0.1 * low
    return np.repeat(values, hold)[:count, None]


@pytest.mark.parametrize("delay", [0, 2])
def test_on_a_linear_plant_it_is_the_exact_kalman_filter(delay):
    """Against a filter in numpy, with stacked states for a delayed measurement, and with dropouts of the measurement."""
    numbers, count = (1.5, 0.2, 0.4, 0.7, 0.3, 2 * PERIOD, 0.0), 80
    system = SampledTransferFunction.of(
        TransferFunction(*map(jnp.asarray, numbers), structure="underdamped-and-pole"), "angle", PERIOD
    )
    noise, quantum, initial_deviation, process_noise = (
        0.02,
        0.01,
        np.array([0.3, 0.5, 0.1]),
        np.array([0.05, 0.2, 0.02]),
    )
    zeros = jax.tree.map(jnp.zeros_like, system.start()[1:])
    kalman_filter = ExtendedKalmanFilter(
        system,
        instruments_of(angle=(noise, quantum, delay)),
        {},
        (jnp.asarray(initial_deviation), *zeros),
        (jnp.asarray(process_noise), *zeros),
        huber_threshold=1e9,
    )
    rng = np.random.default_rng(1)
    commands, angles = rng.standard_normal(count), 0.5 * rng.standard_normal(count)
    angles[30:35] = np.nan
    states, estimates = run_filter(kalman_filter, jnp.asarray(commands)[:, None], {"angle": jnp.asarray(angles)})

    tau, damping, rest = 0.4, 0.3, 0.7
    rates = np.array([[0.0, 1.0, 0.0], [-(tau**-2), -2.0 * damping / tau, tau**-2], [0.0, 0.0, -1.0 / rest]])
    discrete = scipy.linalg.expm(
        np.block([[rates, np.array([[0.0], [0.0], [1.0 / rest]])], [np.zeros((1, 4))]]) * PERIOD
    )
    size = 3 * (delay + 1)
    transition = np.zeros((size, size))
    transition[:3, :3], transition[3:, :-3] = discrete[:3, :3], np.eye(size - 3)
    mean, covariance = np.zeros(size), np.tile(np.diag(initial_deviation**2), (delay + 1, delay + 1))
    row = np.zeros(size)
    row[size - 3] = 1.5
    for k in range(count):
        mean, covariance = transition @ mean, transition @ covariance @ transition.T
        covariance[:3, :3] += PERIOD * discrete[:3, :3] @ np.diag(process_noise**2) @ discrete[:3, :3].T
        mean[:3] += discrete[:3, 3] * (commands[k - 2] if k > 1 else 0.0)
        if np.isfinite(angles[k]):
            gain = covariance @ row / (row @ covariance @ row + noise**2 + quantum**2 / 12.0)
            mean = mean + gain * (angles[k] - 0.2 - row @ mean)
            covariance = covariance - np.outer(gain, row @ covariance)
        np.testing.assert_allclose(states.state[0][k], mean[:3], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(states.covariance[k][:3, :3], covariance[:3, :3], rtol=0.0, atol=1e-9)
        assert float(estimates.mean["angle"][k]) == pytest.approx(0.2 + 1.5 * mean[0], abs=1e-9)
        assert float(estimates.standard_deviation["angle"][k]) == pytest.approx(
            1.5 * np.sqrt(covariance[0, 0]), abs=1e-9
        )


@pytest.mark.slow
@pytest.mark.parametrize("kind, command", [("dead-weight", [0.3]), ("bias-spring", [3.7]), ("rotary", [0.4, 0.1])])
def test_its_jacobian_is_that_of_differences(kind, command):
    """While wires transform forwards and backwards, for all estimated numbers and three mechanisms."""
    kalman_filter = ExtendedKalmanFilter.of(
        plant_of(kind), instruments_of(0.3, voltage=(1e-3, 0.0), current=(1e-3, 0.0, 1), temperature=(0.5, 0.0)), AIR
    )
    period = eqx.filter_jit(lambda state: kalman_filter.linearise(state))

    def until(state, command, condition):
        state = kalman_filter.apply_command(state, jnp.asarray(command))
        for _ in range(600):
            state = period(state)[1]
            if condition(float(state.state[0].fractions.martensite[0])):
                return state
        raise AssertionError("the fraction is never reached")

    def check(state):
        slope, _ = period(state)
        core, split = kalman_filter._core(state)

        def numbers_after(core):
            plant_state, thermocouples, values = split(core)
            later = period(state._replace(state=plant_state, thermocouples=thermocouples, parameters=values))[1]
            return np.concatenate([kalman_filter._core(later)[0], later.readings[0]])

        for i, value in enumerate(core):
            h = 1e-6 * max(1.0, abs(float(value)))
            central = (numbers_after(core.at[i].add(h)) - numbers_after(core.at[i].add(-h))) / (2.0 * h)
            close = 1e-6 * max(1.0, np.max(np.abs(central)))
            np.testing.assert_allclose(slope[: len(central), i], central, rtol=2e-4, atol=close, err_msg=str(i))

    hot = until(kalman_filter.reset(), command, lambda share: share < 0.6)
    check(hot)
    cold = [0.0 for _ in command]
    # Warm for long enough that the other wire is still hot when the first one has begun to cool.
    back = until(until(hot, command, lambda share: share < 0.3), cold, lambda share: share > 0.45)
    check(kalman_filter.apply_command(back, jnp.asarray(cold)))


def benches(instruments: Instruments, commands, starts):
    """Measurements and temperatures of wires in random surroundings, warmer at the start by ``starts`` K: batches."""
    system = plant_of("bias-spring")
    heat, nominal_ambient = system.plant.heat.h0, system.plant.environment.ambient

    def single(h0, ambient, excess, draws):
        surroundings = nominal_ambient + ambient
        truth = system.with_parameters(
            {"heat.h0": heat + h0, "environment.ambient": surroundings, "initial.temperature": surroundings + excess}
        )
        state = truth.start()

        def sample(carry, row):
            state, instrument_state = carry
            command, draw = row
            state = truth.step(state, command)[0]
            instrument_state, measured = instruments.step(instrument_state, truth.observe(state, command), draw)
            return (state, instrument_state), ({n: measured[n] for n in instruments.sensors}, state[0].temperature[0])

        return jax.lax.scan(sample, (state, instruments.reset(truth.observe(state, jnp.zeros(1)))), (commands, draws))[
            1
        ]

    rng = np.random.default_rng(7)
    errors = rng.standard_normal((2, len(starts))) * np.array([[AIR["heat.h0"]], [AIR["environment.ambient"]]])
    draws = rng.standard_normal((len(starts), len(commands)))
    measured, temperature = eqx.filter_jit(jax.vmap(single))(
        *map(jnp.asarray, errors), jnp.asarray(starts), jnp.asarray(draws)
    )
    return measured, np.asarray(temperature)


@pytest.mark.slow
def test_temperature_from_current_voltage_and_position():
    """With noisy, quantised and delayed instruments the error is below that of the plant, and the intervals are right."""
    instruments = instruments_of(current=(2e-3, 1e-3, 1), voltage=(10e-3, 5e-3, 1), displacement=(2e-5, 1e-5, 2))
    rng = np.random.default_rng(3)
    commands, starts = jnp.asarray(levels(rng, 2.5, 4.2, 800, 40)), 6.0 * rng.standard_normal(40)
    measured, temperature = benches(instruments, commands, starts)
    kalman_filter = ExtendedKalmanFilter.of(
        plant_of("bias-spring"), instruments, AIR, initial_temperature_deviation=6.0
    )
    batch = eqx.filter_jit(
        lambda kalman_filter, m: eqx.filter_vmap(lambda m: run_filter(kalman_filter, commands, m))(m)
    )

    def evaluate(kalman_filter, measured):
        states, estimates = batch(kalman_filter, measured)
        return (
            states,
            np.asarray(estimates.mean["temperature"]) - temperature,
            np.asarray(estimates.standard_deviation["temperature"]),
        )

    states, error, deviation = evaluate(kalman_filter, measured)
    _, plant_error, plant_deviation = evaluate(
        kalman_filter, jax.tree.map(lambda v: jnp.full_like(v, jnp.nan), measured)
    )
    rms = [np.sqrt(np.mean(e**2, axis=1)) for e in (error, plant_error)]
    assert np.sqrt(np.mean(rms[0] ** 2)) < 0.5 * np.sqrt(np.mean(rms[1] ** 2)) and np.median(rms[0] / rms[1]) < 0.4
    assert np.median(np.abs(error)) < 0.5 and np.median(np.abs(plant_error)) > 4.0
    # The error agrees with its deviation, also for the plant alone, whose deviation is that of surroundings and start.
    assert 0.92 < np.mean(np.abs(error) < 1.96 * deviation) < 0.99 and 0.5 < np.mean((error / deviation) ** 2) < 2.0
    assert 0.90 < np.mean(np.abs(plant_error) < 1.96 * plant_deviation) < 0.99 and np.mean(deviation) < 0.5 * np.mean(
        plant_deviation
    )
    covariance = np.asarray(states.covariance)
    assert np.array_equal(covariance, np.swapaxes(covariance, -1, -2))
    sizes = np.sqrt(np.einsum("...ii->...i", covariance)) + 1e-12
    assert np.min(np.linalg.eigvalsh(covariance / sizes[..., None] / sizes[..., None, :])) > -1e-9
    # Without process noise of the fraction the filter is overconfident.
    without_walk = eqx.tree_at(
        lambda kalman_filter: kalman_filter.process_noise[0].fractions.detwinned, kalman_filter, jnp.zeros(1)
    )
    _, diverged_error, diverged_deviation = evaluate(without_walk, measured)
    assert (
        np.sqrt(np.mean(diverged_error**2)) > 2.0 * np.sqrt(np.mean(error**2))
        and np.mean(np.abs(diverged_error) < 1.96 * diverged_deviation) < 0.85
    )


@pytest.mark.slow
def test_a_measurement_that_drops_out_is_skipped():
    """Without one instrument it is a filter without that instrument; without all it is the prediction alone."""
    system = plant_of("dead-weight")
    kalman_filter = ExtendedKalmanFilter.of(system, instruments_of(voltage=(2e-3, 0.0), displacement=(2e-5, 0.0)), AIR)
    alone = ExtendedKalmanFilter.of(system, instruments_of(voltage=(2e-3, 0.0)), AIR)
    commands = jnp.asarray(levels(np.random.default_rng(0), 0.15, 0.36, 80, 20))
    voltage, missing = 14.0 * commands[:, 0] + 0.01 * jnp.sin(jnp.arange(80.0)), jnp.full(80, jnp.nan)
    _, estimates = run_filter(kalman_filter, commands, {"voltage": voltage, "displacement": missing})
    _, expected = run_filter(alone, commands, {"voltage": voltage})
    for name in ("temperature", "displacement"):
        np.testing.assert_allclose(estimates.mean[name], expected.mean[name], rtol=1e-9)
        np.testing.assert_allclose(
            estimates.standard_deviation[name], expected.standard_deviation[name], rtol=1e-7, atol=1e-12
        )
    _, corrected = run_filter(kalman_filter, commands, {"voltage": voltage, "displacement": missing.at[50].set(4e-3)})
    np.testing.assert_array_equal(corrected.mean["temperature"][:50], estimates.mean["temperature"][:50])
    assert np.all(np.abs(corrected.mean["temperature"][50:60] - estimates.mean["temperature"][50:60]) > 1e-3)
    unmeasured, _ = run_filter(kalman_filter, commands, {"voltage": missing, "displacement": missing})
    state, _ = jax.lax.scan(
        eqx.filter_jit(lambda state, command: (system.step(state, command)[0],) * 2), system.start(), commands
    )
    for alone, carried in zip(jax.tree.leaves(state), jax.tree.leaves(unmeasured.state), strict=True):
        np.testing.assert_allclose(carried[-1], alone, rtol=1e-12, atol=1e-15)  # the trajectory of the plant
    # After measurements, a period without any is a prediction from the corrected state.
    states, _ = run_filter(kalman_filter, commands, {"voltage": voltage.at[45:].set(jnp.nan), "displacement": missing})
    before, after = (jax.tree.map(lambda v, k=k: np.asarray(v[k]), states) for k in (44, 45))
    nominal = kalman_filter.reset().parameters
    np.testing.assert_allclose(
        after.parameters,
        nominal + np.exp(-PERIOD / float(kalman_filter.correlation_time)) * (before.parameters - nominal),
        rtol=1e-12,
    )
    assert np.all(np.abs(before.parameters - nominal) > 1e-3)
    later_system = system.with_parameters(dict(zip(sorted(AIR), jnp.asarray(after.parameters), strict=True)))
    expected = eqx.filter_jit(
        lambda: (state := later_system.step(before.state, commands[45])[0], later_system.observe(state, commands[45]))
    )()
    for alone, carried in zip(jax.tree.leaves(expected[0]), jax.tree.leaves(after.state), strict=True):
        np.testing.assert_allclose(carried, alone, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(after.readings[0], [expected[1][n] for n in ("displacement", "voltage")], rtol=1e-12)
    np.testing.assert_array_equal(
        unmeasured.parameters, np.broadcast_to(kalman_filter.reset().parameters, unmeasured.parameters.shape)
    )


@pytest.mark.slow
def test_it_estimates_the_convection_and_the_ambient_temperature():
    """With a lagging thermocouple, within the deviations of the filter."""
    system, lag = plant_of("dead-weight"), 0.6
    instruments = instruments_of(lag, temperature=(0.5, 0.25, 1), voltage=(2e-3, 0.0))
    truth = system.with_parameters({"heat.h0": system.plant.heat.h0 + 20.0, "environment.ambient": jnp.asarray(24.0)})
    commands = jnp.asarray(levels(np.random.default_rng(2), 0.15, 0.36, 1200, 30))

    def sample(carry, row):
        state, instrument_state = carry
        state = truth.step(state, row[0])[0]
        instrument_state, measured = instruments.step(instrument_state, truth.observe(state, row[0]), row[1])
        return (state, instrument_state), {n: measured[n] for n in instruments.sensors}

    start = truth.start()
    draws = jnp.asarray(np.random.default_rng(4).standard_normal(1200))
    first = start, instruments.reset(truth.observe(start, jnp.zeros(1)))
    _, measured = eqx.filter_jit(lambda: jax.lax.scan(sample, first, (commands, draws)))()
    states, _ = run_filter(ExtendedKalmanFilter.of(system, instruments, AIR), commands, measured)
    estimate = np.asarray(states.parameters[-1]), np.asarray(states.covariance[-1])
    deviations = np.sqrt(np.diag(estimate[1]))[6:8]  # after temperature, fractions, stress, motion and thermocouple
    np.testing.assert_array_less(np.abs(estimate[0] - [24.0, float(system.plant.heat.h0) + 20.0]), 2.5 * deviations)
    assert deviations[0] < 3.0 and deviations[1] < 12.0 and abs(estimate[0][1] - float(system.plant.heat.h0)) > 10.0


@pytest.mark.slow
def test_a_controller_by_the_filter_in_a_rollout():
    """In other surroundings the loop is nearly as good as with an exact encoder, and better than with a delayed one."""
    instruments = instruments_of(voltage=(2e-3, 0.0), displacement=(1e-4, 0.0, 2))
    kalman_filter = ExtendedKalmanFilter.of(plant_of("dead-weight"), instruments, AIR)
    system = kalman_filter.system.with_parameters(
        {"heat.h0": 0.85 * kalman_filter.system.plant.heat.h0, "environment.ambient": jnp.asarray(23.0)}
    )
    reference = np.repeat([4e-3, 2e-3], 200)
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(400))
    scenario = dataclasses.replace(Scenario.noiseless(reference), draws=draws)
    loop = loop_of(pid(60.0, 100.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD), "displacement", upper=0.5)

    def error(sensor, **options):
        result = eqx.filter_jit(rollout)(system, dataclasses.replace(loop, sensor=sensor, **options), scenario)
        return float(np.sqrt(np.mean((np.asarray(result.channels["displacement"]) - reference) ** 2)))

    exact, delayed = (
        error(SensorModel(jnp.asarray(noise), jnp.zeros(()), wait)) for noise, wait in ((0.0, 0), (1e-4, 2))
    )
    filtered = error(
        SensorModel(jnp.asarray(1e9), jnp.zeros(())),
        estimator=kalman_filter,
        instruments=instruments,
        use_estimate=True,
    )  # the filter is used instead of this sensor
    assert filtered < 1.2 * exact < 0.5 * delayed
    with pytest.raises(ValueError, match="needs a filter of the whole plant"):
        dataclasses.replace(loop, use_estimate=True)
    with pytest.raises(ValueError, match="leave allow_dropouts out"):
        dataclasses.replace(
            loop, estimator=kalman_filter, instruments=instruments, use_estimate=True, allow_dropouts=True
        )


@pytest.mark.slow
def test_a_temperature_limiter_by_the_filter_in_a_rollout():
    """The wire cools more slowly than the filter's plant, and a thermocouple lags; derivatives are those of differences."""
    instruments = instruments_of(0.6, voltage=(2e-3, 1e-3, 1), temperature=(0.5, 0.0))
    kalman_filter = ExtendedKalmanFilter.of(plant_of("dead-weight"), instruments, AIR)
    system = kalman_filter.system.with_parameters({"heat.h0": 0.8 * kalman_filter.system.plant.heat.h0})
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(200))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(200, 8e-3)), draws=draws)
    loop = loop_of(
        pid(60.0, 10.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD), "displacement", limiter=limiter, upper=0.5
    )

    def temperatures(kp, process_noise, observer, instruments):
        if observer is not None:
            observer = eqx.tree_at(
                lambda o: (o.instruments, o.process_noise[0].temperature), observer, (instruments, process_noise[None])
            )
        filtered = dataclasses.replace(
            loop, estimator=observer, instruments=instruments, use_estimate=observer is not None
        )
        loop_with_gain = eqx.tree_at(lambda loop: loop.controller.kp, filtered, kp)
        return rollout(system, loop_with_gain, scenario).channels["temperature"]

    point, direction = (jnp.asarray(60.0), jnp.asarray(2.0)), (jnp.asarray(1.0), jnp.asarray(0.1))
    derivative = eqx.filter_jit(
        lambda kp, process_noise, instruments: jax.jvp(
            lambda k, d: temperatures(k, d, kalman_filter, instruments), (kp, process_noise), direction
        )
    )
    limited, lagging = (
        np.asarray(derivative(*point, instruments)[0]),
        np.asarray(eqx.filter_jit(temperatures)(*point, None, instruments)),
    )
    assert (
        80.0 < limited.max() < 87.0
        and limited[-1] == pytest.approx(84.0, abs=1.5)
        and lagging.max() > limited.max() + 3.0
    )
    fine = eqx.tree_at(lambda m: m.sensors["voltage"].quantum, instruments, jnp.asarray(0.0))
    ends = [
        derivative(*(v + s * 1e-4 * w for v, w in zip(point, direction, strict=True)), fine)[0][:60] for s in (1, -1)
    ]
    central = np.asarray(ends[0] - ends[1]) / 2e-4
    np.testing.assert_allclose(derivative(*point, fine)[1][:60], central, atol=1e-3 * np.max(np.abs(central)))
    assert np.max(np.abs(central)) > 1e-3
