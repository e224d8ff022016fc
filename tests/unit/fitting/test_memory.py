"""Steps and memory of a fit: what is said before it begins, and fits that work in parts or are refused."""

import re
import sys
from pathlib import Path

from experiments.common.memory import measure_peak
from experiments.fitting.fit_memory import made_recording, shipped_rig, write_case

import numpy as np
import pytest

from smajax.errors import InputError
from smajax.fitting import autoregression
from smajax.fitting import fit as fit_module
from smajax.fitting import memory as memory_module
from smajax.fitting.autoregression import autoregressive_spectrum
from smajax.fitting.fit import fit
from smajax.fitting.memory import FitMemory, fit_memory, free_memory, search_in_parts
from smajax.fitting.multi_start import screen_starts
from smajax.fitting.problem import build_problem
from smajax.simulation.inputs import count_steps, discretise
from tests.support import plants
from tests.unit.fitting.test_bounds_and_noise import Settings

ROOT = Path(__file__).resolve().parents[3]
GIB = 2**30
FREE = ("heat.h0", "material.max_transformation_strain")
# 3.9 GB as one batch, and 1.8 GB with one start after another.
MEMORY = FitMemory(
    steps=1000, evaluation=700_000_000, ends=150_000_000, others=500_000_000, screened=30_000_000, starts=4
)


def made(rows: int, step: float):
    """Return a recording of a dead-weight rig whose displacement is noise; nobody simulates it."""
    current = plants.pulses(rows, 0.0, 0.33)
    noise = 1e-3 * np.random.default_rng(0).standard_normal(rows)
    return plants.recording({"current": current, "displacement": noise}, step * np.arange(rows))


@pytest.mark.parametrize("step", [0.01, 0.05, 3.0])
def test_steps_are_counted_as_they_are_made(step):
    plant, recording = plants.dead_weight(), made(50, step)
    assert count_steps(plant, recording) == len(discretise(plant, recording).time) - 1


@pytest.mark.parametrize(("rows", "step"), [(3_000, 0.2), (200_000, 0.02)])
@pytest.mark.parametrize("plant", [plants.dead_weight(), plants.stress_path()], ids=["weight", "path"])
def test_long_recordings_are_fitted_within_two_gigabytes(plant, rows, step):
    """3,000 rows over ten minutes, and 200,000 rows at 50 Hz, with five parameters and four starts."""
    time = step * np.arange(rows)
    blank = np.zeros(rows)
    names = dict.fromkeys((*plant.signals, "displacement", "strain"), blank)
    settings = Settings(free=("a", "b", "c", "d", "e"), observe=("displacement",), starts=4)
    memory = fit_memory(plant, [plants.recording(names, time)], settings)
    assert memory.batch < 2 * GIB and search_in_parts(memory, "made.csv", 2 * GIB / 0.8)[0] is False
    assert f"{memory.steps:,} steps" in memory.sentence()


@pytest.mark.slow
def test_a_fit_of_ten_minutes_takes_less_than_a_gigabyte(tmp_path):
    """3,000 rows, 0.2 s apart, through the command line, with everything that is compiled, written and drawn."""
    rig = shipped_rig("dead-weight")
    recording = made_recording(rig, "made.csv", 3_000, 0.2)
    files = write_case(tmp_path / "case", rig, [recording])
    command = [sys.executable, "-m", "smajax", "fit", *files, "--starts", "4", "--max-steps", "2"]
    peak = measure_peak(command, {"PYTHONPATH": str(ROOT)})
    assert peak.code == 0, peak.output
    assert (tmp_path / "case" / "out" / "report.html").exists()
    memory = fit_memory(rig.plant, [recording], Settings(free=rig.fit.free, observe=rig.fit.observe, starts=4))
    assert memory.steps > 20_000
    assert peak.memory < GIB
    assert 0.8 < memory.batch / peak.memory < 1.5


def test_a_fit_that_does_not_fit_is_refused_with_the_numbers(monkeypatch):
    monkeypatch.setattr(memory_module, "free_memory", lambda: 1.5e9)
    recording = made(100, 4e4)
    with pytest.raises(InputError, match=r"made\.csv: this fit takes [\d,]{9,} steps and about \d+\.\d GB") as raised:
        fit(plants.dead_weight(), [recording], Settings(free=FREE, observe=("displacement",)))
    assert "1.5 GB of memory are free: cut the recordings into parts" in str(raised.value)
    steps = int(re.search(r"takes ([\d,]+) steps", str(raised.value))[1].replace(",", ""))
    assert steps == count_steps(plants.dead_weight(), recording)


def test_starts_are_searched_one_after_another_where_memory_is_short():
    assert MEMORY.batch == 3_900_000_000 and MEMORY.sequential == 1_800_000_000
    assert search_in_parts(MEMORY, "made.csv", 5e9) == (False, 116)
    assert search_in_parts(MEMORY, "made.csv", 3e9) == (True, 63)
    with pytest.raises(
        InputError, match=r"made\.csv: this fit takes 1,000 steps and about 1\.8 GB of memory, and 2\.0"
    ):
        search_in_parts(MEMORY, "made.csv", 2e9)


def test_what_will_be_done_is_said_before():
    whole, sequence, refused = (MEMORY.sentence(free) for free in (5e9, 3e9, 2e9))
    assert whole == "A simulation of these recordings takes 1,000 steps, and a fit about 3.9 GB of memory."
    assert sequence.endswith("3.0 GB of memory are free: it searches one start after another, in 1.8 GB of memory.")
    assert "2.0 GB of memory are free: cut the recordings into parts, sample them more coarsely" in refused


@pytest.mark.slow
def test_parts_change_no_start():
    settings = Settings(free=FREE, observe=("displacement",), starts=3)
    problem = build_problem(plants.dead_weight(), [made(100, 0.05)], settings)
    whole, simulations = screen_starts(problem, 3, 0)
    parts, same = screen_starts(problem, 3, 0, at_once=13)
    np.testing.assert_allclose(parts, whole, rtol=1e-12)
    assert simulations == same


@pytest.mark.slow
def test_a_fit_in_parts_has_the_result_of_one_as_a_whole(monkeypatch):
    plant, settings = plants.stress_path(), Settings(
        free=("material.max_transformation_strain",), observe=("strain",), starts=2
    )  # fmt: skip
    temperature = 60.0 + 60.0 * np.sin(np.linspace(-1.5, 5.0, 60))
    strain = 0.02 - 0.02 * np.tanh((temperature - 70.0) / 10.0)
    recording = plants.recording({"temperature": temperature, "stress": np.full(60, 1e8), "strain": strain})
    whole = fit(plant, [recording], settings)
    monkeypatch.setattr(fit_module, "search_in_parts", lambda memory, name: (True, 5))
    parts = fit(plant, [recording], settings)
    assert parts.estimates[0].estimate == pytest.approx(whole.estimates[0].estimate, rel=1e-6)


def test_a_spectrum_in_blocks_is_that_of_all_frequencies(monkeypatch):
    coefficients, frequencies = np.array([1.2, -0.4, 0.05]), np.fft.rfftfreq(200)
    whole = autoregressive_spectrum(coefficients, 0.3, frequencies)
    monkeypatch.setattr(autoregression, "_BLOCK", 7)
    np.testing.assert_allclose(autoregressive_spectrum(coefficients, 0.3, frequencies), whole, rtol=1e-12)


def test_free_memory_is_that_of_the_tightest_limit(monkeypatch, tmp_path):
    monkeypatch.setattr(memory_module, "_CONTROL_GROUP", tmp_path)
    assert memory_module._resident_memory() > 1e7
    monkeypatch.setattr(memory_module, "_resident_memory", lambda: 1000.0)
    machine = free_memory()
    assert machine > 0 and bool(np.isfinite(machine))
    (tmp_path / "memory.max").write_text("5000000\n")
    (tmp_path / "memory.current").write_text("4000000\n")
    (tmp_path / "memory.stat").write_text("anon 100\nfile 500000\n")
    assert free_memory() == 1_501_000.0
    (tmp_path / "memory.max").write_text("max\n")
    assert free_memory() > 1e7
