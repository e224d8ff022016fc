"""FMUs: the NumPy text agrees with JAX, and the packed FMUs, run by fmpy without JAX, agree with a rollout."""

import dataclasses
import subprocess
import sys
import zipfile
from xml.etree import ElementTree

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from smajax.control.estimators.thermal_observer import ThermalObserver
from smajax.control.export.fmu.controller_model import controller_model
from smajax.control.export.fmu.numpy_source import HEADER, numpy_source
from smajax.control.export.fmu.pack import pack_fmu
from smajax.control.export.fmu.plant_model import plant_model
from smajax.control.loop.allocation import Allocation
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.control.loop.gains import gains, unit_of
from smajax.control.loop.rollout import Scenario, rollout
from smajax.control.loop.temperature_limiter import TemperatureLimiter
from smajax.control.sampled_plant import SampledPlant
from smajax.control.sensors.instruments import Instruments
from smajax.control.sensors.sensor_model import ideal_sensor
from smajax.errors import InputError
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.recordings.recording import Recording
from smajax.simulation.run import simulate
from tests.conftest import ROOT
from tests.unit.control.test_control import CONTROLLERS, RNG, guarded, lost, pid, series, watched

PERIOD = 0.02


def evaluate_text(name, function, **arguments):
    """Flat results of a function's NumPy text with flat arguments."""
    spaces: dict = {}
    exec(HEADER + numpy_source(name, function, arguments), spaces)
    flat = [
        np.asarray(a)[()] if jnp.ndim(a) == 0 or isinstance(a, jax.Array) else list(map(np.asarray, a))
        for a in arguments.values()
    ]
    return spaces[name](*flat)


@jax.custom_jvp
def ramp(x):
    return jnp.where(x > 0.0, x, 0.1 * x)


ramp.defjvp(lambda p, t: (ramp(*p), jnp.where(p[0] > 0.0, 1.0, 0.1) * t[0]))
FUNCTIONS = {
    "while": lambda x: jax.lax.while_loop(
        lambda c: (c[1] < 20) & (jnp.max(c[0]) < 50.0), lambda c: (c[0] * 1.5 + x, c[1] + 1), (x, 0)
    ),
    "scan": lambda x: jax.lax.scan(lambda c, r: (c + r, (c * r, jnp.sin(r))), 0.5, x),
    "scan back": lambda x: jax.lax.scan(lambda c, r: (c * 0.5 + r, c), x[0], x, reverse=True),
    "nothing to scan": lambda x: jax.lax.scan(lambda c, r: (c + r, c), 0.0, x[:0]),
    "cond": lambda x: [jax.lax.cond(x[i] > 0.0, jnp.exp, jnp.square, x[i]) for i in range(3)],
    "switch": lambda x: [jax.lax.switch(jnp.floor(v).astype(int), [jnp.sin, jnp.cos, jnp.tanh], v) for v in x],
    "custom derivative": lambda x: jax.jvp(ramp, (x,), (jnp.ones_like(x),)),
    "linearised": lambda x: jax.linearize(lambda x: jnp.cumsum(x * jnp.tanh(x)), x)[1](x),
    "jacobian": jax.jacfwd(lambda x: jnp.concatenate([x**3 / (1.0 + x * x), jnp.arctan2(x, 2.0)[::-1]])),
    "matrices": lambda x: (
        jnp.outer(x, x) @ x,
        jnp.linalg.norm(x),
        jnp.eye(3).T * x[:, None],
        jnp.tile(x, (2, 1)).sum(axis=0),
    ),
    "shapes": lambda x: (
        jnp.append(x[1:], x[0]),
        jnp.stack([x, -x], axis=1).ravel(),
        jnp.broadcast_to(x[:, None], (3, 2)),
        x[::2],
    ),
    "numbers": lambda x: (
        jnp.clip(x, -0.5, 1.0),
        jnp.sign(x),
        jnp.round(x),
        jnp.floor(x),
        jnp.abs(x) ** 1.5,
        jnp.maximum(x, jnp.inf * x[0]),
    ),
    "flags": lambda x: (
        ~(x > 0.0) | (x < -1.0),
        jnp.all(jnp.isfinite(x)),
        jnp.any(x > 9.0),
        jnp.sum(x > 0.0),
        (x > 0.0).astype(float),
    ),
    "the same twice": lambda x: (jnp.exp(x) + 1.0, jnp.exp(x) + 1.0, x),
    "places": lambda x: jax.lax.dynamic_slice(x, (jnp.sum(x > 0.0) + 3,), (2,)),
}


@pytest.mark.parametrize("name", FUNCTIONS)
def test_numpy_text_agrees_with_jax(name):
    x = jnp.asarray([-1.3, 0.4, 2.7])
    expected = jax.tree.leaves(FUNCTIONS[name](x))
    results = evaluate_text("f", FUNCTIONS[name], x=x)
    assert len(results) == len(expected)
    for a, b in zip(results, expected, strict=True):
        assert np.shape(a) == np.shape(b) and np.asarray(a).dtype.kind == np.asarray(b).dtype.kind
        np.testing.assert_allclose(a, b, rtol=1e-14, atol=1e-15)


def test_an_operation_without_text_raises_with_its_name():
    with pytest.raises(InputError, match="the operation 'sort' cannot be written with NumPy yet"):
        numpy_source("f", jnp.sort, {"x": jnp.zeros(3)})
    with pytest.raises(InputError, match="the operation 'div'"):  # integer division truncates in JAX and not in NumPy
        numpy_source("f", lambda x: jax.lax.div(x, 2), {"x": jnp.zeros(3, int)})


def module(model):
    spaces: dict = {}
    exec(model.equations, spaces)
    return spaces


EFFECTS = {"latent-heat": 1e8, "backlash": 1e-4, "coulomb-friction": 2e7}


@pytest.mark.slow
@pytest.mark.parametrize("name", ["bias-spring", "rotary"])
def test_a_plant_in_numpy_takes_the_same_steps(name):
    """Plants with implicit steps, one of them with effects that have states."""
    plant = read_rig(ROOT / "data" / "recordings" / name / "rig.toml").plant
    if name == "bias-spring":
        plant = dataclasses.replace(
            plant, effects=tuple(catalogue()[key](strength=size) for key, size in EFFECTS.items())
        )
    model = plant_model(plant, name)
    text, wires = module(model), plant.mechanism.wires
    values = [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    high = {"voltage": 8.0, "current": 1.0}[plant.drive.control]
    signals = np.random.default_rng(0).uniform(0.0, high, (12, wires)).repeat(5, axis=0)
    step = np.float64(model.timing["longest"])

    def march(row):
        def single(state, signal):
            state, failed = plant.step(state, signal, signal, jnp.asarray(step))
            return state, (plant.observe(state, signal), failed)

        return jax.lax.scan(single, plant.init(row[0]), row)[1]

    expected, unsolved = jax.jit(march)(jnp.asarray(signals))
    state = list(text["start"](values, list(signals[0])))
    rows = []
    with np.errstate(invalid="ignore"):  # inf * 0 in the branch that np.where discards, as in JAX
        for row in signals:
            *state, failed = text["advance"](values, state, list(row), step)
            assert not failed
            rows.append(text["outputs"](values, state, list(row)))
    assert not np.any(unsolved)
    for i, channel in enumerate(plant.observable):
        np.testing.assert_allclose([r[i] for r in rows], expected[channel], rtol=1e-9, atol=1e-12, err_msg=channel)
    assert np.ptp([r[0] for r in rows]) > 1e-4


@pytest.mark.slow
@pytest.mark.parametrize("name", CONTROLLERS)
def test_a_controller_in_numpy_gives_the_same_commands(name):
    controller = CONTROLLERS[name]
    loop = ClosedLoop(
        controller, Allocation(jnp.asarray(1e9), jnp.zeros(()), 1), ideal_sensor(), channel="displacement"
    )
    model = controller_model(loop, ("A", "m"), {n: unit_of(n, loop, "A", "m") for n in gains(loop)}, name)
    text = module(model)
    values = [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    r, y = (np.cumsum(RNG.standard_normal(80)) * 0.2 for _ in range(2))
    y[40], r[60] = y[39], r[59]
    state, results = list(text["start"](values, [r[0], y[0]])), []
    with_dropouts = [
        np.where(np.arange(80) == k, np.nan, v) for k, v in ((60, r), (40, y))
    ]  # a dropout is replaced by the last value
    for row in zip(*with_dropouts, strict=True):
        *state, _ = text["advance"](values, state, row, np.float64(0.05))
        results += text["outputs"](values, state, row)
    np.testing.assert_allclose(results, series(controller, r, y), rtol=1e-12, atol=1e-12)
    rows, expected = lost(controller)  # dropouts of more than a second
    state, results = list(text["start"](values, list(rows[0]))), []
    for row in rows:
        *state, _ = text["advance"](values, state, list(row), np.float64(0.05))
        results += text["outputs"](values, state, list(row))
        assert all(np.all(np.isfinite(leaf)) for leaf in state)  # otherwise the FMU reports a failed step
    np.testing.assert_allclose(results, expected, rtol=1e-12, atol=1e-12)


@pytest.mark.parametrize("wires", [1, 2])
def test_a_controller_in_numpy_with_a_temperature_limiter(wires):
    loop, rows = watched(CONTROLLERS["pid, feedforward"], wires)
    model = controller_model(loop, ("A", "m"), dict.fromkeys(gains(loop), "A/m"), "guarded")
    text, values = module(model), [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    state, results = list(text["start"](values, list(rows[0]))), []
    for row in rows:
        *state, _ = text["advance"](values, state, list(row), np.float64(0.05))
        results.append(text["outputs"](values, state, list(row)))
    np.testing.assert_allclose(results, guarded(loop, rows), rtol=1e-12, atol=1e-12)


def test_variables_of_two_wires_and_a_temperature_limiter():
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    loop = ClosedLoop(
        pid(dt=PERIOD), Allocation(jnp.asarray(0.5), jnp.asarray(0.1), 2), ideal_sensor(), limiter, channel="angle"
    )
    model = controller_model(loop, ("A", "rad"), dict.fromkeys(gains(loop), "A/rad"), "two")
    names = [v.name for v in model.variables if v.causality != "parameter"]
    assert names == ["reference", "measurement", "temperature_1", "temperature_2", "command_1", "command_2"]
    text = module(model)
    values = [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    for warm, expected in ((20.0, [0.5, 0.1]), (99.0, [0.0, 0.1])):
        inputs = [np.float64(v) for v in (0.0, 0.0, warm, 20.0)]
        *state, _ = text["advance"](
            values, list(text["start"](values, inputs)), [np.float64(9.0), *inputs[1:]], np.float64(0.02)
        )
        np.testing.assert_allclose(text["outputs"](values, state, inputs), expected)
    # The first wire's temperature is missing: after a second only the other wire is heated.
    inputs, commands = [np.float64(v) for v in (9.0, 0.0, 20.0, 20.0)], []
    state = list(text["start"](values, inputs))
    for k in range(90):
        warm = np.float64(np.nan if 10 <= k < 80 else 20.0)
        *state, _ = text["advance"](values, state, [*inputs[:2], warm, inputs[3]], np.float64(0.02))
        commands.append(text["outputs"](values, state, inputs))
    np.testing.assert_allclose(commands, [[0.0 if 59 <= k < 80 else 0.5, 0.1] for k in range(90)])


def test_a_temperature_limiter_by_an_observer_measures_the_power():
    """It uses the observer's temperatures, also while the thermocouple is NaN, and starts with the first finite values."""
    limiter = TemperatureLimiter(pid(0.05, 0.02, 0.0, tf=0.0, low=0.0, high=0.5, dt=PERIOD), jnp.asarray(84.0))
    observer = ThermalObserver(*map(jnp.asarray, (12.0, -0.9, 1.0, 20.0, 0.2)), period=PERIOD)
    instruments = Instruments(
        {"temperature": ideal_sensor()}, PERIOD, jnp.asarray(5.0)
    )  # the world's, which an FMU leaves out
    loop = ClosedLoop(
        pid(dt=PERIOD),
        Allocation(jnp.asarray(0.5), jnp.zeros(()), 1),
        ideal_sensor(),
        limiter,
        observer,
        instruments,
        channel="angle",
    )
    model = controller_model(loop, ("A", "rad"), dict.fromkeys(gains(loop), "A/rad"), "observed")
    assert [v.name for v in model.variables if v.causality == "input"] == [
        "reference",
        "measurement",
        "temperature",
        "power",
    ]
    text, values = module(model), [np.float64(v.start) for v in model.variables if v.causality == "parameter"]
    rows = [[np.float64(v) for v in (9.0, 0.0, 60.0 + k % 7, 6.0 + k % 5)] for k in range(200)]
    names = ("angle", "temperature", "power")
    seen = [dict(zip(names, map(jnp.asarray, row[1:]), strict=True)) for row in rows]
    alone = dataclasses.replace(loop, instruments=None)
    expected, inner = [], alone.reset(jnp.asarray(9.0), seen[0])
    step = eqx.filter_jit(alone.step)
    for one in seen:
        inner, each = step(inner, jnp.asarray(9.0), one, jnp.zeros(()))
        expected.append(float(each[0]))

    def run(rows, text=text):
        state, commands = list(text["start"](values, rows[0])), []
        for row in rows:
            *state, _ = text["advance"](values, state, row, np.float64(PERIOD))
            assert all(np.all(np.isfinite(leaf)) for leaf in state)
            commands.append(float(text["outputs"](values, state, row)[0]))
        return np.array(commands)

    commands = run(rows)
    np.testing.assert_allclose(commands, expected, rtol=1e-12, atol=1e-12)
    assert min(commands) < 0.45 < max(commands)

    # Without its thermocouple at first, or later, the estimate goes on by itself; without the power nothing heats after a second.
    alone = dataclasses.replace(loop, estimator=dataclasses.replace(observer, gain=jnp.zeros(())))
    trusts_none = module(controller_model(alone, ("A", "rad"), dict.fromkeys(gains(loop), "A/rad"), "alone"))
    cold = [[*row[:2], np.float64(20.0), row[3]] for row in rows]  # where both estimates begin
    blind = [[*row[:2], np.float64(np.nan), row[3]] for row in rows]
    np.testing.assert_allclose(run(blind), run(cold, trusts_none), rtol=1e-12, atol=1e-12)
    dead = run([[*row[:3], np.float64(np.nan if k >= 5 else row[3])] for k, row in enumerate(rows)])
    assert np.all(dead[5:15] > 0.0) and np.all(dead[55:] == 0.0)
    # A sensor that is late: the loop begins with it, as if it had been at rest there.
    late = run([[row[0], np.float64(np.nan), *row[2:]] if k < 10 else row for k, row in enumerate(rows)])
    assert np.all(late[:10] == 0.0) and np.all(np.isfinite(late)) and np.any(late[10:] > 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """FMUs of the dead-weight rig, run by fmpy in another process: folder, plant, loop, inputs and results."""
    where = tmp_path_factory.mktemp("fmu")
    plant = read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").plant
    controller = pid(60.0, 20.0, 0.5, tf=0.05, low=0.0, high=0.5, dt=PERIOD)
    loop = ClosedLoop(
        controller, Allocation(jnp.asarray(0.5), jnp.zeros(()), 1), ideal_sensor(), channel="displacement"
    )
    model = controller_model(loop, ("A", "m"), {n: unit_of(n, loop, "A", "m") for n in gains(loop)}, "pid")
    (where / "plant.fmu").write_bytes(pack_fmu(plant_model(plant, "wire")))
    (where / "controller.fmu").write_bytes(pack_fmu(model))
    time = PERIOD * np.arange(201)
    signals = {
        "period": PERIOD,
        "time": time,
        "current": 0.2 + 0.2 * (np.arange(201) // 50 % 2),
        "reference": np.where(time[:-1] < 2.5, 3e-3, 1e-3),
        "samples": 3e-3 * np.random.default_rng(0).standard_normal((200, 2)),
    }
    np.savez(where / "wanted.npz", **signals)
    process = subprocess.run(
        [sys.executable, str(ROOT / "tests" / "support" / "fmu_master.py"), str(where)], capture_output=True, text=True
    )
    assert process.returncode == 0, process.stdout + process.stderr
    return where, plant, loop, signals, np.load(where / "found.npz")


def test_the_plant_fmu_agrees_with_a_simulation(folder):
    _, plant, _, signals, results = folder
    recording = Recording.from_arrays("own", signals["time"], {"current": signals["current"]}, {"current": "A"})
    # An FMU holds its inputs over a step.
    expected = simulate(plant, recording, interpolation="hold").channels
    for i, channel in enumerate(("displacement", "temperature", "resistance")):
        np.testing.assert_allclose(results["alone"][:, i], expected[channel], rtol=1e-9, atol=1e-12)
    assert np.ptp(results["alone"][:, 0]) > 1e-3


def test_the_controller_fmu_agrees_with_the_controller(folder):
    _, _, loop, signals, results = folder
    samples = np.vstack([[0.0, 0.0], signals["samples"]])
    expected = series(loop.controller, *samples.T)[1:]
    np.testing.assert_allclose(results["commands"], expected, rtol=1e-9, atol=1e-12)
    assert np.ptp(expected) > 0.3
    # Gains can be set; in 2.5 periods there are three samples, each of which adds to the integral.
    np.testing.assert_allclose(results["gains"], 3.0 * 2e-3 + 3 * 10.0 * 2e-3 * PERIOD)


def test_both_fmus_agree_with_a_rollout(folder):
    _, plant, loop, signals, results = folder
    run = eqx.filter_jit(rollout)
    scenario = Scenario.noiseless(signals["reference"])
    for name, driven in (
        ("closed", SampledPlant.of(plant, PERIOD)),
        ("other", SampledPlant.of(plant, PERIOD).with_parameters({"environment.ambient": 30.0, "load.mass": 0.3})),
    ):
        loop_run = run(driven, loop, scenario)
        expected = np.column_stack(
            [loop_run.channels["displacement"], loop_run.channels["temperature"], loop_run.command[:, 0]]
        )
        np.testing.assert_allclose(results[name], expected, rtol=1e-9, atol=1e-12)
    assert np.ptp(results["closed"][:, 0]) > 1e-3 and np.abs(results["other"] - results["closed"])[:, 0].max() > 1e-4
    # A shorter communication step does not change the controller's period, only the plant's step.
    assert 0.0 < np.abs(results["fine"] - results["closed"])[:, 0].max() < 2e-5
    np.testing.assert_array_equal(*results["twice"])


def test_model_description_and_documentation(folder):
    where, plant, _, _, results = folder
    np.testing.assert_allclose(
        results["start"], [float(plant.environment.ambient), float(plant.mechanism.load.mass), 0.0, 0.0], atol=1e-3
    )
    root = ElementTree.fromstring(zipfile.ZipFile(where / "plant.fmu").read("modelDescription.xml"))
    variables = {v.get("name"): v for v in root.find("ModelVariables")}
    assert variables["command"].get("causality") == "input" and variables["command"][0].get("unit") == "A"
    assert variables["load.mass"].get("variability") == "tunable" and variables["load.mass"][0].get("min") == "0.0"
    units = {u.get("name"): u[0].attrib for u in root.find("UnitDefinitions")}
    assert units["Pa"] == {"kg": "1", "m": "-1", "s": "-2"} and units["degC"] == {"K": "1", "offset": "273.15"}
    assert pack_fmu(plant_model(plant, "wire")) == (where / "plant.fmu").read_bytes()
    page = zipfile.ZipFile(where / "controller.fmu").read("documentation/index.html").decode()
    assert "a controller of displacement" in page and "every 0.02 s" in page and "LD_PRELOAD" in page
    names = zipfile.ZipFile(where / "controller.fmu").namelist()
    assert any(n.endswith("_equations.py") for n in names) and not any(n.endswith((".pkl", ".pyc")) for n in names)


def test_a_missing_pythonfmu_raises_with_its_cure(monkeypatch, folder):
    monkeypatch.setitem(sys.modules, "pythonfmu", None)
    with pytest.raises(InputError, match="pip install 'smajax.fmu.'"):
        pack_fmu(controller_model(folder[2], ("A", "m"), dict.fromkeys(gains(folder[2].controller), "A/m"), "pid"))
