"""Sweeps: designs, metrics against the exact reference, derivatives, the command, and interrupted runs."""

import contextlib
import errno
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
from collections.abc import Callable
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
from smajax.api.sweep import sweep
from smajax.app.cli import app
from smajax.errors import InputError
from smajax.files import actuator_file
from smajax.files.rig_file import read_rig
from smajax.report.sweep import best_rows, sweep_summary
from smajax.sweeps import checkpoint, chunks, compilation, evaluation, space
from smajax.sweeps.bandwidth import FrequencyPoint, find_bandwidth
from smajax.sweeps.checkpoint import checkpoint_folder
from smajax.sweeps.chunks import derivative_column
from smajax.sweeps.compilation import evaluate_batch
from smajax.sweeps.excitation import Excitation, discretise_excitation, grid_parts
from smajax.sweeps.metrics import METRICS, Response, bandwidth
from smajax.sweeps.pareto import pareto_front, thin_front
from smajax.sweeps.problem import AbstractSweepProblem
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
limits = "none"
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


class StubProblem(AbstractSweepProblem):
    """Problem without a simulation; tests replace ``evaluation.differentiate_batch`` by their own metrics."""

    metric_units: dict[str, str] = eqx.field(static=True)
    steps_of: Callable[[np.ndarray], int] = eqx.field(static=True, default=lambda design: 1)

    @property
    def units(self):
        return self.metric_units

    def steps(self, designs):
        return np.array([self.steps_of(design) for design in designs])

    def shared_steps(self, design):
        return self.steps_of(design)

    def evaluate(self, design, steps, differentiable=False):
        raise NotImplementedError


def run(folder, out="out", **options):
    return sweep(folder / "sweep.toml", folder=folder / out, **options)


def test_designs_cover_the_space():
    axes = (
        Axis("a", "m", 1.0, 3.0),
        Axis("b", "m", 1e-3, 1.0, log=True),
        Axis("c", "1", 1.0, 5.0, values=(1.0, 5.0, 2.0)),
    )
    grid = space.draw_designs(axes[:2], "grid", 0, 0)
    assert grid.shape == (25, 2) and np.allclose(np.unique(grid[:, 1]), np.geomspace(1e-3, 1.0, 5))
    assert np.array_equal(np.unique(space.draw_designs(axes[2:], "grid", 0, 0)), [1.0, 2.0, 5.0])
    for sampling in ("latin-hypercube", "sobol"):
        designs = space.draw_designs(axes, sampling, 64, 3)
        assert np.array_equal(designs, space.draw_designs(axes, sampling, 64, 3)) and not np.array_equal(
            designs, space.draw_designs(axes, sampling, 64, 4)
        )
        # Each of 64 equal parts of each axis holds one design.
        for k, axis in enumerate(axes[:2]):
            assert np.array_equal(np.sort((axis.share(designs[:, k]) * 64).astype(int)), np.arange(64))
        assert set(designs[:, 2]) == {1.0, 5.0, 2.0}
    share = np.linspace(0.0, 1.0, 7)
    for axis in axes[:2]:
        assert np.allclose(axis.share(axis.at(share)), share, atol=1e-14)


@settings(deadline=None, max_examples=50)
@given(st.integers(0, 2**31), st.integers(1, 60), st.integers(1, 3))
def test_pareto_front_has_all_nondominated_designs(seed, count, size):
    costs = np.random.default_rng(seed).integers(0, 6, (count, size)).astype(float)
    costs[np.random.default_rng(seed + 1).random(count) < 0.1] = np.nan
    dominated = [any(np.all(b <= a) and np.any(b < a) for b in costs) or np.isnan(a).any() for a in costs]
    assert np.array_equal(pareto_front(costs), np.flatnonzero(~np.array(dominated)))


def test_sobol_indices_of_ishigamis_function():
    axes = tuple(Axis(n, "1", -np.pi, np.pi) for n in "xyz")

    def ishigami(x):
        return np.sin(x[0]) + 7.0 * np.sin(x[1]) ** 2 + 0.1 * x[2] ** 4 * np.sin(x[0])

    designs = space.pick_and_freeze(axes, 4096, 0)
    indices = sobol_indices(ishigami(designs.T), "xyz", 0)
    assert np.allclose([indices[n].first for n in "xyz"], [0.3139, 0.4424, 0.0], atol=0.01)
    assert np.allclose([indices[n].total for n in "xyz"], [0.5576, 0.4424, 0.2437], atol=0.01)
    assert all(
        index.first95[0] <= index.first <= index.first95[1] and index.total95[0] <= index.total <= index.total95[1]
        for index in indices.values()
    )
    reference = scipy_sobol_indices(
        func=lambda x: ishigami(x)[None], n=4096, dists=[uniform(-np.pi, 2 * np.pi)] * 3, rng=np.random.default_rng(0)
    )
    assert np.allclose([indices[n].total for n in "xyz"], reference.total_order.ravel(), atol=0.01)
    # Only rows with a failed design are left out.
    incomplete = ishigami(designs.T)
    incomplete[np.random.default_rng(1).integers(0, len(incomplete), 50)] = np.nan
    remaining = sobol_indices(incomplete, "xyz", 0)
    assert all(
        remaining[n].total == pytest.approx(indices[n].total, abs=0.02) and remaining[n].total != indices[n].total
        for n in "xyz"
    )
    assert 4046 <= np.sum(complete_rows(incomplete, 3)) < 4096
    infinite = np.where(np.arange(len(incomplete)) == 7, np.inf, incomplete)
    for values, reason in (
        (np.ones(200), "does not vary"),
        (infinite, "infinite"),
        (np.full(200, np.nan), "only 0 rows have a value in all their designs"),
    ):
        assert sobol_indices(values, "xyz", 0) == {} and reason in missing_reason(values, 3)


def test_bandwidth_of_a_low_pass():
    frequencies = jnp.geomspace(0.1, 10.0, 400)
    low_pass = 1.0 / jnp.sqrt(1.0 + (frequencies / 2.0) ** 2)
    expected = 2.0 * np.sqrt(1.0 / (0.5 * float(low_pass[0]) ** 2) - 1.0)
    assert float(bandwidth(frequencies, low_pass)) == pytest.approx(expected, rel=1e-4)
    assert np.isinf(float(bandwidth(frequencies, jnp.ones(400))))
    assert np.isnan(float(bandwidth(frequencies, jnp.full(400, jnp.nan))))


def test_bandwidth_between_scan_frequencies_and_its_derivatives():
    def low_pass(tau, frequency):  # a steep fall, which linear interpolation between a few frequencies would miss
        return FrequencyPoint(jnp.exp(-((frequency * tau) ** 8)), frequency, jnp.asarray(0))

    def of(tau, lowest, highest=10.0):
        constant = jax.lax.stop_gradient(tau)
        return find_bandwidth(
            lambda frequency: low_pass(constant, frequency), lowest, highest, lambda frequency: low_pass(tau, frequency)
        )[0]

    for tau, lowest in ((0.5, 0.1), (0.3, 0.2), (0.9, 0.05)):
        exact = lambda tau, lowest: (0.5 * np.log(2.0) + (lowest * tau) ** 8) ** 0.125 / tau  # noqa: E731
        value, slopes = jax.jit(jax.value_and_grad(of, (0, 1)))(tau, lowest)
        assert float(value) == pytest.approx(exact(tau, lowest), rel=1e-4)
        assert float(slopes[0]) == pytest.approx(-float(value) / tau, rel=2e-2) and abs(float(slopes[1])) < 1e-3
        plain = find_bandwidth(lambda frequency, tau=tau: low_pass(tau, frequency), jnp.asarray(lowest), 10.0)
        assert float(plain[0]) == pytest.approx(float(value), rel=1e-9) and float(plain[1]) == pytest.approx(
            float(value), rel=2e-2
        )
    assert np.isinf(float(of(0.5, jnp.asarray(0.1), 1.0)))


@pytest.mark.slow
def test_bandwidth_of_a_rig_against_dense_frequencies():
    plant, wave = read_rig(RIG).plant, Excitation("square", 0.3, 0.1, 0.5, 2)
    problem = RigSweepProblem(("heat.h0", "input.amplitude"), plant, ("bandwidth", "settling"), wave, 2, "hold", 2.0)
    metrics, codes = evaluate_batch(problem, jnp.asarray([[90.0, 0.3], [90.0, 1e-4]]), 100)
    assert np.isnan(metrics["bandwidth"][1])  # a wire that stays cold does not move, and has no bandwidth
    each = RigSweepProblem(("heat.h0", "input.frequency"), plant, ("stroke", "settling"), wave, 2, "hold", 0.0)
    dense = np.sort(
        np.concatenate([np.geomspace(0.1, 2.0, 40), float(metrics["bandwidth"][0]) * np.linspace(0.97, 1.03, 31)])
    )
    dense_metrics, _ = evaluate_batch(each, jnp.asarray(np.column_stack([np.full(len(dense), 90.0), dense])), 100)
    first = int(np.argmax(dense_metrics["stroke"] <= dense_metrics["stroke"][0] / np.sqrt(2.0)))
    assert not np.any(codes) and dense[first - 1] * 0.999 <= float(metrics["bandwidth"][0]) <= dense[first] * 1.001
    # The response at the bandwidth has a larger settling gap than that at the low frequency.
    assert metrics["settling"][0] > max(
        float(dense_metrics["settling"][0]), 0.5 * float(dense_metrics["settling"][first - 1])
    )


@pytest.mark.slow
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


def test_summary_of_refined_designs():
    """It compares the refined designs with the best sampled one, and says whether they have settled."""

    def refined(stroke, better):
        return {"better": better, "simulations": 30, "metrics": {"stroke": stroke}, "parameters": {}}

    def summary(refined, settling=None):
        best = {"design": 3, "parameters": {}, "metrics": {"stroke": 2e-3}}
        document = {
            "designs": 9,
            "rig": "rig.toml",
            "codes": {"done": 9},
            "constraints": {},
            "objectives": {"stroke": "max"},
        }
        document |= {"front": [best], "on_front": 1, "metrics": {"stroke": {"unit": "m"}}, "problems": []}
        document["parameters"] = {}
        document["parameters"] = {}
        return sweep_summary(document | {"refined": refined, "settling": settling or {}})

    gained = summary([refined(1.9e-3, True), refined(3e-3, True)])
    assert gained.endswith("2 mm, with design 3. With gradient-based refinement it is 3 mm, in 60 simulations.")
    assert summary([refined(1.9e-3, True)]).endswith("it is 1.9 mm, in 30 simulations, which is not better.")
    none = summary([refined(2e-3, False)])
    assert none.endswith("with design 3. Gradient-based refinement found no better design, in 30 simulations.")
    assert summary([]).endswith("with design 3.")
    still = {
        "designs": 9,
        "rig": "rig.toml",
        "codes": {"done": 9},
        "constraints": {},
        "objectives": {"stroke": "max"},
        "refined": [],
    }
    still |= {"front": [], "metrics": {"stroke": {"unit": "m", "lowest": 0.0, "highest": 0.0}}, "problems": []}
    assert sweep_summary(still).endswith(
        "The parameters do not change stroke, so no design is better than another in it."
    )
    moving = {"limit": 0.01, "unsettled": 0, "unsettled_on_front": 0, "unsettled_refined": 1}
    assert " 1 refined one has not settled: start and end of the last cycle differ by more than 1 %" in summary(
        [refined(3e-3, True)], moving
    )
    both = summary([], moving | {"unsettled": 5, "unsettled_on_front": 1, "unsettled_refined": 2})
    assert (
        " 5 designs have not settled (1 of the best among them), and 2 refined ones have not settled: start and end"
        in both
    )


@pytest.mark.slow
def test_a_refined_wire_that_still_warms_up_is_counted(folder):
    text = SWEEP.replace('frequency = "0.5 Hz"', 'frequency = "6 Hz"').replace("designs = 130", "designs = 20")
    (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 1\n", "utf-8")
    document = run(folder).document
    (refined,) = document["refined"]
    assert refined["better"] and refined["metrics"]["settling"] > 0.01
    assert document["settling"]["unsettled_refined"] == 1 and "1 refined one has not settled" in document["summary"]


def test_edges_of_waves_are_grid_points():
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


@pytest.mark.slow
def test_time_to_cool_through_a_sheath(tmp_path):
    """With a constant h, wire and liner are a linear system. Without heating, or if the wire cools too little, there is no such time."""
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
    times = chunks.evaluate_designs(problem, designs, int(problem.steps(designs).max()))["time_to_cool"]
    area, volume = np.pi * 0.38e-3 * 0.9, np.pi / 4 * 0.38e-3**2 * 0.9
    own = 5.4e6 * volume / (120.0 * area)  # the wire's time constant
    for (conduction, lag), cooling in zip(designs, times, strict=True):
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
    """Excess temperatures of wire and liner after 15 s of heating, 35 s of cooling, and 15 s of heating."""
    first = steady - expm(15.0 * rates) @ steady
    return steady + expm(15.0 * rates) @ (expm(35.0 * rates) @ first - steady)


def test_few_programs_for_many_step_numbers():
    few = np.array([40, 50, 900])
    assert np.array_equal(group_steps(few), [900, 900, 900])
    many = np.concatenate([np.full(50_000, 40), np.full(10, 1000)])
    steps = group_steps(many)
    assert np.all(steps >= many) and set(steps) == {40, 1000}


def test_batches_fit_into_memory(folder):
    problem = read_sweep(folder / "sweep.toml").problem()
    assert (compilation.batch_size(problem, 40, False), compilation.batch_size(problem, 40, True)) == (64, 32)
    long = compilation.batch_size(problem, 10**6, False)
    assert 1 <= long < 8 and long * 8 * problem.numbers(10**6) <= compilation.MEMORY
    assert compilation.batch_size(problem, 10**4, True) < compilation.batch_size(problem, 10**4, False)


def test_an_accelerators_batch_takes_several_chunks(folder, monkeypatch):
    sweep = read_sweep(folder / "sweep.toml")
    problem, parts = sweep.problem(), chunks.split_into_chunks(sweep.problem(), sweep.designs(), 20)
    assert [len(group) for group in chunks.group_chunks(problem, parts, False)] == [1] * 7
    narrow = {
        chunk.number: results for done in chunks.submit_locally(problem, False)(parts[:3]) for chunk, results in done
    }
    sizes = []

    def counted(problem, designs, steps):
        sizes.append(len(designs))
        return evaluate_batch(problem, designs, steps)

    monkeypatch.setattr(compilation, "on_accelerator", lambda: True)
    monkeypatch.setattr(compilation, "evaluate_batch", counted)
    assert [len(group) for group in chunks.group_chunks(problem, parts, False)] == [7]
    together = {
        chunk.number: results for done in chunks.submit_locally(problem, False)(parts[:3]) for chunk, results in done
    }
    # 60 designs in one batch of 64, not three of 16384.
    assert sizes == [64] and together.keys() == narrow.keys()
    for number, results in together.items():
        assert all(
            np.array_equal(v, narrow[number][n]) if n == "code" else np.allclose(v, narrow[number][n], rtol=1e-9)
            for n, v in results.items()
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


@pytest.mark.slow
def test_two_devices_agree_with_one(folder):
    environment = {**os.environ, "PYTHONPATH": str(ROOT), "EQX_ON_ERROR": "off"}
    call = [sys.executable, "-c", TWO, str(folder / "sweep.toml"), str(folder / "two.npz")]
    done = subprocess.run(call, env=environment, capture_output=True, text=True)
    assert done.returncode == 0, done.stderr
    sweep, two = read_sweep(folder / "sweep.toml"), np.load(folder / "two.npz")
    single = chunks.evaluate_designs(sweep.problem(), sweep.designs()[:64], 40)
    assert all(
        np.array_equal(single[n], two[n]) if n == "code" else np.allclose(single[n], two[n], rtol=1e-12) for n in single
    )


@pytest.mark.slow
def test_metrics_agree_with_the_exact_reference(folder):
    """Stroke, temperature, energy and work of the last cycle, and the time to cool, from a simulator that shares no code."""
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs = sweep.problem(), sweep.designs()[:4]
    metrics = chunks.evaluate_designs(problem, designs, 300)
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
        assert metrics["stroke"][k] == pytest.approx(np.ptp(exact.position[cycle]), rel=2e-3, abs=2e-6)
        assert metrics["peak_temperature"][k] == pytest.approx(exact.temperature.max(), abs=0.05)
        assert metrics["force"][k] == pytest.approx(mass * 9.81, rel=1e-6) and metrics["peak_stress"][
            k
        ] == pytest.approx(mass * 9.81 / area, rel=1e-6)
        energy = np.sum((exact.resistance[:, 0] * current**2)[cycle][:-1]) * 0.01
        assert metrics["energy_per_cycle"][k] == pytest.approx(energy, rel=3e-3)
        lifted = np.sum(np.maximum(np.diff(exact.position[cycle]), 0.0)) * mass * 9.81
        assert metrics["work_per_cycle"][k] == pytest.approx(lifted, rel=5e-3, abs=1e-6)
        assert metrics["efficiency"][k] == pytest.approx(lifted / energy, rel=1e-2, abs=1e-6)
        excess = exact.temperature[rest, 0] - 20.0
        cooled = 0.01 * np.interp(-0.1 * excess[0], -excess, np.arange(len(excess)))
        assert metrics["time_to_cool"][k] == pytest.approx(cooled, rel=5e-3)


@pytest.mark.slow
def test_derivatives_of_every_metric(folder):
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs, steps = sweep.problem(), sweep.designs()[:16], 40
    columns = chunks.evaluate_designs(problem, designs, steps, gradients=True)
    plain = chunks.evaluate_designs(problem, designs, steps)
    for name in problem.units:
        assert np.allclose(columns[name], plain[name], rtol=1e-9)
    for k, axis in enumerate(problem.names):
        size = 1e-5 * designs[:, k]
        ends = []
        for sign in (1.0, -1.0):
            moved = designs.copy()
            moved[:, k] += sign * size
            ends.append(chunks.evaluate_designs(problem, moved, steps))
        for name in problem.units:
            difference = (ends[0][name] - ends[1][name]) / (2.0 * size)
            slope = columns[derivative_column(name, axis)]
            scale = np.abs(plain[name] / designs[:, k])
            # An extreme may move from one grid point to another between the two ends, where a metric has a kink.
            assert np.mean(np.abs(slope - difference) <= 1e-4 * (np.abs(difference) + scale)) >= 0.9, (name, axis)


def test_the_recording_of_a_sweep_is_read_with_the_options_of_the_rig(folder):
    options = '[recording]\nskip_rows = 1\ndelimiter = ";"\ndecimal = ","\nsample_period = "20 ms"\n'
    (folder / "rig.toml").write_text(RIG.read_text("utf-8") + options, "utf-8")
    (folder / "in.csv").write_text("a title\ncurrent [A]\n0,1\n0,3\n0,2\n", "utf-8")
    text = SWEEP[: SWEEP.index("[input]")].replace("input.amplitude", "drive.gain")
    text = text.replace('["0.2 A", "0.4 A"]', '["0.9", "1.1"]').replace(', "time_to_cool"', "")
    (folder / "sweep.toml").write_text(text + '[input]\nrecording = "in.csv"\n', "utf-8")
    source = read_sweep(folder / "sweep.toml").subject.source
    assert source.time.tolist() == [0.0, 0.02, 0.04] and source.channels["current"].tolist() == [0.1, 0.3, 0.2]


@pytest.mark.slow
def test_frequency_as_an_axis_and_a_recording_as_input(folder):
    text = SWEEP.replace('input.amplitude = ["0.2 A", "0.4 A"]', 'input.frequency = ["0.2 Hz", "1 Hz"]').replace(
        "cycles = 2", 'cycles = 2\nhighest = "4 Hz"'
    )
    text = text.replace('"time_to_cool"]', '"bandwidth"]').replace("designs = 130", "designs = 8")
    (folder / "sweep.toml").write_text(text, "utf-8")
    sweep = read_sweep(folder / "sweep.toml")
    columns = chunks.evaluate_designs(sweep.problem(), sweep.designs(), 40)
    assert np.all(columns["code"] == "done") and np.all(columns["bandwidth"] > sweep.designs()[:, 2])
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
    recorded_sweep = read_sweep(folder / "sweep.toml")
    by_recording = chunks.evaluate_designs(recorded_sweep.problem(), recorded_sweep.designs(), 200)
    wave = RigSweepProblem(
        ("wire.diameter", "load.mass", "input.amplitude"),
        recorded_sweep.subject.rig.plant,
        recorded_sweep.metrics,
        Excitation("square", 0.3, 0.5, 0.5, 2),
        2,
        "hold",
        0.0,
    )
    by_wave, _ = evaluate_batch(wave, jnp.asarray(recorded_sweep.designs() * np.array([1.0, 1.0, 0.3])), 200)
    # The recording ends one row before the cycle does.
    assert np.allclose(by_recording["peak_temperature"], np.asarray(by_wave["peak_temperature"]), atol=1e-6)
    assert np.allclose(by_recording["stroke"], np.asarray(by_wave["stroke"]), rtol=1e-2, atol=1e-6)


@pytest.mark.slow
def test_refined_designs_keep_their_limits_and_beat_the_samples(folder):
    sweep = read_sweep(folder / "sweep.toml")
    problem, designs = sweep.problem(), sweep.designs()
    columns = chunks.evaluate_designs(problem, designs, 40)
    hot = columns["peak_temperature"]
    feasible = np.flatnonzero((hot <= 120.0) & (columns["energy_per_cycle"] <= 1.0))
    best = feasible[np.argmax(columns["stroke"][feasible])]
    limits = {"peak_temperature": (-np.inf, 120.0), "energy_per_cycle": (-np.inf, 1.0)}
    refined = refine(problem, sweep.axes, designs[best], {"stroke": "max"}, limits)
    assert refined.better and refined.metrics["stroke"] > 1.02 * refined.before["stroke"]
    again = chunks.evaluate_designs(problem, refined.design[None], problem.shared_steps(refined.design))
    assert again["stroke"][0] == pytest.approx(refined.metrics["stroke"], rel=1e-9)
    assert again["peak_temperature"][0] <= 120.0 and again["energy_per_cycle"][0] <= 1.0
    # 2,000 more designs do not have a better one.
    more = space.draw_designs(sweep.axes, "sobol", 2000, 5)
    drawn = chunks.evaluate_designs(problem, more, 40)
    fine = (drawn["peak_temperature"] <= 120.0) & (drawn["energy_per_cycle"] <= 1.0)
    assert refined.metrics["stroke"] > drawn["stroke"][fine].max() and refined.simulations < 500


def test_the_command_and_its_table(folder):
    outcome = run(folder)
    assert outcome.exit_code == 0 and outcome.reason == ""
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
        "No Sobol indices: they need at least 640 designs with 3 parameters." in page
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
    repeated = sweep(out / "sweep.parquet", folder=folder / "again")
    assert (
        repeated.exit_code == 0
        and (folder / "again" / "sweep.parquet").read_bytes() == (out / "sweep.parquet").read_bytes()
    )


def test_an_interrupted_sweep_is_resumed(folder, monkeypatch):
    run(folder, "whole")
    whole = (folder / "whole" / "sweep.parquet").read_bytes()
    written = []

    def fails(path, *arguments, **options):
        if len(written) == 3:
            raise KeyboardInterrupt
        written.append(path)
        return chunks_write(path, *arguments, **options)

    chunks_write = chunks.write_table
    monkeypatch.setattr(chunks, "write_table", fails)
    with pytest.raises(KeyboardInterrupt):
        run(folder)
    monkeypatch.setattr(chunks, "write_table", chunks_write)
    assert len(list((folder / "out.partial").glob("chunk-*.parquet"))) == 3 and not (folder / "out").exists()
    with pytest.raises(InputError, match=r"3 chunks of an earlier run are there: add --resume"):
        run(folder)
    (folder / "sweep.toml").write_text(SWEEP.replace('to = "300 g"', 'to = "310 g"'), "utf-8")
    with pytest.raises(InputError, match="belong to another sweep"):
        run(folder, resume=True)
    (folder / "sweep.toml").write_text(SWEEP, "utf-8")
    assert run(folder, resume=True).exit_code == 0
    assert (folder / "out" / "sweep.parquet").read_bytes() == whole


def test_a_finished_sweep_is_not_resumed(folder, monkeypatch):
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 20"), "utf-8")
    first = run(folder, resume=True)
    assert first.note == "there was nothing to resume, so all designs were simulated from the start"
    written = (folder / "out" / "run.json").read_bytes()
    with monkeypatch.context() as patch:
        patch.setattr("smajax.api.sweep.run_chunks", None)
        again = run(folder, resume=True)
    assert "since this sweep was finished: its result is unchanged" in again.note
    assert (
        again.document == json.loads((folder / "out" / "sweep.json").read_text("utf-8"))
        and again.exit_code == first.exit_code
    )
    assert (folder / "out" / "run.json").read_bytes() == written
    shown = CliRunner().invoke(app, ["sweep", str(folder / "sweep.toml"), "--out", str(folder / "out"), "--resume"])
    assert shown.exit_code == 0 and "smajax: there was nothing to resume, since" in shown.stderr
    # Where a file is missing, or the sweep is another one, it is simulated again.
    (folder / "out" / "report.html").unlink()
    assert "from the start" in run(folder, resume=True).note and (folder / "out" / "report.html").is_file()
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 21"), "utf-8")
    assert "from the start, and the earlier result" in run(folder, resume=True).note and run(folder).note == ""


def _command(folder, *more):
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    arguments = [
        sys.executable,
        "-m",
        "smajax",
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


@pytest.mark.slow
def test_a_killed_run_and_a_killed_worker_lose_no_design(folder):
    (folder / "sweep.toml").write_text(SWEEP.replace("chunk = 20", "chunk = 4"), "utf-8")
    run(folder, "whole")
    whole = (folder / "whole" / "sweep.parquet").read_bytes()

    def until_more_than(count: int, process: subprocess.Popen) -> int:
        while (
            process.poll() is None
            and (count_before := len(list((folder / "out.partial").glob("chunk-*.parquet")))) <= count
        ):
            time.sleep(0.01)
        assert process.poll() is None, "the run ended before it could be killed"
        return count_before

    process = _command(folder)
    until_more_than(0, process)
    os.killpg(process.pid, signal.SIGKILL)
    process.communicate()
    # Two workers continue; one of them is killed while they run.
    count_before = len(list((folder / "out.partial").glob("chunk-*.parquet")))
    process = _command(folder, "--resume", "--scheduler", "local")
    assert until_more_than(count_before, process) < 30  # of 33 chunks
    workers_of(process.pid)[0].kill()
    _, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors
    assert (folder / "out" / "sweep.parquet").read_bytes() == whole


@pytest.mark.slow
def test_a_killed_scheduler_is_reported_and_no_chunk_is_lost(folder):
    (folder / "sweep.toml").write_text(SWEEP.replace("chunk = 20", "chunk = 4"), "utf-8")
    run(folder, "whole")
    with socket.socket() as free:
        free.bind(("127.0.0.1", 0))
        address = f"127.0.0.1:{free.getsockname()[1]}"
    place = ["--host", "127.0.0.1", "--port", address.partition(":")[2], "--no-dashboard"]
    started = [[sys.executable, "-m", "distributed.cli.dask_scheduler", *place]]
    started.append([sys.executable, "-m", "distributed.cli.dask_worker", f"tcp://{address}", "--no-dashboard"])
    servers = [
        subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL, start_new_session=True)
        for words in started
    ]
    try:
        for _ in range(600):  # until the scheduler answers
            with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", int(address.partition(":")[2]))):
                break
            time.sleep(0.1)
        process = _command(folder, "--scheduler", f"tcp://{address}")
        while process.poll() is None and not list((folder / "out.partial").glob("chunk-*.parquet")):
            time.sleep(0.01)
        os.killpg(servers[0].pid, signal.SIGKILL)
        _, errors = process.communicate(timeout=400)
    finally:
        for server in servers:
            with contextlib.suppress(ProcessLookupError):
                os.killpg(server.pid, signal.SIGKILL)
            server.wait()
    assert process.returncode == 2, errors
    assert errors.splitlines()[-1] == (
        "smajax: the connection to the Dask scheduler is lost: start it again, and repeat the run with --resume"
    )
    assert list((folder / "out.partial").glob("chunk-*.parquet"))
    process = _command(folder, "--resume")
    _, errors = process.communicate(timeout=400)
    assert process.returncode == 0, errors
    whole, resumed = (folder / name / "sweep.parquet" for name in ("whole", "out"))
    assert resumed.read_bytes() == whole.read_bytes()


def test_lock_of_a_run_and_check_of_its_chunks(folder):
    text = SWEEP.replace("designs = 130", "designs = 40")
    (folder / "sweep.toml").write_text(text, "utf-8")
    sweep = read_sweep(folder / "sweep.toml")
    with checkpoint_folder(folder / "out", sweep.header(), resume=False) as partial:
        with pytest.raises(InputError, match=r"out.partial: another run is using it: wait until that run has ended"):
            run(folder, resume=True)
        parts = chunks.split_into_chunks(sweep.problem(), sweep.designs(), 20)
        for chunk in parts:
            results = chunks.evaluate_designs(sweep.problem(), chunk.designs, chunk.steps)
            write_table(partial / chunk.file, chunks.chunk_columns(chunk, AXES, results))
        shutil.copy(partial / parts[0].file, partial / parts[1].file)
    with pytest.raises(
        InputError, match=r"chunk-000001.parquet: its designs are not those of this chunk: remove the file"
    ):
        run(folder, resume=True)
    (partial / parts[1].file).unlink()
    outcome = run(folder, resume=True)
    assert outcome.exit_code == 0 and outcome.document["codes"] == {"done": 40}


@pytest.mark.parametrize("code", [errno.ENOLCK, errno.EOPNOTSUPP])
def test_a_file_system_without_locks_has_a_checkpoint_without_a_lock(folder, monkeypatch, code):
    def refuse(lock):
        raise OSError(code, os.strerror(code))

    monkeypatch.setattr(checkpoint.FileLock, "acquire", refuse)
    with checkpoint_folder(folder / "out", {}, resume=False) as partial:
        assert partial.is_dir()


def test_a_folder_that_cannot_be_locked_is_refused(folder, monkeypatch):
    def refuse(lock):
        raise PermissionError(errno.EACCES, os.strerror(errno.EACCES))

    monkeypatch.setattr(checkpoint.FileLock, "acquire", refuse)
    with (
        pytest.raises(
            InputError, match=r"out.partial/lock: this run cannot lock its folder \(Permission denied\): make"
        ),
        checkpoint_folder(folder / "out", {}, resume=False),
    ):
        pass
    assert not (folder / "out.partial").exists()
    (folder / "file").write_text("", "utf-8")
    with (
        pytest.raises(InputError, match=r"out.partial: the folder cannot be created \(Not a directory\): name another"),
        checkpoint_folder(folder / "file" / "out", {}, resume=False),
    ):
        pass


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
    assert run(folder, resume=True).exit_code == 0
    assert (folder / "out" / "sweep.parquet").read_bytes() == (folder / "whole" / "sweep.parquet").read_bytes()


def test_a_run_killed_before_its_first_file_is_resumed(folder):
    partial = folder / "out.partial"
    partial.mkdir()
    (partial / ".sweep.json.4711.part").write_text("{", "utf-8")
    (folder / "sweep.toml").write_text(SWEEP.replace("designs = 130", "designs = 20"), "utf-8")
    assert run(folder, resume=True).exit_code == 0
    partial.mkdir()
    (partial / "notes.part").write_text("mine", "utf-8")
    with pytest.raises(InputError, match="chunks of a sweep belong there, but smajax did not create it"):
        run(folder, resume=True)


def test_a_table_without_the_header_of_a_sweep(tmp_path):
    path = tmp_path / "table.parquet"
    for header in (None, {}, {"sweep": "", "rig": ""}):
        write_table(path, {"design": np.arange(3)}, header)
        with pytest.raises(InputError, match="not a table that smajax sweep wrote"):
            read_sweep(path)


def test_a_table_of_an_earlier_version_is_read_under_the_current_names(folder):
    """Its header has the rig and the axes with the old name of a parameter."""
    text = SWEEP.replace('wire.diameter = ["0.14 mm", "0.2 mm"]', 'material.max_strain = ["4 %", "5 %"]')
    rig = RIG.read_text("utf-8").replace("max_transformation_strain", "max_strain")
    assert "max_strain" in text and "max_strain" in rig
    header = {"name": "sweep.toml", "sweep": text, "rig": rig, "rig_name": "rig.toml", "recording": None}
    write_table(folder / "old.parquet", {"design": np.arange(3)}, header)
    sweep = read_sweep(folder / "old.parquet")
    assert sweep.axes[0].name == "material.max_transformation_strain" and sweep.axes[0].upper == 0.05
    assert "max_transformation_strain" in sweep.header()["rig"]


def test_constraints_that_no_design_keeps(folder):
    (folder / "sweep.toml").write_text(SWEEP.replace('at_most = "120 degC"', 'at_most = "21 degC"'), "utf-8")
    outcome = run(folder)
    assert "degC (allowed: at most 21 degC)" in outcome.reason
    assert (
        outcome.exit_code == 3
        and "none of the 130 designs satisfies the constraints: the nearest, design" in outcome.reason
    )
    assert (folder / "out" / "sweep.parquet").is_file()


@pytest.mark.slow
def test_refinement_restores_feasibility(folder):
    """The stroke of all sampled designs is too small; the gradients lead to feasible ones at the temperature limit."""
    text = SWEEP.replace("peak_temperature = {", 'stroke = { at_least = "9.5 mm" }\npeak_temperature = {').replace(
        "designs = 130", "designs = 4"
    )
    (folder / "sweep.toml").write_text(text, "utf-8")
    drawn = run(folder, "drawn")
    assert drawn.exit_code == 3 and "has stroke 8.348 mm (allowed: at least 9.5 mm)" in drawn.reason
    (folder / "sweep.toml").write_text(text + "[refine]\nstarts = 2\n", "utf-8")
    outcome = run(folder)
    assert outcome.exit_code == 0 and outcome.document["feasible"] == 0 and not outcome.document["problems"]
    best = [entry for entry in outcome.document["refined"] if entry["better"]]
    assert best and all(entry["rescued"] for entry in outcome.document["refined"])
    assert all(entry["metrics"]["stroke"] >= 9.5e-3 and entry["metrics"]["peak_temperature"] <= 120.0 for entry in best)
    assert "0 satisfy all constraints, so the nearest ones were refined: " in outcome.document["summary"]
    assert (folder / "out" / "rig-refined-1.toml").is_file() or (folder / "out" / "rig-refined-2.toml").is_file()
    # If no design is found, the reason says how near the search came, and where.
    (folder / "sweep.toml").write_text(text.replace("9.5 mm", "20 mm") + "[refine]\nstarts = 1\n", "utf-8")
    none = run(folder, "none")
    assert none.exit_code == 3 and not none.document["refined"][0]["better"]
    assert (
        "its refinement does not satisfy them either and ended at stroke" in none.reason
        and "at wire.diameter" in none.reason
    )


def test_refinement_restores_feasibility_of_a_whole_number():
    problem = StubProblem(("n", "a"), {"size": "m", "cost": "1"})

    def answer(problem, designs, steps):
        n, a = (float(v) for v in designs[0])
        return {"size": [n * a], "cost": [n + a]}, {"size": np.array([[a, n]]), "cost": np.array([[1.0, 1.0]])}, None

    axes, limits = (
        (Axis("n", "1", 2.0, 5.0, whole=True), Axis("a", "1", 0.0, 1.0)),
        {"size": (3.2, np.inf), "cost": (-np.inf, 5.0)},
    )
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        refined = restore_and_refine(problem, axes, np.array([2.0, 0.1]), {"cost": "min"}, limits)
        assert (
            refined.better
            and refined.restored
            and refined.design[0] in (4.0, 5.0)
            and refined.metrics["size"] >= 3.2
            and refined.metrics["cost"] <= 5.0
        )
        assert refined.before == {"size": pytest.approx(0.2), "cost": pytest.approx(2.1)}
        none = restore_and_refine(
            problem, axes, np.array([2.0, 0.1]), {"cost": "min"}, limits | {"cost": (-np.inf, 2.5)}
        )
        assert not none.better and none.restored and none.metrics["size"] > 0.2


@pytest.mark.slow
def test_the_nearest_design_is_one_that_was_simulated(tmp_path):
    """Thick wires do not fit into the strip: they have a moment, but no other metric."""
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
    assert outcome.exit_code == 3 and outcome.document["codes"] == {"done": 1, "diverged": 1}
    assert "the nearest, design 0, has moment 1.528 mN m (allowed: at least 1000 mN m)" in outcome.reason


def test_a_design_that_needs_too_much_memory(folder):
    slow = SWEEP.replace('frequency = "0.5 Hz"', 'frequency = "1e-6 Hz"')
    (folder / "sweep.toml").write_text(slow.replace("designs = 130", "designs = 4"), "utf-8")
    with pytest.raises(
        InputError,
        match=r"sweep.toml: input.frequency: .* GB per design, and at most 2 GB are allowed: raise input.frequency",
    ):
        run(folder)
    assert not (folder / "out.partial").exists()


@pytest.mark.slow
def test_number_and_spacing_of_wires_as_axes(tmp_path):
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
    original = actuator_file.read_actuator(tmp_path / "rig.toml")
    for k, (count, spacing) in enumerate(zip(columns["body.count"], columns["body.spacing"], strict=True)):
        text = flexural.replace("count = 2", f'count = {int(count)}\nspacing = "{1e3 * spacing} mm"')
        single = eqx.filter_jit(lambda actuator: actuator.metrics()["temperature_after"])(
            actuator_file.parse_actuator(text)
        )
        assert columns["temperature_after"][k] == pytest.approx(float(single), rel=1e-9)
    # Temperatures have no derivative with respect to the number of wires, which sets the grid; a force has one.
    assert np.all(np.isnan(columns[derivative_column("temperature_after", "body.count")]))
    assert np.all(columns[derivative_column("temperature_after", "body.spacing")] < 0.0)
    assert np.all(columns[derivative_column("blocking_force", "body.count")] > 0.0)
    assert original.program_index({}) == 2


@pytest.mark.slow
def test_batches_of_soft_bending_in_threads(tmp_path):
    """Several threads simulate batches at once."""
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


@pytest.mark.slow
def test_example_sweeps_and_an_actuator(tmp_path):
    for path in sorted((ROOT / "data" / "sweeps").glob("*.toml")):
        sweep = read_sweep(path)
        assert sweep.refine_starts and sweep.designs().shape == (sweep.count, len(sweep.axes))
    text = (
        (ROOT / "data" / "sweeps" / "flexural.toml")
        .read_text("utf-8")
        .replace("../actuators", str(ROOT / "data" / "actuators"))
    )
    text = (
        text.replace('["moment", "efficiency"]', "[]")
        .replace("designs = 256", "designs = 12")
        .replace("time_to_cool", "resistance")
    )
    (tmp_path / "sweep.toml").write_text(text, "utf-8")
    assert run(tmp_path).exit_code == 0
    columns = read_table(tmp_path / "out" / "sweep.parquet")
    single = actuator_file.read_actuator(ROOT / "data" / "actuators" / "flexural" / "rig.toml")
    metrics = eqx.filter_jit(type(single).metrics)(
        parameters.replace(single, {n: columns[n][3] for n in ("wire.diameter", "body.count")})
    )
    assert columns["blocking_force"][3] == pytest.approx(float(metrics["blocking_force"]), rel=1e-12)
    (tmp_path / "sweep.toml").write_text(text.replace("blocking_force =", "peak_stress ="), "utf-8")
    with pytest.raises(
        InputError,
        match="objectives.peak_stress is not a metric of this actuator, but of rigs with wires: its metrics are mo",
    ):
        read_sweep(tmp_path / "sweep.toml")
    (tmp_path / "sweep.toml").write_text(text + '[input]\nwave = "square"\n', "utf-8")
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
        "no value is at least '130 degC' and at most '120 degC'",
    ),
    ('peak_temperature = { at_most = "120 degC" }', 'stroke = { at_most = "-1 mm" }', "can never be satisfied"),
    ('peak_temperature = { at_most = "120 degC" }', "stroke = {}", "constraints.stroke has no bound"),
    ("[constraints]", "[constraint]", "[constraint] is not a section of a sweep (did you mean 'constraints'?)"),
    ('"time_to_cool"]', '"bandwidth"]', "input.highest is missing"),
    (
        '"time_to_cool"]\n[parameters]',
        '"bandwidth"]\n[parameters]\ninput.frequency = ["1 Hz", "6 Hz"]',
        "input.highest = 4 Hz is not above the range of input.frequency, which ends at 6 Hz",
    ),
    ("designs = 130", 'designs = 130\nsampling = "grid"', "sweep.designs has no place with a grid"),
    ('from = "100 g"', 'points = 3, from = "100 g"', "parameters.load.mass.points applies to a grid only"),
    (
        'load.mass = { from = "100 g", to = "300 g", scale = "log" }',
        'load.mass = { values = ["100 g"], scale = "log" }',
        "scale has no place next to values",
    ),
    (
        'at_most = "120 degC"',
        'at_most = "19 degC"',
        "at_most = '19 degC' can never be satisfied, as it is never below 20 degC",
    ),
    (
        'peak_temperature = { at_most = "120 degC" }',
        'efficiency = { at_least = "101 %" }',
        "can never be satisfied, as it is never above 1",
    ),
    (
        'peak_temperature = { at_most = "120 degC" }',
        "strain_range = { at_most = 3.5 }",
        'constraints.strain_range.at_most = 3.5 is a strain of 350 %, which no wire bears: write "3.5 %" if that',
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
def test_error_messages_of_sweep_files(folder, old, new, sentence):
    assert old in SWEEP
    text = SWEEP.replace(old, new)
    (folder / "sweep.toml").write_text(
        text.replace("[input]", '[input]\nhighest = "4 Hz"') if "highest =" in sentence else text, "utf-8"
    )
    with pytest.raises(InputError) as error:
        read_sweep(folder / "sweep.toml")
    assert sentence in str(error.value) and "sweep.toml" in str(error.value) and "\n" not in str(error.value)


def test_overlapping_temperature_ranges_and_axes_without_effect(folder):
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
    assert run(folder, resume=True).exit_code == 0


@contextlib.contextmanager
def _greeting(words: bytes | None):
    """Yields the address of a server that sends ``words`` to every client; nothing for ``None``."""
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
        (b"HTTP/1.1 400 Bad Request\r\nConnection: close\r\n\r\n", "the server there does not use Dask's protocol"),
        (b"SSH-2.0-OpenSSH_9.6\r\n", "the server there does not use Dask's protocol"),
        (bytes(64), "the server there does not use Dask's protocol"),
    ],
)
def test_a_server_that_is_not_a_scheduler(folder, monkeypatch, words, why):
    from smajax.sweeps import dask as cluster

    monkeypatch.setattr(cluster, "_TIMEOUT", 1)
    with _greeting(words) as address, pytest.raises(InputError) as error:
        run(folder, scheduler=address)
    assert f"--scheduler {address}: no Dask scheduler answers there ({why}): check its address" in str(error.value)


def test_identity_of_a_scheduler():
    import distributed

    from smajax.sweeps import dask as cluster

    for address in ("http://127.0.0.1:9", "inproc://x", "ucx://x:1"):
        with pytest.raises(ValueError, match="begins with tcp:// or tls://, not with"):
            cluster._open_connection(address)
    quiet = {"dashboard_address": None, "silence_logs": "ERROR"}
    with distributed.LocalCluster(
        n_workers=1, threads_per_worker=1, processes=False, protocol="tcp://", **quiet
    ) as local:
        cluster._check_identity(local.scheduler_address)
        with cluster.connected(local.scheduler_address) as client:
            assert client.submit(int, "7").result() == 7
        with pytest.raises(ValueError, match="it is the address of a worker"):
            cluster._check_identity(local.workers[0].address)


def test_missing_workers_and_other_versions():
    from smajax import __version__
    from smajax.sweeps import dask as cluster

    class Client:
        def __init__(self, workers, connected=True):
            self.workers, self.there = workers, connected

        def wait_for_workers(self, count, timeout):
            if not self.there:
                raise TimeoutError

        def run(self, function, *arguments, on_error):
            return self.workers

        def run_on_scheduler(self, function, *arguments):
            return function(*arguments)

    cases = [
        (Client({}, False), "it has no workers: start some (dask worker tcp://x)"),
        (Client({"a": None}), "worker a has no smajax"),
        (Client({"a": ModuleNotFoundError()}), "worker a has no smajax"),
        (Client({"a": __version__, "b": "0.0.1"}), f"worker b has smajax 0.0.1, and this is {__version__}"),
    ]
    for client, sentence in cases:
        with pytest.raises(InputError) as error:
            cluster._check_workers(client, "tcp://x")
        assert sentence in str(error.value)
    cluster._check_workers(Client({"a": __version__}), "tcp://x")
    # Without smajax the expression evaluates, too.
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


def test_infinite_metrics_are_ordered(tmp_path, monkeypatch):
    """Springs that never warm have an infinite heating time: the design is done, satisfies a lower limit, and is the largest."""

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
    # For the minimum the finite ones are best, and an infinite one violates any upper limit.
    (tmp_path / "sweep.toml").write_text(
        KNEE.replace('"max"', '"min"') + '[constraints]\nheating_time = { at_most = "1e9 s" }\n', "utf-8"
    )
    document = run(tmp_path, "other").document
    assert document["feasible"] == np.sum(~endless) and document["on_front"] == 1
    assert float(document["front"][0]["metrics"]["heating_time"]) == columns["heating_time"].min()
    assert document["refined"][0]["better"]
    costs = np.array([[np.inf, 0.0], [-np.inf, 1.0], [0.0, 1.0], [0.0, np.nan]])
    assert np.array_equal(pareto_front(costs), [0, 1])


def test_refinement_with_infinite_metrics():
    problem = StubProblem(("a",), {"slow": "s", "size": "m"})

    def answer(problem, designs, steps):
        a = float(designs[0, 0])
        values = {"slow": np.inf if a > 0.5 else a, "size": a}
        slopes = {"slow": [0.0 if a > 0.5 else 1.0], "size": [1.0]}
        return {n: [v] for n, v in values.items()}, {n: np.array([v]) for n, v in slopes.items()}, None

    axes = (Axis("a", "1", 0.0, 1.0),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        refined = refine(problem, axes, np.array([0.9]), {"size": "max"}, {"slow": (0.7, np.inf)})
        assert refined.better and refined.metrics["size"] == 1.0
        least = refine(problem, axes, np.array([0.4]), {"size": "max"}, {"slow": (-np.inf, 0.45)})
        assert least.better and least.metrics["size"] == pytest.approx(0.45, abs=1e-5)
        most = refine(problem, axes, np.array([0.4]), {"slow": "max"}, {})
        assert most.better and most.metrics["slow"] == np.inf
        assert not refine(problem, axes, np.array([0.9]), {"slow": "max"}, {}).better


def test_refinement_with_steps_that_resolve_its_result():
    """With the steps of the start a fast design seems colder than it is, and its other objective better."""

    problem = StubProblem(
        ("a",),
        {"size": "m", "hot": "degC", "cost": "1"},
        lambda design: 1 if design[0] < 0.3 else 2 if design[0] < 0.6 else 4,
    )

    def answer(problem, designs, steps):
        a = float(designs[0, 0])
        seen = {1: 0.5, 2: 0.7, 4: 1.0}[steps]
        values, slopes = {"size": a, "hot": seen * a, "cost": 1.0 - a}, {"size": 1.0, "hot": seen, "cost": -1.0}
        return {n: [v] for n, v in values.items()}, {n: np.array([[v]]) for n, v in slopes.items()}, None

    axes = (Axis("a", "1", 0.0, 1.0),)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        refined = refine(problem, axes, np.array([0.1]), {"size": "max", "cost": "min"}, {"hot": (-np.inf, 0.8)})
        assert refined.better and refined.metrics["hot"] == refined.design[0] == pytest.approx(0.8, abs=1e-5)
        # A design that is better with coarse steps only is not better.
        problem = replace(problem, steps_of=lambda design: 1 if design[0] < 0.79 else 4)
        refined = refine(problem, axes, np.array([0.78]), {"size": "max"}, {"hot": (-np.inf, 0.6)})
        assert not refined.better and refined.design[0] == 0.78


def test_whole_numbers_are_sampled_and_refined(folder):
    count = Axis("n", "1", 2.0, 5.0, whole=True)
    drawn = count.at(np.linspace(0.0, 1.0, 4001))
    assert np.array_equal(np.unique(drawn), [2, 3, 4, 5]) and np.ptp(np.bincount(drawn.astype(int))[2:]) <= 2
    assert np.array_equal(replace(count, points=20).grid(), [2, 3, 4, 5])
    assert set(replace(count, log=True).at(np.linspace(0.0, 1.0, 99))) == {2.0, 3.0, 4.0, 5.0}

    problem = StubProblem(("n", "a"), {"size": "m", "cost": "1"})

    def answer(problem, designs, steps):  # best at n = 3.6, a = 0.5 / n
        n, a = (float(v) for v in designs[0])
        values = {"size": 10.0 - (n - 3.6) ** 2 - (n * a - 0.5) ** 2, "cost": n + a}
        slopes = {"size": [-2.0 * (n - 3.6) - 2.0 * a * (n * a - 0.5), -2.0 * n * (n * a - 0.5)], "cost": [1.0, 1.0]}
        return {m: [v] for m, v in values.items()}, {m: np.array([v]) for m, v in slopes.items()}, None

    axes = (count, Axis("a", "1", 0.0, 1.0))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(evaluation, "differentiate_batch", answer)
        refined = refine(problem, axes, np.array([2.0, 0.9]), {"size": "max"}, {})
        assert refined.better and refined.design[0] == 4.0 and refined.design[1] == pytest.approx(0.125, abs=1e-3)
        # If the rounded number violates a limit, it stays, and the other axes are refined.
        least = refine(problem, axes, np.array([3.0, 0.5]), {"size": "max"}, {"cost": (0.0, 3.9)})
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
        with pytest.raises(InputError) as error:
            read_sweep(folder / "sweep.toml")
        assert sentence in str(error.value)


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
