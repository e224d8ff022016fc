"""The extended Kalman filter against the exact one, against finite differences, and on wires that differ from its own plant."""

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


def meters_of(lag=0.0, **each) -> Instruments:
    """Each meter by its noise, quantum and delay in samples."""
    return Instruments(
        {n: SensorModel(*map(jnp.asarray, m[:2]), *m[2:]) for n, m in each.items()}, PERIOD, jnp.asarray(lag)
    )


def plant_of(kind: str) -> SampledPlant:
    return SampledPlant.of(read_rig(RECORDINGS / kind / "rig.toml").plant, PERIOD)


@eqx.filter_jit
def followed(one: ExtendedKalmanFilter, commands, measured):
    """The beliefs and estimates at the samples after the first, under commands of shape (n, wires)."""

    def step(belief, row):
        belief = one.step(one.apply_command(belief, row[0]), row[1])
        return belief, (belief, one.estimate(belief))

    return jax.lax.scan(step, one.reset(), (commands, measured))[1]


def levels(rng, low: float, high: float, count: int, hold: int) -> np.ndarray:
    """Commands held for ``hold`` samples each, a pause in every fourth, shape (count, 1)."""
    drawn = rng.uniform(low, high, -(-count // hold))
    drawn[::4] = 0.1 * low
    return np.repeat(drawn, hold)[:count, None]


@pytest.mark.parametrize("late", [0, 2])
def test_on_a_linear_plant_it_is_the_exact_kalman_filter(late):
    """Written again in numpy, with the states of the last samples stacked for a measurement that is late, and one that falls out."""
    numbers, count = (1.5, 0.2, 0.4, 0.7, 0.3, 2 * PERIOD, 0.0), 80
    driven = SampledTransferFunction.of(
        TransferFunction(*map(jnp.asarray, numbers), structure="underdamped-and-pole"), "angle", PERIOD
    )
    noise, quantum, spread, walk = 0.02, 0.01, np.array([0.3, 0.5, 0.1]), np.array([0.05, 0.2, 0.02])
    still = jax.tree.map(jnp.zeros_like, driven.start()[1:])
    one = ExtendedKalmanFilter(
        driven,
        meters_of(angle=(noise, quantum, late)),
        {},
        (jnp.asarray(spread), *still),
        (jnp.asarray(walk), *still),
        huber_threshold=1e9,
    )
    rng = np.random.default_rng(1)
    commands, angles = rng.standard_normal(count), 0.5 * rng.standard_normal(count)
    angles[30:35] = np.nan
    beliefs, told = followed(one, jnp.asarray(commands)[:, None], {"angle": jnp.asarray(angles)})

    tau, damping, rest = 0.4, 0.3, 0.7
    rates = np.array([[0.0, 1.0, 0.0], [-(tau**-2), -2.0 * damping / tau, tau**-2], [0.0, 0.0, -1.0 / rest]])
    held = scipy.linalg.expm(np.block([[rates, np.array([[0.0], [0.0], [1.0 / rest]])], [np.zeros((1, 4))]]) * PERIOD)
    size = 3 * (late + 1)
    moves = np.zeros((size, size))
    moves[:3, :3], moves[3:, :-3] = held[:3, :3], np.eye(size - 3)
    mean, covariance = np.zeros(size), np.tile(np.diag(spread**2), (late + 1, late + 1))
    row = np.zeros(size)
    row[size - 3] = 1.5
    for k in range(count):
        mean, covariance = moves @ mean, moves @ covariance @ moves.T
        covariance[:3, :3] += PERIOD * held[:3, :3] @ np.diag(walk**2) @ held[:3, :3].T
        mean[:3] += held[:3, 3] * (commands[k - 2] if k > 1 else 0.0)
        if np.isfinite(angles[k]):
            gain = covariance @ row / (row @ covariance @ row + noise**2 + quantum**2 / 12.0)
            mean = mean + gain * (angles[k] - 0.2 - row @ mean)
            covariance = covariance - np.outer(gain, row @ covariance)
        np.testing.assert_allclose(beliefs.state[0][k], mean[:3], rtol=0.0, atol=1e-9)
        np.testing.assert_allclose(beliefs.covariance[k][:3, :3], covariance[:3, :3], rtol=0.0, atol=1e-9)
        assert float(told.mean["angle"][k]) == pytest.approx(0.2 + 1.5 * mean[0], abs=1e-9)
        assert float(told.standard_deviation["angle"][k]) == pytest.approx(1.5 * np.sqrt(covariance[0, 0]), abs=1e-9)


@pytest.mark.parametrize("kind, command", [("dead-weight", [0.3]), ("bias-spring", [3.7]), ("rotary", [0.4, 0.1])])
def test_its_jacobian_is_that_of_differences(kind, command):
    """While wires transform, hot and back, hanging or against a spring or each other: by all that is estimated."""
    one = ExtendedKalmanFilter.of(
        plant_of(kind), meters_of(0.3, voltage=(1e-3, 0.0), current=(1e-3, 0.0, 1), temperature=(0.5, 0.0)), AIR
    )
    period = eqx.filter_jit(lambda belief: one.linearise(belief))

    def until(belief, command, done):
        belief = one.apply_command(belief, jnp.asarray(command))
        for _ in range(600):
            belief = period(belief)[1]
            if done(float(belief.state[0].fractions.martensite[0])):
                return belief
        raise AssertionError("it never transforms as far")

    def check(belief):
        slope, _ = period(belief)
        core, whole = one._core(belief)

        def moved(core):
            state, probes, unknown = whole(core)
            later = period(belief._replace(state=state, thermocouples=probes, parameters=unknown))[1]
            return np.concatenate([one._core(later)[0], later.readings[0]])

        for i, value in enumerate(core):
            h = 1e-6 * max(1.0, abs(float(value)))
            central = (moved(core.at[i].add(h)) - moved(core.at[i].add(-h))) / (2.0 * h)
            close = 1e-6 * max(1.0, np.max(np.abs(central)))
            np.testing.assert_allclose(slope[: len(central), i], central, rtol=2e-4, atol=close, err_msg=str(i))

    hot = until(one.reset(), command, lambda share: share < 0.6)
    check(hot)
    cold = [0.0 for _ in command]
    # Warm for long enough that the other wire is still hot when the first one has begun to cool.
    back = until(until(hot, command, lambda share: share < 0.3), cold, lambda share: share > 0.45)
    check(one.apply_command(back, jnp.asarray(cold)))


def benches(instruments: Instruments, commands, starts):
    """Exact wires in airs drawn as the filter expects them, warmer at the start by ``starts`` K, and what their instruments tell: batches."""
    driven = plant_of("bias-spring")
    heat, air = driven.plant.heat.h0, driven.plant.environment.ambient

    def single(h0, ambient, warmer, draws):
        around = air + ambient
        truth = driven.with_parameters(
            {"heat.h0": heat + h0, "environment.ambient": around, "initial.temperature": around + warmer}
        )
        state = truth.start()

        def sample(carry, row):
            state, heard = carry
            command, draw = row
            state = truth.step(state, command)[0]
            heard, told = instruments.step(heard, truth.observe(state, command), draw)
            return (state, heard), ({n: told[n] for n in instruments.sensors}, state[0].temperature[0])

        return jax.lax.scan(sample, (state, instruments.reset(truth.observe(state, jnp.zeros(1)))), (commands, draws))[
            1
        ]

    rng = np.random.default_rng(7)
    drawn = rng.standard_normal((2, len(starts))) * np.array([[AIR["heat.h0"]], [AIR["environment.ambient"]]])
    draws = rng.standard_normal((len(starts), len(commands)))
    measured, warm = eqx.filter_jit(jax.vmap(single))(*map(jnp.asarray, drawn), jnp.asarray(starts), jnp.asarray(draws))
    return measured, np.asarray(warm)


def test_temperature_from_current_voltage_and_position():
    """Noisy, coarse and late instruments on wires in other air, warmer or colder at the start: better than the plant, and as sure as it may be."""
    instruments = meters_of(current=(2e-3, 1e-3, 1), voltage=(10e-3, 5e-3, 1), displacement=(2e-5, 1e-5, 2))
    rng = np.random.default_rng(3)
    commands, starts = jnp.asarray(levels(rng, 2.5, 4.2, 800, 40)), 6.0 * rng.standard_normal(40)
    measured, warm = benches(instruments, commands, starts)
    one = ExtendedKalmanFilter.of(plant_of("bias-spring"), instruments, AIR, initial_temperature_deviation=6.0)
    batch = eqx.filter_jit(lambda one, m: eqx.filter_vmap(lambda m: followed(one, commands, m))(m))

    def judged(one, measured):
        beliefs, found = batch(one, measured)
        return (
            beliefs,
            np.asarray(found.mean["temperature"]) - warm,
            np.asarray(found.standard_deviation["temperature"]),
        )

    beliefs, error, spread = judged(one, measured)
    _, plant, unsure = judged(one, jax.tree.map(lambda v: jnp.full_like(v, jnp.nan), measured))
    both = [np.sqrt(np.mean(e**2, axis=1)) for e in (error, plant)]
    assert np.sqrt(np.mean(both[0] ** 2)) < 0.5 * np.sqrt(np.mean(both[1] ** 2)) and np.median(both[0] / both[1]) < 0.4
    assert np.median(np.abs(error)) < 0.5 and np.median(np.abs(plant)) > 4.0
    # It is as far off as it says, and so is the plant by itself, whose spread comes from the air and the start alone.
    assert 0.92 < np.mean(np.abs(error) < 1.96 * spread) < 0.99 and 0.5 < np.mean((error / spread) ** 2) < 2.0
    assert 0.90 < np.mean(np.abs(plant) < 1.96 * unsure) < 0.99 and np.mean(spread) < 0.5 * np.mean(unsure)
    whole = np.asarray(beliefs.covariance)
    assert np.array_equal(whole, np.swapaxes(whole, -1, -2))
    sizes = np.sqrt(np.einsum("...ii->...i", whole)) + 1e-12
    assert np.min(np.linalg.eigvalsh(whole / sizes[..., None] / sizes[..., None, :])) > -1e-9
    # A fraction that does not walk is taken for certain.
    certain = eqx.tree_at(lambda one: one.process_noise[0].fractions.detwinned, one, jnp.zeros(1))
    _, lost, narrow = judged(certain, measured)
    assert np.sqrt(np.mean(lost**2)) > 2.0 * np.sqrt(np.mean(error**2)) and np.mean(np.abs(lost) < 1.96 * narrow) < 0.85


def test_a_measurement_that_falls_out_is_none():
    """Without any the belief is only carried on; without one it is that of a filter that has no such meter."""
    driven = plant_of("dead-weight")
    one = ExtendedKalmanFilter.of(driven, meters_of(voltage=(2e-3, 0.0), displacement=(2e-5, 0.0)), AIR)
    alone = ExtendedKalmanFilter.of(driven, meters_of(voltage=(2e-3, 0.0)), AIR)
    commands = jnp.asarray(levels(np.random.default_rng(0), 0.15, 0.36, 80, 20))
    voltage, none = 14.0 * commands[:, 0] + 0.01 * jnp.sin(jnp.arange(80.0)), jnp.full(80, jnp.nan)
    _, found = followed(one, commands, {"voltage": voltage, "displacement": none})
    _, expected = followed(alone, commands, {"voltage": voltage})
    for name in ("temperature", "displacement"):
        np.testing.assert_allclose(found.mean[name], expected.mean[name], rtol=1e-9)
        np.testing.assert_allclose(
            found.standard_deviation[name], expected.standard_deviation[name], rtol=1e-7, atol=1e-12
        )
    _, moved = followed(one, commands, {"voltage": voltage, "displacement": none.at[50].set(4e-3)})
    np.testing.assert_array_equal(moved.mean["temperature"][:50], found.mean["temperature"][:50])
    assert np.all(np.abs(moved.mean["temperature"][50:60] - found.mean["temperature"][50:60]) > 1e-3)
    silent, _ = followed(one, commands, {"voltage": none, "displacement": none})
    state, _ = jax.lax.scan(
        eqx.filter_jit(lambda state, command: (driven.step(state, command)[0],) * 2), driven.start(), commands
    )
    for alone, carried in zip(jax.tree.leaves(state), jax.tree.leaves(silent.state), strict=True):
        np.testing.assert_allclose(carried[-1], alone, rtol=1e-12, atol=1e-15)  # the plant's own way, and nothing else
    # Nor does silence do anything else to what has been heard before: a period on from there.
    heard, _ = followed(one, commands, {"voltage": voltage.at[45:].set(jnp.nan), "displacement": none})
    before, after = (jax.tree.map(lambda v, k=k: np.asarray(v[k]), heard) for k in (44, 45))
    middle = one.reset().parameters
    np.testing.assert_allclose(
        after.parameters,
        middle + np.exp(-PERIOD / float(one.correlation_time)) * (before.parameters - middle),
        rtol=1e-12,
    )
    assert np.all(np.abs(before.parameters - middle) > 1e-3)
    known = driven.with_parameters(dict(zip(sorted(AIR), jnp.asarray(after.parameters), strict=True)))
    expected = eqx.filter_jit(
        lambda: (state := known.step(before.state, commands[45])[0], known.observe(state, commands[45]))
    )()
    for alone, carried in zip(jax.tree.leaves(expected[0]), jax.tree.leaves(after.state), strict=True):
        np.testing.assert_allclose(carried, alone, rtol=1e-12, atol=1e-15)
    np.testing.assert_allclose(after.readings[0], [expected[1][n] for n in ("displacement", "voltage")], rtol=1e-12)
    np.testing.assert_array_equal(silent.parameters, np.broadcast_to(one.reset().parameters, silent.parameters.shape))


def test_it_learns_what_it_was_not_told():
    """The convection and the ambient of another air, by a thermocouple with a lag, to within what it says of them."""
    driven, lag = plant_of("dead-weight"), 0.6
    instruments = meters_of(lag, temperature=(0.5, 0.25, 1), voltage=(2e-3, 0.0))
    truth = driven.with_parameters({"heat.h0": driven.plant.heat.h0 + 20.0, "environment.ambient": jnp.asarray(24.0)})
    commands = jnp.asarray(levels(np.random.default_rng(2), 0.15, 0.36, 1200, 30))

    def sample(carry, row):
        state, heard = carry
        state = truth.step(state, row[0])[0]
        heard, told = instruments.step(heard, truth.observe(state, row[0]), row[1])
        return (state, heard), {n: told[n] for n in instruments.sensors}

    start = truth.start()
    draws = jnp.asarray(np.random.default_rng(4).standard_normal(1200))
    first = start, instruments.reset(truth.observe(start, jnp.zeros(1)))
    _, measured = eqx.filter_jit(lambda: jax.lax.scan(sample, first, (commands, draws)))()
    beliefs, _ = followed(ExtendedKalmanFilter.of(driven, instruments, AIR), commands, measured)
    known = np.asarray(beliefs.parameters[-1]), np.asarray(beliefs.covariance[-1])
    sure = np.sqrt(np.diag(known[1]))[6:8]  # after temperature, fractions, stress, motion and thermocouple
    np.testing.assert_array_less(np.abs(known[0] - [24.0, float(driven.plant.heat.h0) + 20.0]), 2.5 * sure)
    assert sure[0] < 3.0 and sure[1] < 12.0 and abs(known[0][1] - float(driven.plant.heat.h0)) > 10.0


def test_a_controller_by_the_filter_in_a_rollout():
    """In air that its plant does not know: nearly as good as an encoder without fault, which a late and coarse one is not, nor wanted."""
    instruments = meters_of(voltage=(2e-3, 0.0), displacement=(1e-4, 0.0, 2))
    one = ExtendedKalmanFilter.of(plant_of("dead-weight"), instruments, AIR)
    driven = one.system.with_parameters(
        {"heat.h0": 0.85 * one.system.plant.heat.h0, "environment.ambient": jnp.asarray(23.0)}
    )
    reference = np.repeat([4e-3, 2e-3], 200)
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(400))
    scenario = dataclasses.replace(Scenario.noiseless(reference), draws=draws)
    loop = loop_of(pid(60.0, 100.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD), "displacement", upper=0.5)

    def error(sensor, **options):
        done = eqx.filter_jit(rollout)(driven, dataclasses.replace(loop, sensor=sensor, **options), scenario)
        return float(np.sqrt(np.mean((np.asarray(done.channels["displacement"]) - reference) ** 2)))

    exact, late = (error(SensorModel(jnp.asarray(noise), jnp.zeros(()), wait)) for noise, wait in ((0.0, 0), (1e-4, 2)))
    believed = error(
        SensorModel(jnp.asarray(1e9), jnp.zeros(())), estimator=one, instruments=instruments, use_estimate=True
    )  # what it does not go by
    assert believed < 1.2 * exact < 0.5 * late
    with pytest.raises(ValueError, match="needs a filter of the whole plant"):
        dataclasses.replace(loop, use_estimate=True)
    with pytest.raises(ValueError, match="leave allow_dropouts out"):
        dataclasses.replace(loop, estimator=one, instruments=instruments, use_estimate=True, allow_dropouts=True)


def test_a_temperature_limiter_by_the_filter_in_a_rollout():
    """And a controller by it. The wire cools worse than the filter's plant says; a thermocouple with its lag would be late. The derivatives are those of differences."""
    instruments = meters_of(0.6, voltage=(2e-3, 1e-3, 1), temperature=(0.5, 0.0))
    one = ExtendedKalmanFilter.of(plant_of("dead-weight"), instruments, AIR)
    driven = one.system.with_parameters({"heat.h0": 0.8 * one.system.plant.heat.h0})
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    draws = jnp.asarray(np.random.default_rng(0).standard_normal(200))
    scenario = dataclasses.replace(Scenario.noiseless(np.full(200, 8e-3)), draws=draws)
    loop = loop_of(
        pid(60.0, 10.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD), "displacement", limiter=limiter, upper=0.5
    )

    def warm(kp, drift, observer, instruments):
        if observer is not None:
            observer = eqx.tree_at(
                lambda o: (o.instruments, o.process_noise[0].temperature), observer, (instruments, drift[None])
            )
        filtered = dataclasses.replace(
            loop, estimator=observer, instruments=instruments, use_estimate=observer is not None
        )
        steered = eqx.tree_at(lambda one: one.controller.kp, filtered, kp)
        return rollout(driven, steered, scenario).channels["temperature"]

    at, way = (jnp.asarray(60.0), jnp.asarray(2.0)), (jnp.asarray(1.0), jnp.asarray(0.1))
    along = eqx.filter_jit(
        lambda kp, drift, instruments: jax.jvp(lambda k, d: warm(k, d, one, instruments), (kp, drift), way)
    )
    found, late = np.asarray(along(*at, instruments)[0]), np.asarray(eqx.filter_jit(warm)(*at, None, instruments))
    assert 80.0 < found.max() < 87.0 and found[-1] == pytest.approx(84.0, abs=1.5) and late.max() > found.max() + 3.0
    fine = eqx.tree_at(lambda m: m.sensors["voltage"].quantum, instruments, jnp.asarray(0.0))
    ends = [along(*(v + s * 1e-4 * w for v, w in zip(at, way, strict=True)), fine)[0][:60] for s in (1, -1)]
    central = np.asarray(ends[0] - ends[1]) / 2e-4
    np.testing.assert_allclose(along(*at, fine)[1][:60], central, atol=1e-3 * np.max(np.abs(central)))
    assert np.max(np.abs(central)) > 1e-3
