"""A path is led row by row, with a time column and without one."""

import dataclasses

import jax.numpy as jnp
import numpy as np
import pytest

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.fitting.fit import fit
from smajax.plant.effects.creep import Creep
from smajax.recordings.read import read_recording
from smajax.recordings.recording import Recording
from smajax.simulation.inputs import discretise
from smajax.simulation.run import simulate
from smajax.simulation.step_size import default_step
from tests.support import plants
from tests.unit.fitting.test_bounds_and_noise import Settings

ROWS = 60
BATH_RIG = """
schema = 1
[rig]
kind = "dead-weight"
control = "temperature"
parameters = "rotary-table1"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[load]
mass = "200 g"
"""


def cycle(time=None) -> Recording:
    """Return a thermal cycle under a constant stress, with the strain that the wire has."""
    temperature = 25.0 + 80.0 * (1.0 - np.abs(np.linspace(-1.0, 1.0, ROWS)))
    blank = plants.recording({"temperature": temperature, "stress": np.full(ROWS, 150e6)}, time)
    plant = plants.stress_path()
    strain = np.asarray(simulate(plant, discretise(plant, blank, step=1e9)).channels["strain"])
    noisy = strain + 1e-5 * np.random.default_rng(0).standard_normal(ROWS)
    return dataclasses.replace(blank, channels={**blank.channels, "strain": noisy})


@pytest.mark.parametrize("plant", [plants.stress_path(), plants.strain_path()], ids=["stress", "strain"])
@pytest.mark.parametrize("spacing", [1e-3, 5.0, 3600.0])
def test_each_row_is_one_step_whatever_the_clock_says(plant, spacing):
    recording = cycle(spacing * np.arange(ROWS))
    assert np.isinf(default_step(plant))
    assert len(discretise(plant, recording).time) == ROWS
    assert len(discretise(plant, recording, step=spacing / 4).time) == 4 * (ROWS - 1) + 1


def test_the_steps_of_a_heated_wire_still_resolve_its_cooling():
    plant = plants.dead_weight()
    recording = plants.recording({"current": np.zeros(3), "displacement": np.zeros(3)}, np.array([0.0, 5.0, 10.0]))
    assert len(discretise(plant, recording).time) > 100 and default_step(plant) <= 0.05


@pytest.mark.slow
def test_a_clock_changes_no_fit_of_a_path():
    time = np.cumsum(np.append(0.0, np.random.default_rng(0).uniform(0.1, 600.0, ROWS - 1)))
    settings = Settings(free=("material.max_transformation_strain", "material.martensite_shift"), observe=("strain",))
    start = plants.stress_path()
    start = dataclasses.replace(start, material=dataclasses.replace(start.material, martensite_shift=jnp.asarray(3.0)))
    timed, untimed = (fit(start, [recording], settings) for recording in (cycle(time), cycle()))
    assert [e.estimate for e in timed.estimates] == [e.estimate for e in untimed.estimates]
    assert [e.lower95 for e in timed.estimates] == [e.lower95 for e in untimed.estimates]
    assert timed.discretisation_errors == untimed.discretisation_errors == {"strain": 0.0}


def loop(time=None) -> Recording:
    """Return loops of strain of a warm wire, with the stress that it has."""
    strain = 0.03 * (1.0 - np.abs(np.linspace(-1.0, 1.0, ROWS)))
    blank = plants.recording({"temperature": np.full(ROWS, 95.0), "strain": strain}, time)
    plant = plants.strain_path()
    stress = np.asarray(simulate(plant, discretise(plant, blank, step=1e9)).channels["stress"])
    noisy = stress + 1e5 * np.random.default_rng(0).standard_normal(ROWS)
    return dataclasses.replace(blank, channels={**blank.channels, "stress": noisy})


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [1e-6, 0.19, 86400.0], ids=["microseconds", "the real log", "days"])
def test_a_clock_changes_no_fit_of_loops_of_strain(spacing):
    settings = Settings(free=("material.austenite_shift", "material.modulus_austenite"), observe=("stress",))
    start = changed_modulus(plants.strain_path())
    timed, untimed = (fit(start, [recording], settings) for recording in (loop(spacing * np.arange(ROWS)), loop()))
    for one, other in zip(timed.estimates, untimed.estimates, strict=True):
        assert (one.estimate, one.lower95, one.upper95) == (other.estimate, other.lower95, other.upper95)
    assert timed.rmse("stress") == pytest.approx(1e5, rel=0.2)


def changed_modulus(plant):
    """Return a plant whose start value of a modulus is off."""
    return dataclasses.replace(plant, material=dataclasses.replace(plant.material, modulus_austenite=jnp.asarray(35e9)))


@pytest.mark.parametrize("spacing", [0.01, 30.0])
def test_a_wire_in_a_bath_takes_no_more_steps_with_a_slower_clock(spacing):
    """It has no heat balance, so that no time constant is resolved."""
    plant = parse_rig(BATH_RIG).plant
    bath = np.interp(np.arange(ROWS), [0, ROWS / 2, ROWS], [20.0, 110.0, 25.0])
    recording = plants.recording({"temperature": bath}, spacing * np.arange(ROWS))
    assert len(discretise(plant, recording).time) == ROWS
    quick = plants.recording({"temperature": bath}, np.arange(ROWS, dtype=float))
    np.testing.assert_allclose(
        simulate(plant, recording).channels["displacement"], simulate(plant, quick).channels["displacement"]
    )


def test_rows_of_one_time_are_a_path_of_their_own():
    """A jump of stress within one time, and a clock that stands still: the response is that of the rows."""
    plant, untimed = plants.stress_path(), cycle()
    expected = simulate(plant, untimed).channels["strain"]
    coarse = np.floor(np.arange(ROWS) / 7.0)
    for time in (coarse, np.zeros(ROWS), 1e-6 * np.arange(ROWS)):
        recording = dataclasses.replace(untimed, time=time, has_clock=True)
        np.testing.assert_array_equal(simulate(plant, recording).channels["strain"], expected)
    finer = discretise(plant, dataclasses.replace(untimed, time=coarse, has_clock=True), step=0.25)
    jumps = np.flatnonzero(np.diff(coarse) == 0.0) + 1
    ends = finer.sample_indices[jumps] - 1
    np.testing.assert_array_equal(finer.after[ends], finer.sample_signals[jumps])


@pytest.mark.parametrize("policy", ["refuse", "drop", "split"])
def test_times_of_a_path_may_repeat_and_are_counted(policy, tmp_path):
    times = [0.0, 0.0, 1.0, 1.0, 1.0, 2.0]
    lines = ["time [s],temperature [degC],stress [MPa]", *(f"{t},{20 + k},{100 + k}" for k, t in enumerate(times))]
    (tmp_path / "path.csv").write_text("\n".join(lines))
    options = {"required": ("temperature", "stress"), "on_bad_rows": policy}
    recording = read_recording(tmp_path / "path.csv", clock=False, **options)
    assert recording.time.tolist() == times and recording.has_clock
    assert recording.notes == ("3 rows have the time of the row before, which is allowed here",)
    assert len(read_recording(recording, clock=False, **options)) == len(times)
    (tmp_path / "still.csv").write_text("\n".join([lines[0], "7,20,100", "7,21,101"]))
    still = read_recording(tmp_path / "still.csv", clock=False, **options)
    assert not still.has_clock and still.time.tolist() == [0.0, 1.0] and "time" not in still.units
    assert still.notes[0].startswith("the time is the same in all rows, and was left out")
    lines[-1] = "0.5,25,105"
    (tmp_path / "path.csv").write_text("\n".join(lines))
    if policy == "refuse":
        with pytest.raises(InputError, match=r"row 7, column 'time \[s\]': time decreases from 1 to 0\.5"):
            read_recording(tmp_path / "path.csv", clock=False, **options)
    (tmp_path / "path.csv").write_text("\n".join(lines[:-1]))
    if policy == "refuse":
        with pytest.raises(InputError, match="time does not increase at 0"):
            read_recording(tmp_path / "path.csv", **options)


def test_effects_with_rates_take_the_recorded_times():
    """A wire that creeps has crept less after a fast cycle than after a slow one."""
    plant = dataclasses.replace(
        plants.stress_path(), effects=(Creep(strength=jnp.asarray(0.01), time_constant=jnp.asarray(20.0)),)
    )
    fast, slow = (simulate(plant, cycle(spacing * np.arange(ROWS))).channels["strain"] for spacing in (0.01, 100.0))
    assert float(jnp.max(jnp.abs(fast - slow))) > 1e-4
