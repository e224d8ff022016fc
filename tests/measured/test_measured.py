"""Experiments with recordings by others: the files that they read, and messages for folders that they cannot use. Fits are not tested."""

import ast
import dataclasses
import importlib
import json
import os
import subprocess
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import NamedTuple

from experiments.fitting import interval_coverage

import jax.numpy as jnp
import numpy as np
import pytest

import smajax as sma
from smajax.files.rig_file import parse_rig
from smajax.fitting.result import Estimate
from smajax.plant.effects import catalogue
from smajax.plant.effects.class_check import effect_problems
from smajax.recordings.recording import Recording
from tests.conftest import ROOT

EXPERIMENTS = ROOT / "experiments"
SHARED_PLUMBING = "common"
NAMES = sorted(
    str(path.relative_to(EXPERIMENTS).with_suffix(""))
    for path in EXPERIMENTS.rglob("[a-z]*.py")
    if SHARED_PLUMBING not in path.parts
)


def run_alone(name: str, *words: str) -> subprocess.CompletedProcess:
    """Run an experiment in a separate process without the JAX settings of the tests, as a user does."""
    command = [sys.executable, str(EXPERIMENTS / f"{name}.py"), *words]
    environment = {k: v for k, v in os.environ.items() if k not in ("EQX_ON_ERROR", "XLA_FLAGS")}
    return subprocess.run(command, capture_output=True, text=True, cwd=ROOT, check=False, env=environment)


class Ended(NamedTuple):
    """Exit code and output of an experiment."""

    returncode: int
    stdout: str
    stderr: str


@pytest.fixture
def run(monkeypatch, capsys):
    """Return a function that runs an experiment in this process, whose modules are already imported."""
    monkeypatch.syspath_prepend(str(ROOT))

    def ended(name: str, *words: str) -> Ended:
        monkeypatch.setattr(sys, "argv", [str(EXPERIMENTS / f"{name}.py"), *words])
        with pytest.raises(SystemExit) as ended_by:
            importlib.import_module(f"experiments.{name.replace('/', '.')}").main()
        streams = capsys.readouterr()
        return Ended(int(ended_by.value.code or 0), streams.out, streams.err)

    return ended


@pytest.mark.parametrize("name", NAMES)
def test_every_experiment_starts(name, run):
    result = run(name, "--help")
    assert result.returncode == 0 and "--json" in result.stdout, result.stderr
    # Each experiment has to configure JAX before it imports modules that need it.
    assert first_loaded(name).startswith("experiments.common")


def first_loaded(name: str) -> str:
    """Return the first module in an experiment's imports that configures JAX or needs it configured."""
    for node in ast.parse((EXPERIMENTS / f"{name}.py").read_text("utf-8")).body:
        modules = (
            [str(node.module)] if isinstance(node, ast.ImportFrom) else [a.name for a in getattr(node, "names", [])]
        )
        for module in modules:
            if module.partition(".")[0] in (
                "experiments",
                "smajax",
                "tests",
                "equinox",
                "diffrax",
                "optimistix",
                "lineax",
            ):
                return module
    return ""


def levels(folder: Path, *stresses: int) -> Path:
    """A folder of cycles as ``...MPa.txt``: temperature, strain, stress."""
    temperature = np.concatenate([np.linspace(20, 140, 40), np.linspace(140, 20, 40)])
    for stress in stresses:
        strain = 0.03 / (1 + np.exp((temperature - 70) / 5))
        np.savetxt(folder / f"isobaric_{stress}MPa.txt", np.column_stack([temperature, strain, np.full(80, stress)]))
    return folder


@pytest.mark.parametrize(
    "name",
    [
        "measured/isobaric",
        "measured/muscle_electric",
        "measured/cyclic",
        "measured/superelastic",
        "measured/bu_softlimb",
    ],
)
def test_a_missing_folder_is_refused(name, tmp_path, run):
    result = run(name, "--data", str(tmp_path / "nowhere"))
    assert result.returncode == 2
    assert "nowhere" in result.stderr and "--data" in result.stderr


def test_a_missing_level_is_refused_with_a_list(tmp_path, run):
    result = run("measured/isobaric", "--data", str(levels(tmp_path, 50, 100, 200)), "--holdout", "150")
    assert result.returncode == 2
    assert "50, 100, 200 MPa" in result.stderr


def test_two_levels_are_too_few(tmp_path, run):
    result = run("measured/isobaric", "--data", str(levels(tmp_path, 50, 150)), "--holdout", "150")
    assert result.returncode == 2
    assert "at least three" in result.stderr


def test_the_measured_levels_are_found(shared, run):
    result = run("measured/isobaric", "--data", str(shared / "data" / "tamu-flexinol-isobaric"), "--holdout", "1")
    assert result.returncode == 2
    assert "50, 100, 150, 172, 200 MPa" in result.stderr


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("20 0.01\n30 abc\n", "two columns of numbers"),
        ("20 0.01 3\n" * 20, "3 columns"),
        ("20 0.01\n" * 20, "0 cycles go above 200 degC"),
    ],
)
def test_cycles_that_cannot_be_read_are_refused(text, said, tmp_path, run):
    (tmp_path / "Example Test Data.txt").write_text(text)
    result = run("measured/cyclic", "--data", str(tmp_path))
    assert result.returncode == 2
    assert "Example Test Data.txt" in result.stderr and said in result.stderr


def test_an_invalid_workbook_is_refused(tmp_path, run):
    for temperature in (0, 40, 100):
        (tmp_path / f"pseudoelastic_{temperature}C.xlsx").write_text("no workbook")
    result = run("measured/superelastic", "--data", str(tmp_path))
    assert result.returncode == 2
    assert "pseudoelastic_0C.xlsx cannot be read" in result.stderr


def quick_rows(name: str, folder: Path, tmp_path: Path) -> dict[str, dict]:
    """Return the rows of a quick run by name."""
    result = run_alone(name, "--data", str(folder), "--quick", "--json", str(tmp_path / "rows.json"))
    assert result.returncode == 0, result.stderr
    return {row["what"]: row for row in json.loads((tmp_path / "rows.json").read_text())["rows"]}


@pytest.mark.slow
def test_an_effect_forecasts_the_measured_cycles_better_than_the_base_model(shared, tmp_path):
    rows = quick_rows("measured/cyclic", shared / "data" / "asmada-cyclic", tmp_path)
    base = rows["base model: held out, plateau rows"]["numbers"]["percent"]
    assert rows["all effects: held out, plateau rows"]["numbers"]["percent"] < 0.7 * base
    assert "10404 scored" in rows["rows"]["measured"]
    assert (
        rows["all effects against the naive forecast, plateau rows"]["met"] is False
    )  # one effect is not enough, and the table shows it


@pytest.mark.slow
def test_an_effect_predicts_the_measured_loop_better_than_the_base_model(shared, tmp_path):
    rows = quick_rows("measured/superelastic", shared / "data" / "tamu-muscle-superelastic", tmp_path)
    base = rows["base model: held out, 40 degC"]["numbers"]["rmse_MPa"]
    assert rows["all effects: held out, 40 degC"]["numbers"]["rmse_MPa"] < 0.7 * base
    assert rows["rows left out as dropouts"]["measured"] == "1 at 0 degC, 0 at 100 degC, 0 at 40 degC"


def arm_log(folder: Path, pulses: tuple[float, ...] = (1.0, 91.0), tags: tuple[int, ...] = (1, 2, 3)) -> Path:
    """Write a log of an arm that turns about its middle tag while its second thermocouple heats up."""
    time = np.arange(0.0, 110.0, 0.2)
    since = (
        np.min([np.where(time >= p, time - p, np.inf) for p in pulses], axis=0)
        if pulses
        else np.full(len(time), np.inf)
    )
    duty = np.where(since < 8.0, 0.3, 0.0)
    warm = np.where(np.isfinite(since), since, 0.0) * np.exp(-np.where(np.isfinite(since), since, 0.0) / 5.0)
    columns = {
        "stamp": 1e3 * time,
        "pwm_duty_a": 0.0 * time,
        "pwm_duty_b": duty,
        "MCPtemp_0": 22.0 + 0.0 * time,
        "MCPtemp_1": 22.0 + 20.0 * warm,
    }
    for k in tags:
        angle = np.radians(5.0 * warm) if k == max(tags) else 0.0 * time
        reach = 100.0 * (k - tags[0])
        columns |= {f"tagid_x_{k}": 50.0 + reach * np.cos(angle), f"tagid_y_{k}": 50.0 + reach * np.sin(angle)}
    table = np.column_stack(list(columns.values()))
    np.savetxt(folder / "log.csv", table, delimiter=",", header="a log\n" + ",".join(columns), comments="", fmt="%.6f")
    return folder


def test_a_log_without_pulses_or_tags_is_refused(tmp_path, run):
    result = run("measured/bu_softlimb", "--data", str(arm_log(tmp_path, pulses=())))
    assert result.returncode == 2 and "0 pulses" in result.stderr
    result = run("measured/bu_softlimb", "--data", str(arm_log(tmp_path, tags=())))
    assert result.returncode == 2 and "0 tags" in result.stderr


def test_the_moving_parts_of_a_log_are_detected(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_log as arm_logs
    from experiments.common import arm_model

    log = arm_logs.read_logs(arm_log(tmp_path))[0]
    assert log.columns == "pwm_duty_b, MCPtemp_1, tags 2 to 3"
    np.testing.assert_allclose(log.pulses, [1.0, 91.0])
    assert (log.until, log.scored) == (80.0, 85.0)
    assert np.nanmax(log.bend) > 5.0
    parts = arm_model.split_log(log)
    train, select = (np.isfinite(parts[role].channels["displacement"]) for role in ("train", "select"))
    assert not np.any(train & select)
    np.testing.assert_array_equal(train | select, np.isfinite(parts["fitted"].channels["displacement"]))


@pytest.mark.slow
def test_a_measured_arm_is_fitted_quickly(shared, tmp_path):
    target = tmp_path / "table.json"
    result = run_alone(
        "measured/bu_softlimb", "--data", str(shared / "data" / "bu-softlimb"), "--quick", "--json", str(target)
    )
    assert result.returncode == 0, result.stderr
    rows = {row["what"]: row for row in json.loads(target.read_text("utf-8"))["rows"]}
    assert "tags 101 to 109" in rows["test_c1_only: found"]["measured"]
    assert rows["held out: with effects"]["numbers"]["rmse_K"] < 0.7 * rows["held out: base model"]["numbers"]["rmse_K"]


def test_the_latent_heat_of_an_arm_is_one_that_an_alloy_can_have(tmp_path, monkeypatch):
    """Its ends and its narrow prior hold in the last stage of a search, and not in the first."""
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common.arm_fit import ArmFitter, JointProblem
    from experiments.common.arm_log import read_log
    from experiments.measured.bu_softlimb import EFFECTS

    fitter = ArmFitter([read_log(arm_log(tmp_path) / "log.csv")], EFFECTS)
    joint, wide = (JointProblem(fitter, "fitted", (), is_first_stage=first) for first in (False, True))
    column = fitter.names.index("effects.grains.latent_heat")
    latent_heats = [joint.values(np.full(joint.size, z))[0, column] for z in (-20.0, 0.0, 20.0)]
    np.testing.assert_allclose(latent_heats, [20e6, 120e6, 220e6])
    assert joint.deviation[column] < wide.deviation[column]
    assert wide.values(np.full(wide.size, -20.0))[0, column] == 0.0
    assert joint.has_first_stage and not JointProblem(fitter, "fitted", ("grains",)).has_first_stage


def test_the_best_fits_with_wide_priors_are_start_points(tmp_path, monkeypatch):
    """Eight start points are fitted with wide priors, and two of these fits are continued; hops follow."""
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_fit
    from experiments.common.arm_log import read_log
    from experiments.measured.bu_softlimb import EFFECTS

    solved = []

    def solve(problem, point, steps):
        fit = arm_fit.ArmFit(problem.values(point), float(np.sum(point**2)), "")
        solved.append((problem, fit))
        return fit

    monkeypatch.setattr(arm_fit.JointProblem, "solve", solve)
    fitter = arm_fit.ArmFitter([read_log(arm_log(tmp_path) / "log.csv")], EFFECTS)
    fits = fitter.fit("fitted", (), starts=8, hops=3)
    stages = [problem for problem, _ in solved]
    assert len(set(map(id, stages[:8]))) == 1 and len(set(map(id, stages[8:]))) == 1
    wide, joint = stages[0], stages[8]
    best = sorted((fit for _, fit in solved[:8]), key=lambda f: f.cost)[:2]
    for (_, fit), before in zip(solved[8:10], best, strict=True):
        np.testing.assert_allclose(fit.values, joint.values(joint.point(before.values)))
    assert np.any(wide.deviation > joint.deviation)
    assert len(solved) == 8 + 2 + 3 + 1  # the best one is solved again at the end
    assert len(fits) == 5 and fits[0].cost == min(fit.cost for _, fit in solved[8:])


def test_readings_that_are_logged_late_are_moved_back(tmp_path, monkeypatch):
    """The readings are taken 0.1 s later or earlier than their rows say, in turn, on a ramp."""
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_log as arm_logs

    log = arm_logs.read_logs(arm_log(tmp_path))[0]
    temperature = np.full(len(log.time), np.nan)
    rows = np.sort(np.append(np.arange(0, len(log.time), 5), np.arange(3, len(log.time), 5)))
    late = np.where(np.diff(rows, prepend=rows[0] - 2) == 2, 0.1, -0.1)
    temperature[rows] = 22.0 + 5.0 * (log.time[rows] + late)
    shift = arm_logs.reading_shift(dataclasses.replace(log, temperature=temperature))
    np.testing.assert_allclose(shift[rows[1:]], late[1:], atol=0.011)
    assert not np.any(shift[np.isnan(temperature)])


def test_a_log_of_another_course_is_read(tmp_path, monkeypatch, capsys):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_log as arm_logs
    from experiments.common import arm_prediction

    log = arm_logs.read_logs(arm_log(tmp_path))[0]
    for pulses in ((1.0,), (1.0, 20.0, 40.0), ()):
        course = arm_prediction.Course(arm_log(tmp_path, pulses=pulses) / "log.csv")
        bend = course.bend((2, 3))
        assert bend is not None and bend[0] == 0.0
        assert np.any(course.duty(log) > 0) == bool(pulses)
        assert len(course.recording(log)) == len(course.time)
    course = arm_prediction.Course(arm_log(tmp_path, tags=()) / "log.csv")
    assert course.bend((2, 3)) is None
    with pytest.raises(SystemExit):
        arm_prediction.Course(tmp_path / "nowhere.csv")
    assert "--predict" in capsys.readouterr().err


def test_a_prediction_is_compared_with_naive_forecasts(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_prediction

    measured = np.array([1.0, np.nan, 3.0, 5.0])
    row = arm_prediction.error_row("a channel", [(measured, np.array([1.0, 0.0, 3.0, 4.0]))], "K")
    assert row.met and row.numbers["rmse"] == pytest.approx(np.sqrt(1 / 3))
    assert row.numbers["rmse_of_the_mean"] == pytest.approx(np.sqrt(8 / 3))
    assert row.numbers["rmse_of_the_first_row"] == pytest.approx(np.sqrt(20 / 3))


def test_effects_of_the_arm_are_absent_without_strength(monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common.arm_effects import ARM_EFFECTS, Grains, RestOffset, ThermocoupleContact

    for key, kind in ARM_EFFECTS.items():
        assert kind is Grains or not effect_problems(key, kind, catalogue())
        assert float(kind().strength) == 0.0
    motion, time = jnp.array([0.0, 1e-4, 4e-4, 0.0]), jnp.arange(4.0)
    assert not np.any(RestOffset().displacement(motion, {}, time))
    slack, stretched = (RestOffset(strength=jnp.asarray(s)).displacement(motion, {}, time) for s in (2e-4, -2e-4))
    np.testing.assert_allclose(slack, [2e-4, 1e-4, 0.0, 0.0])
    np.testing.assert_allclose(stretched, [-2e-4, -1.5e-4, 0.0, 0.0])
    series = jnp.array([20.0, 60.0, 40.0, 30.0])
    np.testing.assert_allclose(ThermocoupleContact().reading(series, {}, time), 0.0, atol=1e-9)


@pytest.mark.slow
def test_grains_set_their_latent_heat_free_and_creep(monkeypatch):
    """A wire of grains is simulated through a pulse: heat of the transformation delays it, and creep ends after it."""
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common.arm_effects import Grains
    from experiments.common.arm_model import RIG

    plant = parse_rig(RIG, "softlimb.toml").plant
    time = np.arange(0.0, 60.0, 0.1)
    zero = np.zeros(len(time))
    channels = {"duty": np.where(time < 6.0, 0.3, 0.0), "temperature": zero, "displacement": zero}
    recording = Recording.from_arrays(
        "pulse", time, channels, {"duty": "1", "temperature": "degC", "displacement": "m"}
    )

    def response(**values: float) -> dict[str, np.ndarray]:
        wire = dataclasses.replace(plant, effects=(Grains(width=1.0, **values),))
        result = sma.simulate(wire, sma.discretise(wire, recording))
        return {name: np.asarray(result.channels[name]) for name in ("temperature", "displacement")}

    law = response(strength=0.0)
    cold = response(strength=1.0, latent_heat=0.0, creep=0.0)
    warm = response(strength=1.0, latent_heat=1e8, creep=0.0)
    np.testing.assert_allclose(cold["temperature"], law["temperature"], atol=0.01)  # up to errors of the steps
    assert np.max(np.abs(cold["displacement"] - law["displacement"])) < 0.1 * np.max(law["displacement"])
    colder = np.max(cold["temperature"] - warm["temperature"])
    assert 0.2 * 1e8 / 3e6 < colder < 1e8 / 3e6  # latent heat over heat capacity, less the smaller losses
    assert np.min(cold["temperature"] - warm["temperature"]) < 0.0  # on cooling the heat is set free
    crept = response(strength=1.0, latent_heat=0.0, creep=0.002, creep_time=2.0)
    change = crept["displacement"] - cold["displacement"]
    assert np.max(np.abs(change[time < 10.0])) > 1e-5 and abs(change[-1]) < 1e-6


def test_a_point_of_the_joint_fit_has_the_parameters_of_all_logs(tmp_path, monkeypatch):
    monkeypatch.syspath_prepend(str(ROOT))
    from experiments.common import arm_fit
    from experiments.common import arm_log as arm_logs

    logs = arm_logs.read_logs(arm_log(tmp_path)) * 2
    fitter = arm_fit.ArmFitter(logs, ("coating", "rest-offset"))
    joint = arm_fit.JointProblem(fitter, "fitted", ())
    point = 0.1 * np.random.default_rng(0).standard_normal(joint.size)
    values = joint.values(point)
    np.testing.assert_allclose(joint.values(joint.point(values)), values, rtol=1e-12)
    spread = (values[0] - values[1])[joint.shared] / joint.deviation[joint.shared]
    assert np.max(np.abs(spread)) < 0.2  # the wires are alike
    without = arm_fit.JointProblem(fitter, "fitted", ("coating",))
    assert without.values(np.zeros(without.size))[0][fitter.names.index("effects.coating.strength")] == 0.0


@pytest.mark.slow
def test_a_measured_log_of_another_course_is_predicted_quickly(shared, tmp_path):
    """The first log is cut before its second pulse, so that it is a log of another course."""
    lines = (shared / "data" / "bu-softlimb" / "test_c3_only.csv").read_text("utf-8").splitlines()
    course, target = tmp_path / "course.csv", tmp_path / "table.json"
    course.write_text("\n".join(lines[:303]) + "\n", "utf-8")
    options = (
        "--data",
        str(shared / "data" / "bu-softlimb"),
        "--predict",
        str(course),
        "--quick",
        "--json",
        str(target),
    )
    result = run_alone("measured/bu_softlimb", *options)
    assert result.returncode == 0, result.stderr
    rows = {row["what"]: row for row in json.loads(target.read_text("utf-8"))["rows"]}
    driven = next(row for what, row in rows.items() if what.startswith("MCPtemp_3, pwm_duty_limb1_rev driven for 1.7"))
    assert driven["met"] and rows["bend, tags 105 to 109"]["met"]
    assert rows["all bends"]["met"] and "all thermocouples" in rows
    assert len(rows) == 8


@pytest.mark.parametrize(("count", "least", "largest"), [(200, 0.91, 0.98), (40, 0.85, 1.0)])
def test_expected_shares_are_quantiles(count, least, largest):
    assert interval_coverage.expected_shares(count) == pytest.approx((least, largest), abs=1e-12)


def test_a_profile_without_an_end_does_not_contain_the_truth(monkeypatch):
    """Its row says so, and an interval that a bound cuts off is said to have no ends."""
    ends = iter([{"lower95": None, "upper95": 101.0}, *({"lower95": 99.0, "upper95": 102.0},) * 3])
    monkeypatch.setattr(interval_coverage, "profile_likelihood", lambda result, name: next(ends))
    estimate = Estimate("heat.h0", 100.0, None, None, "W/m^2/K", True, (0.0, 100.0))
    row = interval_coverage.profile_row("heat.h0", [SimpleNamespace(estimates=[estimate])] * 4)  # pyright: ignore[reportArgumentType]
    assert row.measured == "75.0 % of 4; the first from none to 101 W/m^2/K, its interval from none to none"
    assert row.met and row.target == "50 % or more"
