"""Sweeps: designs, metrics against the exact reference, derivatives, the command, and what is left when a run dies."""

import contextlib
import json
import os
import pathlib
import resource
import shutil
import signal
import socket
import subprocess
import sys
import threading
import time
from dataclasses import replace

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.linalg import expm
from scipy.stats import sobol_indices as scipy_sobol_indices
from scipy.stats import uniform
from typer.testing import CliRunner

from smajax import parameters
from smajax.actuators.knee import Knee
from smajax.app.cli import app
from smajax.app.commands.sweep import SweepJob, run_sweep
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.files.rig_file import read_rig
from smajax.progress import Progress
from smajax.report.sweep import best_rows, sweep_summary
from smajax.sweeps import chunks, compilation, evaluation, space
from smajax.sweeps.bandwidth import FrequencyPoint, find_bandwidth
from smajax.sweeps.checkpoint import checkpoint_folder
from smajax.sweeps.chunks import derivative_column
from smajax.sweeps.compilation import evaluate_batch
from smajax.sweeps.excitation import Excitation, discretise_excitation, grid_parts
from smajax.sweeps.metrics import METRICS, Response, bandwidth
from smajax.sweeps.pareto import pareto_front, thin_front
from smajax.sweeps.refinement import refine, restore_and_refine
from smajax.sweeps.rig_problem import RigSweepProblem
from smajax.sweeps.sobol import complete_rows, missing_reason, sobol_indices
from smajax.sweeps.space import Axis
from smajax.sweeps.step_levels import group_steps
from smajax.sweeps.sweep_file import read_sweep
from smajax.sweeps.table import read_table, write_table
from tests.reference import rigs
from tests.reference.brinson import Material
from tests.reference.wire import Heat, Wire
from tests.support.processes import workers_of

ROOT = pathlib.Path(__file__).parents[3]
RIG = ROOT / "data" / "recordings" / "dead-weight" / "rig.toml"
AXES = ("wire.diameter", "load.mass", "input.amplitude")
SWEEP = """
[sweep]
rig = "rig.toml"
designs = 130
chunk = 20
metrics = ["stroke", "force", "peak_stress", "peak_temperature", "energy_per_cycle", "work_per_cycle", "efficiency", "time_to_cool"]
[parameters]
wire.diameter = ["0.14 mm", "0.2 mm"]
load.mass = { from = "100 g", to = "300 g", scale = "log" }
input.amplitude = ["0.2 A", "0.4 A"]
[input]
wave = "square"
amplitude = "0.3 A"
frequency = "0.5 Hz"
cycles = 2
[objectives]
stroke = "max"
energy_per_cycle = "min"
[constraints]
peak_temperature = { at_most = "120 degC" }
"""


@pytest.fixture
def folder(tmp_path):
    (tmp_path / "rig.toml").write_text(RIG.read_text("utf-8"), "utf-8")
    (tmp_path / "sweep.toml").write_text(SWEEP, "utf-8")
    return tmp_path


def run(folder, out="out", **options):
    return run_sweep(SweepJob(folder / "sweep.toml", folder / out, **options), Progress(quiet=True), ["smajax"])


def test_designs_lie_where_they_should():
    axes = (
        Axis("a", "m", 1.0, 3.0),
        Axis("b", "m", 1e-3, 1.0, log=True),
        Axis("c", "1", 1.0, 5.0, values=(1.0, 5.0, 2.0)),
    )
    grid = space.draw_designs(axes[:2], "grid", 0, 0)
    assert grid.shape == (25, 2) and np.allclose(np.unique(grid[:, 1]), np.geomspace(1e-3, 1.0, 5))
    assert np.array_equal(np.unique(space.draw_designs(axes[2:], "grid", 0, 0)), [1.0, 2.0, 5.0])
    for sampling in ("latin-hypercube", "sobol"):
        found = space.draw_designs(axes, sampling, 64, 3)
        assert np.array_equal(found, space.draw_designs(axes, sampling, 64, 3)) and not np.array_equal(
            found, space.draw_designs(axes, sampling, 64, 4)
        )
        # Each of 64 equal parts of each axis holds one design.
        for k, axis in enumerate(axes[:2]):
            assert np.array_equal(np.sort((axis.share(found[:, k]) * 64).astype(int)), np.arange(64))
        assert set(found[:, 2]) == {1.0, 5.0, 2.0}
    share = np.linspace(0.0, 1.0, 7)
    for axis in axes[:2]:
        assert np.allclose(axis.share(axis.at(share)), share, atol=1e-14)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**31), st.integers(1, 60), st.integers(1, 3))
def test_the_front_holds_what_nothing_dominates(seed, count, size):
    costs = np.random.default_rng(seed).integers(0, 6, (count, size)).astype(float)
    costs[np.random.default_rng(seed + 1).random(count) < 0.1] = np.nan
    beaten = [any(np.all(b <= a) and np.any(b < a) for b in costs) or np.isnan(a).any() for a in costs]
    assert np.array_equal(pareto_front(costs), np.flatnonzero(~np.array(beaten)))


def test_sobol_indices_of_ishigamis_function():
    axes = tuple(Axis(n, "1", -np.pi, np.pi) for n in "xyz")

    def ishigami(x):
        return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])

    designs = space.pick_and_freeze(axes, 4096, 0)
    found = sobol_indices(ishigami(designs.T), "xyz", 0)
    assert np.allclose([found[n].first for n in "xyz"], [0.3139, 0.4424, 0.0], atol=0.01)
    assert np.allclose([found[n].total for n in "xyz"], [0.5576, 0.4424, 0.2437], atol=0.01)
    assert all(
        one.first95[0] <= one.first <= one.first95[1] and one.total95[0] <= one.total <= one.total95[1]
        for one in found.values()
    )
    theirs = scipy_sobol_indices(
        func=lambda x: ishigami(x)[None], n=4096, dists=[uniform(-np.pi, 2 * np.pi)] * 3, rng=np.random.default_rng(0)
    )
    assert np.allclose([found[n].total for n in "xyz"], theirs.total_order.ravel(), atol=0.01)
    # Rows of designs with a failed one among them are left out, and no more.
    holed = ishigami(designs.T)
    holed[np.random.default_rng(1).integers(0, len(holed), 50)] = np.nan
    rest = sobol_indices(holed, "xyz", 0)
    assert all(
        rest[n].total == pytest.approx(found[n].total, abs=0.02) and rest[n].total != found[n].total for n in "xyz"
    )
    assert 4046 <= np.sum(complete_rows(holed, 3)) < 4096
    infinite = np.where(np.arange(len(holed)) == 7, np.inf, holed)
    for values, reason in (
        (np.ones(200), "does not vary"),
        (infinite, "infinite"),
        (np.full(200, np.nan), "has a value in all designs of 0 rows only"),
    ):
        assert sobol_indices(values, "xyz", 0) == {} and reason in missing_reason(values, 3)


def test_bandwidth_is_where_the_stroke_has_fallen():
    frequencies = jnp.geomspace(0.1, 10.0, 400)
    low_pass = 1.0 / jnp.sqrt(1.0 + (frequencies / 2.0) ** 2)
    wanted = 2.0 * np.sqrt(1.0 / (0.5 * float(low_pass[0]) ** 2) - 1.0)
    assert float(bandwidth(frequencies, low_pass)) == pytest.approx(wanted, rel=1e-4)
    assert np.isinf(float(bandwidth(frequencies, jnp.ones(400))))
    assert np.isnan(float(bandwidth(frequencies, jnp.full(400, jnp.nan))))


def test_a_bandwidth_is_found_between_frequencies():
    def low_pass(tau, frequency):  # a cliff on top, which straight lines between a few frequencies would miss by far
        return FrequencyPoint(jnp.exp(-((frequency * tau) ** 8)), frequency, jnp.asarray(0))

    def of(tau, lowest, highest=10.0):
        held = jax.lax.stop_gradient(tau)
        return find_bandwidth(
            lambda frequency: low_pass(held, frequency), lowest, highest, lambda frequency: low_pass(tau, frequency)
        )[0]

    for tau, lowest in ((0.5, 0.1), (0.3, 0.2), (0.9, 0.05)):
        wanted = lambda tau, lowest: (0.5 * np.log(2.0) + (lowest * tau) ** 8) ** 0.125 / tau  # noqa: E731
        found, slopes = jax.jit(jax.value_and_grad(of, (0, 1)))(tau, lowest)
        assert float(found) == pytest.approx(wanted(tau, lowest), rel=1e-4)
        assert float(slopes[0]) == pytest.approx(-float(found) / tau, rel=2e-2) and abs(float(slopes[1])) < 1e-3
        plain = find_bandwidth(lambda frequency, tau=tau: low_pass(tau, frequency), jnp.asarray(lowest), 10.0)
        assert float(plain[0]) == pytest.approx(float(found), rel=1e-9) and float(plain[1]) == pytest.approx(
            float(found), rel=2e-2
        )
    assert np.isinf(float(of(0.5, jnp.asarray(0.1), 1.0)))


def test_bandwidth_of_a_rig_against_dense_frequencies():
    plant, wave = read_rig(RIG).plant, Excitation("square", 0.3, 0.1, 0.5, 2)
    problem = RigSweepProblem(("heat.h0", "input.amplitude"), plant, ("bandwidth", "settling"), wave, 2, "hold", 2.0)
    found, codes = evaluate_batch(problem, jnp.asarray([[90.0, 0.3], [90.0, 1e-4]]), 100)
    assert np.isnan(found["bandwidth"][1])  # a wire that stays cold does not move, and so does not fall off
    each = RigSweepProblem(("heat.h0", "input.frequency"), plant, ("stroke", "settling"), wave, 2, "hold", 0.0)
    dense = np.sort(
        np.concatenate([np.geomspace(0.1, 2.0, 40), float(found["bandwidth"][0]) * np.linspace(0.97, 1.03, 31)])
    )
    told, _ = evaluate_batch(each, jnp.asarray(np.column_stack([np.full(len(dense), 90.0), dense])), 100)
    first = int(np.argmax(told["stroke"] <= told["stroke"][0] / np.sqrt(2.0)))
    assert not np.any(codes) and dense[first - 1] * 0.999 <= float(found["bandwidth"][0]) <= dense[first] * 1.001
    # It is read off a response that is further from closing than the slow wave's.
    assert found["settling"][0] > max(float(told["settling"][0]), 0.5 * float(told["settling"][first - 1]))


def test_a_wire_that_still_warms_up_has_not_settled(folder):
    plant = read_rig(RIG).plant
    rows = {}
    for cycles in (4, 60):
        problem = RigSweepProblem(
            ("heat.h0",),
            plant,
            ("stroke", "settling"),
            Excitation("square", 0.5, 6.0, 0.5, cycles),
            cycles,
            "hold",
            0.0,
        )
        rows[cycles] = {n: float(v[0]) for n, v in evaluate_batch(problem, jnp.asarray([[100.6]]), 40)[0].items()}
    assert rows[4]["stroke"] > 100.0 * rows[60]["stroke"] and rows[4]["settling"] > 0.5 and rows[60]["settling"] < 1e-6
    (folder / "sweep.toml").write_text(
        SWEEP.replace('frequency = "0.5 Hz"', 'frequency = "6 Hz"').replace("designs = 130", "designs = 20"), "utf-8"
    )
    outcome = run(folder)
    columns = read_table(folder / "out" / "sweep.parquet")
    moving = np.sum(columns["settling"] > 0.01)
    assert outcome.document["settling"]["unsettled"] == moving > 0
    assert f"{moving} designs have not settled" in outcome.document["summary"] and outcome.document["feasible"] == 20


def test_refined_designs_in_words():
    """What refining gained is said beside the best of the drawn designs, and whether it has settled."""

    def refined(stroke, better):
        return {"better": better, "simulations": 30, "metrics": {"stroke": stroke}, "parameters": {}}

    def told(refined, settling=None):
        best = {"design": 3, "parameters": {}, "metrics": {"stroke": 2e-3}}
        document = {
            "designs": 9,
            "rig": "rig.toml",
            "codes": {"done": 9},
            "constraints": {},
            "objectives": {"stroke": "max"},
        }
        document |= {"front": [best], "on_front": 1, "metrics": {"stroke": {"unit": "m"}}, "problems": []}
        return sweep_summary(document | {"refined": refined, "settling": settling or {}})

    gained = told([refined(1.9e-3, True), refined(3e-3, True)])
    assert gained.endswith("2 mm, with design 3. Refined along its gradients it is 3 mm, in 60 simulations.")
    assert told([refined(1.9e-3, True)]).endswith("it is 1.9 mm, in 30 simulations, which is not better.")
    none = told([refined(2e-3, False)])
    assert none.endswith(
        "with design 3. Refining along its gradients found none better than those it began from, in 30 simulations."
    )
    assert told([]).endswith("with design 3.")
    still = {
        "designs": 9,
        "rig": "rig.toml",
        "codes": {"done": 9},
        "constraints": {},
        "objectives": {"stroke": "max"},
        "refined": [],
    }
    still |= {"front": [], "metrics": {"stroke": {"unit": "m", "lowest": 0.0, "highest": 0.0}}, "problems": []}
    assert sweep_summary(still).endswith("The parameters do not change stroke, so that no design is the best in it.")
    moving = {"limit": 0.01, "unsettled": 0, "unsettled_on_front": 0, "unsettled_refined": 1}
    assert " 1 refined one has not settled: the last cycle ends more than 1 %" in told([refined(3e-3, True)], moving)
    both = told([], moving | {"unsettled": 5, "unsettled_on_front": 1, "unsettled_refined": 2})
    assert (
        " 5 designs have not settled (1 of the best among them), and 2 refined ones have not settled: the last" in both
    )


def test_a_refined_wire_that_still_warms_up_is_counted(folder):
    text = SWEEP.replace('frequency = "0.5 Hz"', 'frequency = "6 Hz"').replace("designs = 130", "designs = 20")
    (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 1\n", "utf-8")
    document = run(folder).document
    (one,) = document["refined"]
    assert one["better"] and one["metrics"]["settling"] > 0.01
    assert document["settling"]["unsettled_refined"] == 1 and "1 refined one has not settled" in document["summary"]


def test_waves_have_their_edges_on_the_grid():
    wave = Excitation("square", 2.0, 0.5, 0.3, 3)
    inputs = discretise_excitation(wave, 1, 40, {}, (jnp.asarray(0.1), jnp.asarray(0.25)))
    time, before = np.asarray(inputs.time), np.asarray(inputs.before)[:, 0]
    jumps = time[1:-1][np.diff(before) != 0.0]
    assert np.allclose(jumps, [0.6, 2.0, 2.6, 4.0, 4.6, 6.0, 6.6])
    where = grid_parts(wave, 1, 40, True)
    assert np.allclose(time[where.cycle][[0, -1]], [4.0, 6.0]) and np.allclose(time[where.rest][[0, -1]], [6.6, 11.6])
    both = discretise_excitation(Excitation("square", 1.0, 1.0, 0.25, 1), 2, 40, {"amplitude": jnp.asarray(3.0)})
    middle = np.asarray(0.5 * (both.time[1:] + both.time[:-1]))
    on = np.asarray(both.before) > 0.0
    assert np.array_equal(on[:, 0], middle < 0.25) and np.array_equal(on[:, 1], (middle > 0.5) & (middle < 0.75))
    assert float(both.before.max()) == 3.0
    for shape in ("sine", "triangle"):
        smooth = discretise_excitation(Excitation(shape, 1.0, 1.0, 0.5, 2), 2, 40, {})
        assert np.allclose(np.asarray(smooth.after)[:-1], np.asarray(smooth.before)[1:], atol=1e-12)
        assert np.allclose(np.asarray(smooth.after).max(axis=0), 1.0) and np.asarray(smooth.after).min() > -1e-12


def test_what_cools_through_a_sheath_rests_until_it_is_cool(tmp_path):
    """With one number for h, wire and liner are a linear system. What is heated by nothing, or never cools so far, has no such time."""
    glove = (ROOT / "data" / "recordings" / "glove-finger" / "rig.toml").read_text("utf-8")
    (tmp_path / "rig.toml").write_text(glove, "utf-8")
    content = """
    [sweep]
    rig = "rig.toml"
    sampling = "grid"
    metrics = ["time_to_cool"]
    [parameters]
    sheath.conductance_ratio = { values = ["0", "3", "20"] }
    sheath.time_constant = { values = ["0.5 s", "3 s", "60 s"] }
    [input]
    wave = "square"
    amplitude = "8 W"
    frequency = "0.02 Hz"
    duty = 0.3
    cycles = 1
    """
    (tmp_path / "sweep.toml").write_text(content, "utf-8")
    sweep = read_sweep(tmp_path / "sweep.toml")
    problem, designs = sweep.problem(), sweep.designs()
    found = chunks.evaluate_designs(problem, designs, int(problem.steps(designs).max()))["time_to_cool"]
    area, volume = np.pi * 0.38e-3 * 0.9, np.pi / 4 * 0.38e-3**2 * 0.9
    own = 5.4e6 * volume / (120.0 * area)  # the wire's time constant
    for (conduction, lag), cooling in zip(designs, found, strict=True):
        rates = np.array([[-(1.0 + conduction) / own, conduction / own], [1.0 / lag, -1.0 / lag]])
        steady = -np.linalg.solve(rates, [8.0 / (5.4e6 * volume), 0.0])
        hot = _heated(rates, steady)
        time = np.linspace(0.0, 2000.0, 400_001)
        values, vectors = np.linalg.eig(rates)
        excess = (vectors[0] * np.linalg.solve(vectors, hot) * np.exp(np.outer(time, values))).sum(axis=1)
        assert cooling == pytest.approx(time[np.argmax(excess <= 0.1 * excess[0])], rel=5e-3)
    cold = Response(
        jnp.arange(3.0), {"temperature": jnp.full(3, 20.0)}, "angle", 1, jnp.ones(()), jnp.asarray(20.0), 1.0
    )
    assert np.isnan(METRICS["time_to_cool"].read(cold))
    warm = cold._replace(channels={"temperature": jnp.asarray([80.0, 40.0, 30.0])})
    assert METRICS["time_to_cool"].read(warm) == np.inf


def _heated(rates: np.ndarray, steady: np.ndarray) -> np.ndarray:
    """The excess of wire and liner after 15 s of heat, 35 s without, and 15 s with it again."""
    first = steady - expm(15.0 * rates) @ steady
    return steady + expm(15.0 * rates) @ (expm(35.0 * rates) @ first - steady)


def test_as_few_programs_as_pay():
    few = np.array([40, 50, 900])
    assert np.array_equal(group_steps(few), [900, 900, 900])
    many = np.concatenate([np.full(50_000, 40), np.full(10, 1000)])
    given = group_steps(many)
    assert np.all(given >= many) and set(given) == {40, 1000}


def test_batches_fit_into_memory(folder):
    problem = read_sweep(folder / "sweep.toml").problem()
    assert compilation.batch_size(problem, 40, False) == 64
    long = compilation.batch_size(problem, 10**6, False)
    assert 1 <= long < 8 and long * 8 * problem.numbers(10**6) <= compilation.MEMORY
    assert compilation.batch_size(problem, 10**4, True) < compilation.batch_size(problem, 10**4, False)


def test_an_accelerators_batch_takes_several_chunks(folder, monkeypatch):
    sweep = read_sweep(folder / "sweep.toml")
    problem, parts = sweep.problem(), chunks.split_into_chunks(sweep.problem(), sweep.designs(), 20)
    assert [len(group) for group in chunks.group_chunks(problem, parts, False)] == [1] * 7
    narrow = {chunk.number: found for done in chunks.submit_locally(problem, False)(parts[:3]) for chunk, found in done}
    sizes = []

    def counted(problem, designs, steps):
        sizes.append(len(designs))
        return evaluate_batch(problem, designs, steps)

    monkeypatch.setattr(compilation, "on_accelerator", lambda: True)
    monkeypatch.setattr(compilation, "evaluate_batch", counted)
    assert [len(group) for group in chunks.group_chunks(problem, parts, False)] == [7]
    together = {
        chunk.number: found for done in chunks.submit_locally(problem, False)(parts[:3]) for chunk, found in done
    }
    # 60 designs in one batch of 64, not three of 16384.
    assert sizes == [64] and together.keys() == narrow.keys()
    for number, found in together.items():
        assert all(
            np.array_equal(v, narrow[number][n]) if n == "code" else np.allclose(v, narrow[number][n], rtol=1e-9)
            for n, v in found.items()
        )


TWO = """
import sys
import jax
jax.config.update("jax_num_cpu_devices", 2)
import numpy as np
from smajax.sweeps import chunks
from smajax.sweeps.sweep_file import read_sweep
sweep = read_sweep(sys.argv[1])
designs = sweep.designs()[:64]
found = chunks.evaluate_designs(sweep.problem(), designs, 40)
assert jax.device_count() == 2 and len(chunks.compilation.spread_over_devices(designs).sharding.device_set) == 2
np.savez(sys.argv[2], **found)
"""


def test_two_devices_find_what_one_finds(folder):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "EQX_ON_ERROR": "off"}
    call = [sys.executable, "-c", TWO, str(folder / "sweep.toml"), str(folder / "two.npz")]
    done = subprocess.run(call, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    sweep, two = read_sweep(folder / "sweep.toml"), np.load(folder / "two.npz")
    one = chunks.evaluate_designs(sweep.problem(), sweep.designs()[:64], 40)
    assert all(np.array_equal(one[n], two[n]) if n == "code" else np.allclose(one[n], two[n], rtol=1e-12) for n in one)


def test_metrics_agree_with_the_exact_reference(folder):
    """Stroke, temperature, energy and work of the last cycle, and the time to cool, from a simulator that shares no code."""
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs = sweep.problem(), sweep.designs()[:4]
    found = chunks.evaluate_designs(problem, designs, 300)
    plant = sweep.subject.rig.plant
    law = Material(**{k: float(getattr(plant.material, k)) for k in Material._fields})
    heat = Heat(
        *(float(getattr(plant.heat, k)) for k in ("h0", "h1", "h2")),
        2.0,
        float(plant.heat.capacity_austenite),
        float(plant.heat.capacity_martensite),
        0.0,
    )
    for k, (diameter, mass, amplitude) in enumerate(designs):
        # A sample every 10 ms: two cycles of 2 s, a heating of 1 s, a rest of 20 s.
        time = np.arange(2501) * 0.01
        current = amplitude * (((time % 2.0) < 1.0 - 1e-9) & (time < 5.0 - 1e-9))
        wire = Wire(diameter, float(plant.wire.length), 0.0, float(plant.environment.ambient))
        exact = rigs.dead_weight(law, heat, wire, mass, time, current, interpolation="hold")
        cycle, rest = slice(200, 401), slice(500, None)
        area = np.pi / 4 * diameter**2
        assert found["stroke"][k] == pytest.approx(np.ptp(exact.position[cycle]), rel=2e-3, abs=2e-6)
        assert found["peak_temperature"][k] == pytest.approx(exact.temperature.max(), abs=0.05)
        assert found["force"][k] == pytest.approx(mass * 9.81, rel=1e-6) and found["peak_stress"][k] == pytest.approx(
            mass * 9.81 / area, rel=1e-6
        )
        energy = np.sum((exact.resistance[:, 0] * current**2)[cycle][:-1]) * 0.01
        assert found["energy_per_cycle"][k] == pytest.approx(energy, rel=3e-3)
        lifted = np.sum(np.maximum(np.diff(exact.position[cycle]), 0.0)) * mass * 9.81
        assert found["work_per_cycle"][k] == pytest.approx(lifted, rel=5e-3, abs=1e-6)
        assert found["efficiency"][k] == pytest.approx(lifted / energy, rel=1e-2, abs=1e-6)
        excess = exact.temperature[rest, 0] - 20.0
        cooled = 0.01 * np.interp(-0.1 * excess[0], -excess, np.arange(len(excess)))
        assert found["time_to_cool"][k] == pytest.approx(cooled, rel=5e-3)


def test_derivatives_of_every_metric(folder):
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs, steps = sweep.problem(), sweep.designs()[:16], 40
    found = chunks.evaluate_designs(problem, designs, steps, gradients=True)
    plain = chunks.evaluate_designs(problem, designs, steps)
    for name in problem.units:
        assert np.allclose(found[name], plain[name], rtol=1e-9)
    for k, axis in enumerate(problem.names):
        size = 1e-5 * designs[:, k]
        ends = []
        for sign in (1.0, -1.0):
            moved = designs.copy()
            moved[:, k] += sign * size
            ends.append(chunks.evaluate_designs(problem, moved, steps))
        for name in problem.units:
            difference = (ends[0][name] - ends[1][name]) / (2.0 * size)
            slope = found[derivative_column(name, axis)]
            scale = np.abs(plain[name] / designs[:, k])
            # An extreme may move from one grid point to another between the two ends, where a metric has a kink.
            assert np.mean(np.abs(slope - difference) <= 1e-4 * (np.abs(difference) + scale)) >= 0.9, (name, axis)


def test_frequency_as_an_axis_and_a_recording_as_input(folder):
    text = SWEEP.replace('input.amplitude = ["0.2 A", "0.4 A"]', 'input.frequency = ["0.2 Hz", "1 Hz"]').replace(
        "cycles = 2", 'cycles = 2\nhighest = "4 Hz"'
    )
    text = text.replace('"time_to_cool"]', '"bandwidth"]').replace("designs = 130", "designs = 8")
    (folder / "sweep.toml").write_text(text, "utf-8")
    sweep = read_sweep(folder / "sweep.toml")
    found = chunks.evaluate_designs(sweep.problem(), sweep.designs(), 40)
    assert np.all(found["code"] == "done") and np.all(found["bandwidth"] > sweep.designs()[:, 2])
    recorded = (
        SWEEP[: SWEEP.index("[input]")]
        .replace("input.amplitude", "drive.gain")
        .replace('["0.2 A", "0.4 A"]', '["0.9", "1.1"]')
    )
    recorded = (
        recorded.replace(', "time_to_cool"', "").replace("designs = 130", "designs = 8")
        + '[input]\nrecording = "in.csv"\ncycles = 2\n'
    )
    time = np.arange(400) * 0.01
    rows = "\n".join(f"{t:.2f},{0.3 * ((t % 2.0) < 1.0 - 1e-9):.1f}" for t in time)
    (folder / "rig.toml").write_text(
        RIG.read_text("utf-8").replace('interpolation = "linear"', 'interpolation = "hold"'), "utf-8"
    )
    (folder / "in.csv").write_text(f"time [s],current [A]\n{rows}\n", "utf-8")
    (folder / "sweep.toml").write_text(recorded, "utf-8")
    one = read_sweep(folder / "sweep.toml")
    by_recording = chunks.evaluate_designs(one.problem(), one.designs(), 200)
    wave = RigSweepProblem(
        ("wire.diameter", "load.mass", "input.amplitude"),
        one.subject.rig.plant,
        one.metrics,
        Excitation("square", 0.3, 0.5, 0.5, 2),
        2,
        "hold",
        0.0,
    )
    by_wave, _ = evaluate_batch(wave, jnp.asarray(one.designs() * np.array([1.0, 1.0, 0.3])), 200)
    # The recording ends one row before the cycle does.
    assert np.allclose(by_recording["peak_temperature"], np.asarray(by_wave["peak_temperature"]), atol=1e-6)
    assert np.allclose(by_recording["stroke"], np.asarray(by_wave["stroke"]), rtol=1e-2, atol=1e-6)


def test_refined_designs_keep_their_limits_and_beat_the_samples(folder):
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs = sweep.problem(), sweep.designs()
    found = chunks.evaluate_designs(problem, designs, 40)
    hot = found["peak_temperature"]
    kept = np.flatnonzero((hot <= 120.0) & (found["energy_per_cycle"] <= 1.0))
    best = kept[np.argmax(found["stroke"][kept])]
    limits = {"peak_temperature": (-np.inf, 120.0), "energy_per_cycle": (-np.inf, 1.0)}
    one = refine(problem, sweep.axes, designs[best], {"stroke": "max"}, limits)
    assert one.better and one.metrics["stroke"] > 1.02 * one.before["stroke"]
    again = chunks.evaluate_designs(problem, one.design[None], problem.shared_steps(one.design))
    assert again["stroke"][0] == pytest.approx(one.metrics["stroke"], rel=1e-9)
    assert again["peak_temperature"][0] <= 120.0 and again["energy_per_cycle"][0] <= 1.0
    # 2,000 more designs do not have a better one.
    more = space.draw_designs(sweep.axes, "sobol", 2000, 5)
    drawn = chunks.evaluate_designs(problem, more, 40)
    fine = (drawn["peak_temperature"] <= 120.0) & (drawn["energy_per_cycle"] <= 1.0)
    assert one.metrics["stroke"] > drawn["stroke"][fine].max() and one.simulations < 500


def test_the_command_and_its_table(folder):
    outcome = run(folder)
    assert outcome.code == 0 and outcome.reason == ""
    out = folder / "out"
    assert not (folder / "out.partial").exists()
    table = pyarrow.parquet.read_table(out / "sweep.parquet")
    assert table.num_rows == 130 and table.column("design").to_pylist() == list(range(130))
    assert {"wire.diameter [m]", "stroke [m]", "peak_temperature [degC]", "efficiency [1]", "code"} <= set(
        table.column_names
    )
    document = json.loads((out / "sweep.json").read_text("utf-8"))
    columns = read_table(out / "sweep.parquet")
    assert document["feasible"] == np.sum(columns["peak_temperature"] <= 120.0) and document["codes"] == {"done": 130}
    assert all(columns["peak_temperature"][row["design"]] <= 120.0 for row in document["front"])
    page = (out / "report.html").read_text("utf-8")
    assert (
        "No Sobol indices, which need at least 640 designs" in page
        and "Trade-off" in page
        and "Designs across all axes" in page
    )
    (out / "report.html").unlink()
    assert (
        CliRunner().invoke(app, ["report", str(out)]).exit_code == 0
        and (out / "report.html").read_text("utf-8") == page
    )
    header = json.loads(pyarrow.parquet.read_schema(out / "sweep.parquet").metadata[b"smajax.sweep"])
    versions = json.loads((out / "run.json").read_text("utf-8"))["versions"]
    assert {"jax", "numpy", "scipy"} <= header["versions"].keys() and header["versions"].items() <= versions.items()
    # The table alone makes the same table again.
    repeated = run_sweep(SweepJob(out / "sweep.parquet", folder / "again"), Progress(quiet=True), ["smajax"])
    assert (
        repeated.code == 0 and (folder / "again" / "sweep.parquet").read_bytes() == (out / "sweep.parquet").read_bytes()
    )


def test_what_died_is_gone_on_with(folder, monkeypatch):
    run(folder, "whole")
    whole = (folder / "whole" / "sweep.parquet").read_bytes()
    written = []

    def fails(path, *rest, **more):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        return chunks_write(path, *rest, **more)

    chunks_write = chunks.write_table
    monkeypatch.setattr(chunks, "write_table", fails)
    with pytest.raises(KeyboardInterrupt):
        run(folder)
    monkeypatch.setattr(chunks, "write_table", chunks_write)
    assert len(list((folder / "out.partial").glob("chunk-*.parquet"))) == 3 and not (folder / "out").exists()
    with pytest.raises(InputError, match=r"3 chunks of an earlier run are there: add --resume"):
        run(folder)
    (folder / "sweep.toml").write_text(SWEEP.replace('to = "300 g"', 'to = "310 g"'), "utf-8")
    with pytest.raises(InputError, match="are of another sweep"):
        run(folder, resume=True)
    (folder / "sweep.toml").write_text(SWEEP, "utf-8")
    assert run(folder, resume=True).code == 0
    assert (folder / "out" / "sweep.parquet").read_bytes() == whole


def test_what_has_ended_is_not_resumed(folder, monkeypatch):
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 20"), "utf-8")
    first = run(folder, resume=True)
    assert first.note == "there was nothing to resume, so all designs were simulated from the start"
    written = (folder / "out" / "run.json").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("smajax.app.commands.sweep.run_chunks", None)
        again = run(folder, resume=True)
    assert "since this sweep had ended: its result was left as it is" in again.note
    assert again.document == json.loads((folder / "out" / "sweep.json").read_text("utf-8")) and again.code == first.code
    assert (folder / "out" / "run.json").read_bytes() == written
    shown = CliRunner().invoke(app, ["sweep", str(folder / "sweep.toml"), "--out", str(folder / "out"), "--resume"])
    assert shown.exit_code == 0 and "smajax: there was nothing to resume, since" in shown.stderr
    # Where a file is missing, or the sweep is another one, it is simulated again.
    (folder / "out" / "report.html").unlink()
    assert "from the start" in run(folder, resume=True).note and (folder / "out" / "report.html").is_file()
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 21"), "utf-8")
    assert "from the start, and the result that was there" in run(folder, resume=True).note and run(folder).note == ""


def _command(folder, *more):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    arguments = [
        sys.executable,
        "-m",
        "smajax.app.cli",
        "sweep",
        str(folder / "sweep.toml"),
        "--out",
        str(folder / "out"),
        "--quiet",
        *more,
    ]
    return subprocess.Popen(
        arguments, env=environment, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )


def test_a_killed_run_and_a_killed_worker_lose_no_row(folder):
    (folder / "sweep.toml").write_text(SWEEP.replace("chunk = 20", "chunk = 4"), "utf-8")
    run(folder, "whole")
    whole = (folder / "whole" / "sweep.parquet").read_bytes()

    def until_more_than(count: int, process: subprocess.Popen) -> int:
        while (
            process.poll() is None and (there := len(list((folder / "out.partial").glob("chunk-*.parquet")))) <= count
        ):
            time.sleep(0.01)
        assert process.poll() is None, "the run ended before it could be killed"
        return there

    process = _command(folder)
    until_more_than(0, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    # Two workers go on; one of them is killed when they are at work.
    there = len(list((folder / "out.partial").glob("chunk-*.parquet")))
    process = _command(folder, "--resume", "--scheduler", "local")
    assert until_more_than(there, process) < 30  # of 33 chunks
    workers_of(process.pid)[0].kill()
    _, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors
    assert (folder / "out" / "sweep.parquet").read_bytes() == whole


def test_one_run_at_a_time_and_chunks_where_they_belong(folder):
    text = SWEEP.replace("designs = 130", "designs = 40")
    (folder / "sweep.toml").write_text(text, "utf-8")
    sweep = read_sweep(folder / "sweep.toml")
    with checkpoint_folder(folder / "out", sweep.header(), resume=False) as partial:
        with pytest.raises(InputError, match=r"out.partial: another run is at work on it: wait until that has ended"):
            run(folder, resume=True)
        parts = chunks.split_into_chunks(sweep.problem(), sweep.designs(), 20)
        for chunk in parts:
            found = chunks.evaluate_designs(sweep.problem(), chunk.designs, chunk.steps)
            write_table(partial / chunk.file, chunks.chunk_columns(chunk, AXES, found))
        shutil.copy(partial / parts[0].file, partial / parts[1].file)
    with pytest.raises(
        InputError, match=r"chunk-000001.parquet: its designs are not those that belong there: remove the file"
    ):
        run(folder, resume=True)
    (partial / parts[1].file).unlink()
    outcome = run(folder, resume=True)
    assert outcome.code == 0 and outcome.document["codes"] == {"done": 40}


def test_a_full_disk_keeps_what_is_there(folder):
    run(folder, "whole")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    size = max(p.stat().st_size for p in (folder / "whole").glob("*.parquet"))
    assert size > 8192
    resource.setrlimit(resource.RLIMIT_FSIZE, (8192, before[1]))
    try:
        with pytest.raises(InputError, match=r"cannot be written \(File too large\): make room"):
            run(folder)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert run(folder, resume=True).code == 0
    assert (folder / "out" / "sweep.parquet").read_bytes() == (folder / "whole" / "sweep.parquet").read_bytes()


def test_a_run_killed_before_its_first_file_is_gone_on_with(folder):
    partial = folder / "out.partial"
    partial.mkdir()
    (partial / ".sweep.json.4711.part").write_text("{", "utf-8")
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 20"), "utf-8")
    assert run(folder, resume=True).code == 0
    partial.mkdir()
    (partial / "notes.part").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="smajax keeps its chunks there and did not make it"):
        run(folder, resume=True)


def test_without_pyarrow_nothing_is_computed(folder, monkeypatch):
    monkeypatch.setitem(sys.modules, "pyarrow.parquet", None)
    with pytest.raises(InputError, match=r'need pyarrow: run pip install "smajax\[io\]"$'):
        run(folder)
    assert not (folder / "out.partial").exists()


def test_a_table_that_says_nothing_of_a_sweep(tmp_path):
    path = tmp_path / "table.parquet"
    for header in (None, {}, {"sweep": "", "rig": ""}):
        write_table(path, {"design": np.arange(3)}, header)
        with pytest.raises(InputError, match="not a table that smajax sweep wrote"):
            read_sweep(path)


def test_a_table_of_an_earlier_version_is_read_under_the_current_names(folder):
    """Its header has the rig and the axes with a parameter's name of then."""
    text = SWEEP.replace('wire.diameter = ["0.14 mm", "0.2 mm"]', 'material.max_strain = ["4 %", "5 %"]')
    rig = RIG.read_text("utf-8").replace("max_transformation_strain", "max_strain")
    assert "max_strain" in text and "max_strain" in rig
    header = {"name": "sweep.toml", "sweep": text, "rig": rig, "rig_name": "rig.toml", "recording": None}
    write_table(folder / "old.parquet", {"design": np.arange(3)}, header)
    sweep = read_sweep(folder / "old.parquet")
    assert sweep.axes[0].name == "material.max_transformation_strain" and sweep.axes[0].upper == 0.05
    assert "max_transformation_strain" in sweep.header()["rig"]


def test_constraints_that_nothing_keeps(folder):
    (folder / "sweep.toml").write_text(SWEEP.replace('at_most = "120 degC"', 'at_most = "21 degC"'), "utf-8")
    outcome = run(folder)
    assert "degC (allowed: at most 21 degC)" in outcome.reason
    assert outcome.code == 3 and "none of the 130 designs keeps the constraints: the nearest, design" in outcome.reason
    assert (folder / "out" / "sweep.parquet").is_file()


def test_a_search_goes_from_beyond_the_constraints_to_where_they_hold(folder):
    """All that is drawn strokes too little; there is room at the edge of what may be so hot, which the gradients lead to."""
    text = SWEEP.replace("peak_temperature = {", 'stroke = { at_least = "9.5 mm" }\npeak_temperature = {').replace(
        "designs = 130", "designs = 4"
    )
    (folder / "sweep.toml").write_text(text, "utf-8")
    drawn = run(folder, "drawn")
    assert drawn.code == 3 and "has stroke 8.348 mm (allowed: at least 9.5 mm)" in drawn.reason
    (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 2\n", "utf-8")
    outcome = run(folder)
    assert outcome.code == 0 and outcome.document["feasible"] == 0 and not outcome.document["problems"]
    best = [one for one in outcome.document["refined"] if one["better"]]
    assert best and all(one["rescued"] for one in outcome.document["refined"])
    assert all(one["metrics"]["stroke"] >= 9.5e-3 and one["metrics"]["peak_temperature"] <= 120.0 for one in best)
    assert "0 keep all constraints, so the nearest ones were refined: " in outcome.document["summary"]
    assert (folder / "out" / "rig-refined-1.toml").is_file() or (folder / "out" / "rig-refined-2.toml").is_file()
    # Where none is found, it is said how near it came, and where.
    (folder / "sweep.toml").write_text(text.replace("9.5 mm", "20 mm") + "[refine]\nstarts = 1\n", "utf-8")
    none = run(folder, "none")
    assert none.code == 3 and not none.document["refined"][0]["better"]
    assert (
        "refining from the nearest kept none either, and ended at stroke" in none.reason
        and "at wire.diameter" in none.reason
    )


def test_a_whole_count_is_moved_to_where_the_constraints_hold():
    class Problem:
        names, units, shared_steps = ("n", "a"), {"size": "m", "cost": "1"}, staticmethod(lambda design: 1)

    def answer(problem, designs, steps):
        n, a = (float(v) for v in designs[0])
        return {"size": [n * a], "cost": [n + a]}, {"size": np.array([[a, n]]), "cost": np.array([[1.0, 1.0]])}, None

    axes, limits = (
        (Axis("n", "1", 2.0, 5.0, whole=True), Axis("a", "1", 0.0, 1.0)),
        {"size": (3.2, np.inf), "cost": (-np.inf, 5.0)},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        one = restore_and_refine(Problem, axes, np.array([2.0, 0.1]), {"cost": "min"}, limits)
        assert (
            one.better
            and one.restored
            and one.design[0] in (4.0, 5.0)
            and one.metrics["size"] >= 3.2
            and one.metrics["cost"] <= 5.0
        )
        assert one.before == {"size": pytest.approx(0.2), "cost": pytest.approx(2.1)}
        none = restore_and_refine(
            Problem, axes, np.array([2.0, 0.1]), {"cost": "min"}, limits | {"cost": (-np.inf, 2.5)}
        )
        assert not none.better and none.restored and none.metrics["size"] > 0.2


def test_the_nearest_of_those_that_could_be_simulated(tmp_path):
    """Thick wires do not fit into the strip: they have a moment, but no figures."""
    flexural = ROOT / "data" / "actuators" / "flexural" / "rig.toml"
    content = f"""
    [sweep]
    rig = "{flexural}"
    sampling = "grid"
    metrics = ["moment", "resistance", "temperature_after"]
    [parameters]
    wire.diameter = {{ values = ["0.3 mm", "0.9 mm"] }}
    [constraints]
    moment = {{ at_least = "1000 mN m" }}
    """
    (tmp_path / "sweep.toml").write_text(content, "utf-8")
    outcome = run(tmp_path)
    assert outcome.code == 3 and outcome.document["codes"] == {"done": 1, "diverged": 1}
    assert "the nearest, design 0, has moment 1.528 mN m (allowed: at least 1000 mN m)" in outcome.reason


def test_a_design_that_no_memory_holds(folder):
    slow = SWEEP.replace('frequency = "0.5 Hz"', 'frequency = "1e-6 Hz"')
    (folder / "sweep.toml").write_text(slow.replace("designs = 130", "designs = 4"), "utf-8")
    with pytest.raises(
        InputError, match=r"sweep.toml: input.frequency: .* GB a design, of 2 GB allowed: raise input.frequency"
    ):
        run(folder)
    assert not (folder / "out.partial").exists()


def test_wires_at_a_spacing_are_swept_in_their_number(tmp_path):
    flexural = (ROOT / "data" / "actuators" / "flexural" / "rig.toml").read_text("utf-8")
    (tmp_path / "rig.toml").write_text(flexural.replace("count = 2", 'count = 2\nspacing = "1 mm"'), "utf-8")
    content = """
    [sweep]
    rig = "rig.toml"
    sampling = "grid"
    gradients = true
    metrics = ["blocking_force", "temperature_after"]
    [parameters]
    body.count = { values = ["2", "3"] }
    body.spacing = { values = ["0.8 mm", "2 mm"] }
    """
    (tmp_path / "sweep.toml").write_text(content, "utf-8")
    assert run(tmp_path).document["codes"] == {"done": 4}
    columns = read_table(tmp_path / "out" / "sweep.parquet")
    machine = actuator_file.read_actuator(tmp_path / "rig.toml")
    for k, (count, spacing) in enumerate(zip(columns["body.count"], columns["body.spacing"], strict=True)):
        text = flexural.replace("count = 2", f'count = {int(count)}\nspacing = "{1e3 * spacing} mm"')
        alone = eqx.filter_jit(lambda one: one.metrics()["temperature_after"])(actuator_file.parse_actuator(text))
        assert columns["temperature_after"][k] == pytest.approx(float(alone), rel=1e-9)
    # In a number that the grid is made for, temperatures have no derivative; a force has one.
    assert np.all(np.isnan(columns[derivative_column("temperature_after", "body.count")]))
    assert np.all(columns[derivative_column("temperature_after", "body.spacing")] < 0.0)
    assert np.all(columns[derivative_column("blocking_force", "body.count")] > 0.0)
    assert machine.program_index({}) == 2


def test_batches_of_bends_side_by_side(tmp_path):
    """Batches are simulated by several threads at once, and one design after another gives the same."""
    machine = ROOT / "data" / "actuators" / "soft-bending" / "rig.toml"
    text = f'[sweep]\nrig = "{machine}"\ndesigns = 64\nmetrics = ["tip_deflection"]\n[parameters]\ncable.force = ["-10 kN", "-100 N"]\n'
    (tmp_path / "sweep.toml").write_text(text, "utf-8")
    process = _command(tmp_path)
    try:
        _, errors = process.communicate(timeout=120)
    finally:
        process.kill()
    assert process.returncode == 0, errors
    columns = read_table(tmp_path / "out" / "sweep.parquet")
    bent = columns["code"] == "done"
    assert (
        np.array_equal(bent, ~np.isnan(columns["tip_deflection"]))
        and np.all(bent[columns["cable.force"] > -3000.0])
        and not np.all(bent)
    )
    # The stronger the cable, the more of the bar stands upright.
    rising = columns["tip_deflection"][bent][np.argsort(-columns["cable.force"][bent])]
    assert np.all(np.diff(rising) > 0.0) and rising[-1] < 0.12


def test_shipped_sweeps_and_a_machine(tmp_path):
    for path in sorted((ROOT / "data" / "sweeps").glob("*.toml")):
        sweep = read_sweep(path)
        assert sweep.refine_starts and sweep.designs().shape == (sweep.count, len(sweep.axes))
    machine = (
        (ROOT / "data" / "sweeps" / "flexural.toml")
        .read_text("utf-8")
        .replace("../actuators", str(ROOT / "data" / "actuators"))
    )
    machine = (
        machine.replace('["moment", "efficiency"]', "[]")
        .replace("designs = 256", "designs = 12")
        .replace("time_to_cool", "resistance")
    )
    (tmp_path / "sweep.toml").write_text(machine, "utf-8")
    assert run(tmp_path).code == 0
    columns = read_table(tmp_path / "out" / "sweep.parquet")
    single = actuator_file.read_actuator(ROOT / "data" / "actuators" / "flexural" / "rig.toml")
    one = eqx.filter_jit(type(single).metrics)(
        parameters.replace(single, {n: columns[n][3] for n in ("wire.diameter", "body.count")})
    )
    assert columns["blocking_force"][3] == pytest.approx(float(one["blocking_force"]), rel=1e-12)
    (tmp_path / "sweep.toml").write_text(machine.replace("blocking_force =", "peak_stress ="), "utf-8")
    with pytest.raises(
        InputError,
        match="objectives.peak_stress is not a metric of this actuator, but of rigs with wires: its metrics are mo",
    ):
        read_sweep(tmp_path / "sweep.toml")
    (tmp_path / "sweep.toml").write_text(machine + '[input]\nwave = "square"\n', "utf-8")
    with pytest.raises(InputError, match=r"\[input\] has no place with an actuator"):
        read_sweep(tmp_path / "sweep.toml")


BAD = [
    (
        'wire.diameter = ["0.14 mm", "0.2 mm"]',
        'wire.diameter = ["0.2 mm", "0.2 mm"]',
        "parameters.wire.diameter: the range from '0.2 mm' to '0.2 mm' is empty",
    ),
    ('wire.diameter = ["0.14 mm", "0.2 mm"]', 'wire.diameter = ["0.14 mm"]', "is not a range"),
    (
        'wire.diameter = ["0.14 mm", "0.2 mm"]',
        'wire.diameter = ["0.14 A", "0.2 mm"]',
        "parameters.wire.diameter: '0.14 A': the unit 'A' does not fit",
    ),
    (
        "wire.diameter",
        "wire.diametre",
        "parameters.wire.diametre is not a parameter of this rig (did you mean 'wire.diameter'?)",
    ),
    ('from = "100 g"', 'from = "0 g"', "a log scale cannot begin at '0 g'"),
    ('rig = "rig.toml"', 'rig = "rigg.toml"', "there is no such file (did you mean 'rig.toml'?)"),
    ("designs = 130", 'designs = "many"', "sweep.designs = 'many' is not a whole number"),
    ("designs = 130", "desings = 130", "sweep.desings is not known (did you mean 'designs'?)"),
    ('wave = "square"', 'wave = "sqare"', "is not known (did you mean 'square'?)"),
    ('frequency = "0.5 Hz"', "", "input.frequency is missing"),
    ('stroke = "max"', 'stroke = "most"', "objectives.stroke = 'most' is not known"),
    ('stroke = "max"', 'strok = "max"', "objectives.strok is not a metric (did you mean 'stroke'?)"),
    (
        '{ at_most = "120 degC" }',
        '{ at_least = "130 degC", at_most = "120 degC" }',
        "nothing is at least '130 degC' and at most '120 degC'",
    ),
    ('peak_temperature = { at_most = "120 degC" }', 'stroke = { at_most = "-1 mm" }', "can never be kept"),
    ('peak_temperature = { at_most = "120 degC" }', "stroke = {}", "constraints.stroke has no bound"),
    ("[constraints]", "[constraint]", "[constraint] is not a section of a sweep (did you mean 'constraints'?)"),
    ('"time_to_cool"]', '"bandwidth"]', "input.highest is missing"),
    (
        '"time_to_cool"]\n[parameters]',
        '"bandwidth"]\n[parameters]\ninput.frequency = ["1 Hz", "6 Hz"]',
        "input.highest = 4 Hz is not above the range of input.frequency, which ends at 6 Hz",
    ),
    ("designs = 130", 'designs = 130\nsampling = "grid"', "sweep.designs has no place with a grid"),
    ('from = "100 g"', 'points = 3, from = "100 g"', "parameters.load.mass.points is of a grid only"),
    (
        'load.mass = { from = "100 g", to = "300 g", scale = "log" }',
        'load.mass = { values = ["100 g"], scale = "log" }',
        "scale has no place next to values",
    ),
    (
        'at_most = "120 degC"',
        'at_most = "19 degC"',
        "at_most = '19 degC' can never be kept, as it is never below 20 degC",
    ),
    (
        'peak_temperature = { at_most = "120 degC" }',
        'efficiency = { at_least = "101 %" }',
        "can never be kept, as it is never above 1",
    ),
    (
        "designs = 130",
        "designs = 130\nsensitivity = true",
        "sweep.sensitivity needs at least 640 designs with 3 parameters",
    ),
    (
        'amplitude = "0.3 A"',
        'amplitude = "0 A"',
        "input.amplitude = '0 A' is not possible: give one above 0, up to 50 A, since nothing else",
    ),
    (
        'input.amplitude = ["0.2 A", "0.4 A"]',
        'input.amplitude = { values = ["0 A"] }',
        "parameters.input.amplitude is 0 throughout",
    ),
    ("[objectives]", 'duty = "150 %"\n[objectives]', "input.duty = '150 %' is not possible"),
    (
        "load.mass = {",
        '"wire.diameter" = ["0.1 mm", "0.2 mm"]\nload.mass = {',
        'parameters.wire.diameter is given twice, as wire.diameter and as "wire.diameter"',
    ),
    (
        'wire.diameter = ["0.14 mm", "0.2 mm"]',
        "wire.diameter = { values = [] }",
        "parameters.wire.diameter: its list of values is empty",
    ),
]


@pytest.mark.parametrize(("old", "new", "sentence"), BAD)
def test_bad_sweeps_say_what_is_wrong(folder, old, new, sentence):
    assert old in SWEEP
    text = SWEEP.replace(old, new)
    (folder / "sweep.toml").write_text(
        text.replace("[input]", '[input]\nhighest = "4 Hz"') if "highest =" in sentence else text, "utf-8"
    )
    with pytest.raises(InputError) as caught:
        read_sweep(folder / "sweep.toml")
    assert sentence in str(caught.value) and "sweep.toml" in str(caught.value) and "\n" not in str(caught.value)


def test_bands_that_would_cross_and_axes_that_do_nothing(folder):
    (folder / "sweep.toml").write_text(
        SWEEP.replace(
            "input.amplitude = [", 'material.martensite_finish = ["30 degC", "90 degC"]\ninput.amplitude = ['
        ),
        "utf-8",
    )
    with pytest.raises(
        InputError, match=r"material.martensite_finish up to 90 degC does not stay below material.martensite_start"
    ):
        read_sweep(folder / "sweep.toml")
    rotary = ROOT / "data" / "recordings" / "rotary" / "rig.toml"
    (folder / "rig.toml").write_text(rotary.read_text("utf-8"), "utf-8")
    (folder / "sweep.toml").write_text(
        SWEEP.replace(
            'load.mass = { from = "100 g", to = "300 g", scale = "log" }',
            'pulley.inertia = ["1e-6 kg m^2", "2e-6 kg m^2"]',
        ),
        "utf-8",
    )
    assert not float(parameters.get(read_rig(rotary).plant, "pulley.inertia"))
    with pytest.raises(InputError, match=r"pulley.inertia has no effect while the rig has neither inertia nor damping"):
        read_sweep(folder / "sweep.toml")


def test_an_unreachable_scheduler(folder, monkeypatch):
    from smajax.sweeps import dask as cluster

    monkeypatch.setattr(cluster, "_TIMEOUT", 1)
    for address, why in (("tcp://127.0.0.1:9", "Connection refused"), ("foo", "missing port number")):
        with pytest.raises(InputError, match=rf"--scheduler {address}: no Dask scheduler answers there \(.*{why}"):
            run(folder, scheduler=address)
        assert not (folder / "out.partial").exists()
    with pytest.raises(
        InputError, match="--scheduler is empty: give a Dask scheduler's address, like tcp://host:8786, or local"
    ):
        run(folder, scheduler="")
    assert run(folder, resume=True).code == 0


@contextlib.contextmanager
def _greeting(words: bytes | None):
    """The address of a server that says some words to whoever calls, or, with ``None``, nothing."""
    with socket.create_server(("127.0.0.1", 0)) as server:
        callers = []

        def serve():
            with contextlib.suppress(OSError):
                while True:
                    caller, _ = server.accept()
                    callers.append(caller)
                    if words is not None:
                        caller.sendall(words)

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        yield f"tcp://127.0.0.1:{server.getsockname()[1]}"
        server.shutdown(socket.SHUT_RDWR)
    thread.join()
    for caller in callers:
        caller.close()


@pytest.mark.parametrize(
    ("words", "why"),
    [
        (None, "it sends nothing for 1 s"),
        (b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n", "what answers does not speak Dask's protocol"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "what answers does not speak Dask's protocol"),
        (bytes(64), "what answers does not speak Dask's protocol"),
    ],
)
def test_what_answers_and_is_no_scheduler(folder, monkeypatch, words, why):
    from smajax.sweeps import dask as cluster

    monkeypatch.setattr(cluster, "_TIMEOUT", 1)
    with _greeting(words) as address, pytest.raises(InputError) as caught:
        run(folder, scheduler=address)
    assert f"--scheduler {address}: no Dask scheduler answers there ({why}): check its address" in str(caught.value)


def test_a_scheduler_is_known_by_its_answer():
    import distributed

    from smajax.sweeps import dask as cluster

    for address in ("http://127.0.0.1:9", "inproc://x", "ucx://x:1"):
        with pytest.raises(ValueError, match="begins with tcp:// or tls://, not with"):
            cluster._open_connection(address)
    quiet = {"dashboard_address": None, "silence_logs": "ERROR"}
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", **quiet
    ) as there:
        cluster._check_identity(there.scheduler_address)
        with cluster.connected(there.scheduler_address) as client:
            assert client.submit(int, "7").result() == 7
        with pytest.raises(ValueError, match="it is the address of a worker"):
            cluster._check_identity(there.workers[0].address)


def test_workers_that_are_missing_or_others():
    from smajax import __version__
    from smajax.sweeps import dask as cluster

    class Client:
        def __init__(self, workers, there=True):
            self.workers, self.there = workers, there

        def wait_for_workers(self, count, timeout):
            if not self.there:
                raise TimeoutError

        def run(self, function, *given, on_error):
            return self.workers

        def run_on_scheduler(self, function, *given):
            return function(*given)

    cases = [
        (Client({}, False), "it has no workers: start some (dask worker tcp://x)"),
        (Client({"a": None}), "worker a has no smajax"),
        (Client({"a": ModuleNotFoundError()}), "worker a has no smajax"),
        (Client({"a": __version__, "b": "0.0.1"}), f"worker b has smajax 0.0.1, and this is {__version__}"),
    ]
    for client, sentence in cases:
        with pytest.raises(InputError) as caught:
            cluster._check_workers(client, "tcp://x")
        assert sentence in str(caught.value)
    cluster._check_workers(Client({"a": __version__}), "tcp://x")
    # Where there is no smajax, the question is answered all the same.
    bare = subprocess.run(
        [sys.executable, "-I", "-S", "-c", f"print(eval({cluster._VERSION!r}))"],
        capture_output=True,
        text=True,
        cwd="/",
    )
    assert bare.stdout.strip() == "None" and eval(cluster._VERSION) == __version__
    with pytest.raises(InputError, match="a worker has smajax"):
        cluster._problem(json.dumps({"smajax": "0.0.1"}))


KNEE = """
[sweep]
rig = "knee.toml"
designs = 32
metrics = ["spring_torque"]
[parameters]
wire.diameter = ["0.8 mm", "1.2 mm"]
command.second = ["3 V", "5.5 V"]
[objectives]
heating_time = "max"
[refine]
starts = 1
"""


def test_infinite_figures_are_values_with_an_order(tmp_path, monkeypatch):
    """Springs that never warm have an infinite heating time: the design is done, keeps a lower limit, and is the longest of all."""

    def quick(self):  # without the motion, whose program takes long to compile
        return {"heating_time": self.heating_time(self.command.second), "spring_torque": self.wire.prestretch}

    monkeypatch.setattr(Knee, "metrics", quick)
    machine = (ROOT / "data" / "actuators" / "knee" / "rig.toml").read_text("utf-8")
    (tmp_path / "knee.toml").write_text(machine, "utf-8")
    (tmp_path / "sweep.toml").write_text(KNEE + '[constraints]\nheating_time = { at_least = "5 s" }\n', "utf-8")
    outcome = run(tmp_path)
    columns = read_table(tmp_path / "out" / "sweep.parquet")
    endless = np.isinf(columns["heating_time"])
    assert endless.any() and not endless.all() and set(columns["code"]) == {"done"}
    document = outcome.document
    assert document["feasible"] == np.sum(columns["heating_time"] >= 5.0) and document["on_front"] == endless.sum()
    assert {row["metrics"]["heating_time"] for row in document["front"]} == {
        "inf"
    } and "heating_time of these is infinite" in document["summary"]
    # The other way round the finite ones are best, and an infinite one is beyond any upper limit.
    (tmp_path / "sweep.toml").write_text(
        KNEE.replace('"max"', '"min"') + '[constraints]\nheating_time = { at_most = "1e9 s" }\n', "utf-8"
    )
    document = run(tmp_path, "other").document
    assert document["feasible"] == np.sum(~endless) and document["on_front"] == 1
    assert float(document["front"][0]["metrics"]["heating_time"]) == columns["heating_time"].min()
    assert document["refined"][0]["better"]
    costs = np.array([[np.inf, 0.0], [-np.inf, 1.0], [0.0, 1.0], [0.0, np.nan]])
    assert np.array_equal(pareto_front(costs), [0, 1])


def test_a_search_from_or_to_what_is_infinite():
    class Problem:
        names, units, shared_steps = ("a",), {"slow": "s", "size": "m"}, staticmethod(lambda design: 1)

    def answer(problem, designs, steps):
        a = float(designs[0, 0])
        found = {"slow": np.inf if a > 0.5 else a, "size": a}
        slopes = {"slow": [0.0 if a > 0.5 else 1.0], "size": [1.0]}
        return {n: [v] for n, v in found.items()}, {n: np.array([v]) for n, v in slopes.items()}, None

    axes = (Axis("a", "1", 0.0, 1.0),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        one = refine(Problem, axes, np.array([0.9]), {"size": "max"}, {"slow": (0.7, np.inf)})
        assert one.better and one.metrics["size"] == 1.0
        least = refine(Problem, axes, np.array([0.4]), {"size": "max"}, {"slow": (-np.inf, 0.45)})
        assert least.better and least.metrics["size"] == pytest.approx(0.45, abs=1e-5)
        most = refine(Problem, axes, np.array([0.4]), {"slow": "max"}, {})
        assert most.better and most.metrics["slow"] == np.inf
        assert not refine(Problem, axes, np.array([0.9]), {"slow": "max"}, {}).better


def test_what_is_refined_is_better_on_steps_that_resolve_it():
    """On the start's steps a fast design seems colder than it is, and its other objective better."""

    class Problem:
        names, units = ("a",), {"size": "m", "hot": "degC", "cost": "1"}
        shared_steps = staticmethod(lambda design: 1 if design[0] < 0.3 else 2 if design[0] < 0.6 else 4)

    def answer(problem, designs, steps):
        a = float(designs[0, 0])
        seen = {1: 0.5, 2: 0.7, 4: 1.0}[steps]
        found, slopes = {"size": a, "hot": seen * a, "cost": 1.0 - a}, {"size": 1.0, "hot": seen, "cost": -1.0}
        return {n: [v] for n, v in found.items()}, {n: np.array([[v]]) for n, v in slopes.items()}, None

    axes = (Axis("a", "1", 0.0, 1.0),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        one = refine(Problem, axes, np.array([0.1]), {"size": "max", "cost": "min"}, {"hot": (-np.inf, 0.8)})
        assert one.better and one.metrics["hot"] == one.design[0] == pytest.approx(0.8, abs=1e-5)
        # One that seems better on coarse steps alone is not called so.
        patch.setattr(Problem, "shared_steps", staticmethod(lambda design: 1 if design[0] < 0.79 else 4))
        one = refine(Problem, axes, np.array([0.78]), {"size": "max"}, {"hot": (-np.inf, 0.6)})
        assert not one.better and one.design[0] == 0.78


def test_counts_are_whole_drawn_and_refined(folder):
    count = Axis("n", "1", 2.0, 5.0, whole=True)
    drawn = count.at(np.linspace(0.0, 1.0, 4001))
    assert np.array_equal(np.unique(drawn), [2, 3, 4, 5]) and np.ptp(np.bincount(drawn.astype(int))[2:]) <= 2
    assert np.array_equal(replace(count, points=20).grid(), [2, 3, 4, 5])
    assert set(replace(count, log=True).at(np.linspace(0.0, 1.0, 99))) == {2.0, 3.0, 4.0, 5.0}

    class Problem:
        names, units, shared_steps = ("n", "a"), {"size": "m", "cost": "1"}, staticmethod(lambda design: 1)

    def answer(problem, designs, steps):  # best at n = 3.6, a = 0.5 / n
        n, a = (float(v) for v in designs[0])
        found = {"size": 10.0 - (n - 3.6) ** 2 - (n * a - 0.5) ** 2, "cost": n + a}
        slopes = {"size": [-2.0 * (n - 3.6) - 2.0 * a * (n * a - 0.5), -2.0 * n * (n * a - 0.5)], "cost": [1.0, 1.0]}
        return {m: [v] for m, v in found.items()}, {m: np.array([v]) for m, v in slopes.items()}, None

    axes = (count, Axis("a", "1", 0.0, 1.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        one = refine(Problem, axes, np.array([2.0, 0.9]), {"size": "max"}, {})
        assert one.better and one.design[0] == 4.0 and one.design[1] == pytest.approx(0.125, abs=1e-3)
        # Where the rounded count is beyond a limit, the count stays, and the rest is refined.
        least = refine(Problem, axes, np.array([3.0, 0.5]), {"size": "max"}, {"cost": (0.0, 3.9)})
        assert least.better and least.design[0] == 3.0 and least.design[1] == pytest.approx(1.0 / 6.0, abs=1e-3)
    flexural = (
        (ROOT / "data" / "sweeps" / "flexural.toml")
        .read_text("utf-8")
        .replace("../actuators", str(ROOT / "data" / "actuators"))
    )
    (folder / "sweep.toml").write_text(flexural, "utf-8")
    assert set(read_sweep(folder / "sweep.toml").designs()[:, 1]) == set(range(2, 13))
    for text, sentence in (
        ('["2.2", "3.8"]', "there are no two whole numbers"),
        ('{ values = ["2.5"] }', "'2.5' is not a whole number"),
    ):
        (folder / "sweep.toml").write_text(flexural.replace('["2", "12"]', text), "utf-8")
        with pytest.raises(InputError) as caught:
            read_sweep(folder / "sweep.toml")
        assert sentence in str(caught.value)


def test_a_thinned_front_keeps_the_best_of_each_objective():
    rng = np.random.default_rng(0)
    angle = np.sort(rng.random(1000)) * np.pi / 2
    costs = -np.column_stack([np.cos(angle), np.sin(angle)])[rng.permutation(1000)]
    rows = thin_front(costs, 200)
    assert (
        len(rows) <= 202
        and set(np.argmin(costs, axis=0)) <= set(rows)
        and np.array_equal(thin_front(costs, 1000), np.arange(1000))
    )
    entries = [
        {"design": int(k), "parameters": {}, "metrics": {"a": float(-costs[k, 0]), "b": float(-costs[k, 1])}}
        for k in rows
    ]
    document = {"front": entries, "objectives": {"a": "max", "b": "max"}, "parameters": {}, "refined": []}
    document["metrics"] = {"a": {"unit": "1"}, "b": {"unit": "1"}}
    labels = [row[0] for row in best_rows(document)]
    assert {f"design {k}" for k in np.argmin(costs, axis=0)} <= set(labels)
