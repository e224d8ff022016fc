"""What recordings show about their bench, and fits that explain nothing; the recordings are those of exact simulators."""

import dataclasses
import json
import re

import numpy as np
import pytest
from typer.testing import CliRunner

import smajax as sma
from smajax import parameters
from smajax.api.bench import bench_entries, rig_findings, with_free_offsets
from smajax.app import cli
from smajax.files.rig_file import read_rig
from smajax.fitting.bench_checks import bench_findings, residual_findings
from smajax.fitting.residual_offsets import ResidualOffset
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording

FOLDER = data_path("recordings", "dead-weight")
# First rows of a recording, in s: enough for a loop.
UNTIL = 60.0


@pytest.fixture(scope="module")
def rig():
    return read_rig(FOLDER / "rig.toml")


@pytest.fixture(scope="module")
def recording(rig):
    return rig.read(FOLDER / "train.csv").slice(0.0, UNTIL)


def spoiled(recording, displacement=lambda v: v, current=lambda v: v, time=lambda v: v) -> Recording:
    """Return a recording with columns that were changed by functions of their SI values."""
    channels = {
        "displacement": displacement(recording.channels["displacement"]),
        "current": current(recording.channels["current"]),
    }
    return dataclasses.replace(recording, time=time(recording.time), channels=channels)


SPOILED = {
    "offset": (
        {"displacement": lambda v: v + 12.4e-3},
        ["displacement begins at 12.4", "where the rig is at 0: free sensor.displacement_offset", "subtract it"],
    ),
    "small-offset": ({"displacement": lambda v: v - 0.5e-3}, ["displacement begins at -0.5", "offset = 0.5"]),
    "sign": (
        {"displacement": lambda v: -v},
        ["displacement falls when the wire is heated: contraction is positive: give displacement factor = -1"],
    ),
    "clock-in-ms": (
        {"time": lambda v: 1e3 * v},
        ["the rows are 20 s apart", "a thousandth of the time", "check the unit of time, which is read as s"],
    ),
    "clock-in-us": (
        {"time": lambda v: 1e6 * v},
        ["the rows are 2e+04 s apart", "a millionth of the time", "check the unit of time, which is read as s"],
    ),
    "clock-in-s-as-us": (
        {"time": lambda v: 1e-6 * v},
        ["current heats the wire by", "a million times the time", "check the unit of time, which is read as s"],
    ),
    "clock-in-s-as-ms": (
        {"time": lambda v: 1e-3 * v},
        ["current heats the wire by", "a thousand times the time", "check the unit of time, which is read as s"],
    ),
    "clock-in-minutes": (
        {"time": lambda v: v / 60.0},
        ["displacement follows the rig's values only with sixty times the time", "check the unit of time, which is"],
    ),
    "clock-in-s-as-minutes": (
        {"time": lambda v: 60.0 * v},
        ["a sixtieth of the time", "check the unit of time, which is read as s"],
    ),
    "motion-ten-times": (
        {"displacement": lambda v: 10.0 * v},
        ["displacement is 10 times what the rig's values give: check its unit, which is read as mm"],
    ),
    "motion-a-tenth": ({"displacement": lambda v: 0.1 * v}, ["displacement is a tenth of what the rig's values give"]),
    "motion-a-thousandth": ({"displacement": lambda v: 1e-3 * v}, ["displacement is a thousandth of what"]),
    "motion-in-inches": (
        {"displacement": lambda v: v / 25.4},
        ["displacement is 0.0", "times what the rig's values give"],
    ),
    "current-ten-times": (
        {"current": lambda v: 10.0 * v},
        ["current heats the wire to", "a tenth of the current", "check the unit of current, which is read as A"],
    ),
    "current-a-tenth": ({"current": lambda v: 0.1 * v}, ["K only by the rig's values", "ten times the current"]),
    "current-a-thousandth": ({"current": lambda v: 1e-3 * v}, ["K only by the rig's values", "a thousand times the"]),
}


@pytest.mark.slow
@pytest.mark.parametrize("name", SPOILED)
def test_a_spoiled_recording_gets_the_sentence_on_its_fault(rig, recording, name):
    changes, words = SPOILED[name]
    findings = bench_findings(rig.plant, [spoiled(recording, **changes)], rig.fit)
    assert len(findings) == 1, [finding.sentence for finding in findings]
    assert findings[0].sentence.startswith("train.csv: ")
    for word in words:
        assert word in findings[0].sentence


@pytest.mark.parametrize(("unit", "value"), [("degF", 1.8 * 20.0 + 32.0), ("K", 293.15)])
def test_a_thermometer_of_another_unit_is_found(rig, recording, unit, value):
    """It begins at 20 degC, the ambient temperature, in its own unit; a room of 12 degC is no other unit."""
    settings = dataclasses.replace(rig.fit, observe=("temperature",))

    def measured(first):
        channels = recording.channels | {"temperature": np.full(len(recording), first)}
        return dataclasses.replace(recording, channels=channels, units=recording.units | {"temperature": "degC"})

    (found,) = bench_findings(rig.plant, [measured(value)], settings)
    assert found.sentence == (
        f"train.csv: temperature begins at {value:.1f} degC where the rig is at 20.0 degC, as in {unit}: check its unit, "
        "which is read as degC."
    )
    assert not bench_findings(rig.plant, [measured(12.0)], settings)


def test_a_clock_in_ms_is_found_where_the_values_of_the_rig_are_rough(rig, recording):
    """The alloy of the recording transforms 8 K lower: the rig follows it less well on any clock."""
    rough = parameters.replace(rig.plant, {"material.austenite_shift": 8.0, "material.martensite_shift": 8.0})
    slow = spoiled(recording, time=lambda v: 1e3 * v)
    assert [f.code for f in bench_findings(rough, [slow], rig.fit)] == ["clock"]
    assert bench_findings(rough, [recording], rig.fit) == []


def test_a_reversed_sensor_with_an_offset_gets_both_cures(rig, recording):
    """The cures together give the displacement: -1 times the reading plus the offset of the cure."""
    wrong = spoiled(recording, displacement=lambda v: 12.4e-3 - v)
    sign, offset = bench_findings(rig.plant, [wrong], rig.fit)
    assert "factor = -1" in sign.sentence and "offset = 12.4" in offset.sentence
    assert offset.values[0] == pytest.approx(12.4e-3, abs=5e-5)


@pytest.mark.slow
@pytest.mark.parametrize("folder", sorted(path.parent.name for path in data_path("recordings").glob("*/rig.toml")))
def test_no_shipped_recording_is_in_doubt(folder):
    folder = data_path("recordings", folder)
    rig = read_rig(folder / "rig.toml", drop_misplaced=True)
    recordings = [rig.read(path) for path in sorted(folder.glob("*.csv"))]
    assert [finding.sentence for finding in rig_findings(rig, recordings)] == []


@pytest.mark.parametrize("offset", [-1.5e-4, 1.5e-4])
def test_an_offset_of_a_sixtieth_of_the_stroke_is_found_and_its_cure_is_exact(rig, recording, offset):
    """Seven standard deviations of the noise, where the whole channel reaches 10 mm: unseen, intervals miss by 5 sigma."""
    (finding,) = bench_findings(rig.plant, [spoiled(recording, displacement=lambda v: v + offset)], rig.fit)
    cure = float(re.search(r"offset = (\S+) of displacement", finding.sentence)[1])
    assert finding.code == "offset" and -1e-3 * cure == pytest.approx(finding.values[0], abs=1e-5)
    assert finding.values[0] == pytest.approx(offset, abs=4e-5)


def test_the_cure_of_a_large_offset_is_as_exact(rig, recording):
    """A cure rounded to whole millimetres would leave an offset of a twentieth of the stroke."""
    rng = np.random.default_rng(2)
    noisy = spoiled(recording, displacement=lambda v: v + 16.45e-3 + 8e-5 * rng.standard_normal(len(v)))
    (finding,) = bench_findings(rig.plant, [noisy], rig.fit)
    cure = float(re.search(r"offset = (\S+) of displacement", finding.sentence)[1])
    assert cure == pytest.approx(-16.45, abs=0.1)


def test_a_wire_that_begins_warm_has_no_offset(rig, recording):
    """Rows from the middle begin at a stroke and come back to rest."""
    displacement = recording.channels["displacement"]
    start = recording.time[int(np.argmax(displacement > 0.5 * displacement.max()))]
    warm = rig.read(FOLDER / "train.csv").slice(start, start + UNTIL)
    assert warm.channels["displacement"][0] > 4e-3
    assert not [f for f in bench_findings(rig.plant, [warm], rig.fit) if f.code == "offset"]


def test_what_is_free_explains_the_recording(rig, recording):
    shifted = spoiled(recording, displacement=lambda v: v + 12.4e-3)
    hot = spoiled(recording, current=lambda v: 10.0 * v)
    for name, wrong in (("sensor.displacement_offset", shifted), ("drive.gain", hot)):
        settings = dataclasses.replace(rig.fit, free=(*rig.fit.free, name))
        assert not bench_findings(rig.plant, [wrong], settings)


def test_a_wire_that_only_expands_is_not_reversed(rig, recording):
    """A wire that never transforms expands where it is heated, by a fiftieth of a transformation."""
    current = recording.channels["current"]
    rise = np.convolve(current**2, np.exp(-recording.time[:500]), "full")[: len(current)]  # a time constant of 1 s
    noise = 2e-6 * np.random.default_rng(0).standard_normal(len(current))
    cold = spoiled(recording, displacement=lambda v: noise - 2e-4 * rise / rise.max(), current=lambda v: 0.4 * v)
    assert not [f for f in bench_findings(rig.plant, [cold], rig.fit) if f.code == "sign"]


def test_one_sentence_names_all_recordings(rig, recording):
    recordings = [
        dataclasses.replace(spoiled(recording, displacement=lambda v: v + 12.4e-3), name=f"{k}.csv") for k in range(5)
    ]
    (finding,) = bench_findings(rig.plant, recordings, rig.fit)
    assert finding.sentence.startswith("0.csv, 1.csv, 2.csv and 2 more: displacement begins at 12.4")
    assert len(finding.values) == 5


@pytest.fixture(scope="module")
def few(rig):
    """The rig with two free parameters, so that a fit is short."""
    free = ("heat.h0", "material.max_transformation_strain")
    return dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=free, starts=1))


@pytest.mark.slow
def test_a_fit_of_an_offset_is_a_failure_without_intervals_and_auto_fits_it(few, recording, tmp_path):
    shifted = spoiled(recording, displacement=lambda v: v + 12.4e-3)
    study = sma.fit(few, shifted)
    assert not study.success and study.exit_code == 3
    assert "times its noise floor" in study.reason and "correct what the recording shows first" in study.reason
    assert all(entry.interval is None for entry in study.parameters.values())
    assert str(study).startswith("train.csv: displacement begins at 12.4")
    study.save(tmp_path / "result")
    saved = json.loads((tmp_path / "result" / "fit.json").read_text("utf-8"))
    assert saved["failure"] == study.reason and saved["bench"][0]["code"] == "offset"
    assert "interval" not in (tmp_path / "result" / "fit.toml").read_text("utf-8")
    assert sma.load(tmp_path / "result").exit_code == 3

    free = sma.fit(few, shifted, auto=True)
    assert free.success
    assert free.document["bench"][0]["text"].endswith("sensor.displacement_offset is free, as --auto asks.")
    interval = free.parameters["sensor.displacement_offset"].interval
    assert interval is not None
    low, high = interval
    assert low < 12.4e-3 < high and high - low < 5e-4
    assert free.rmse["displacement"]["train"] < 1.1 * sma.fit(few, recording).rmse["displacement"]["train"]


def test_recordings_with_different_offsets_have_sentences_of_their_own(rig, recording):
    recordings = [
        dataclasses.replace(spoiled(recording, displacement=lambda v, c=c: v + c), name=f"{k}.csv")
        for k, c in enumerate((2e-3, -12.4e-3, 2e-3))
    ]
    findings = bench_findings(rig.plant, recordings, rig.fit)
    assert [f.recordings for f in findings] == [("0.csv", "2.csv"), ("1.csv",)]
    assert "begins at 1.98 mm" in findings[0].sentence and "begins at -12.4 mm" in findings[1].sentence
    assert all("[channels]" not in f.sentence for f in findings)  # it would hold for all three
    (alone,) = bench_findings(rig.plant, recordings[1:2], rig.fit)
    assert "offset = 12.4" in alone.sentence and "under [channels]" in alone.sentence
    assert with_free_offsets(rig, findings, ["0.csv", "1.csv"]).fit.per_recording == ("sensor.displacement_offset",)
    assert with_free_offsets(rig, findings, ["0.csv", "2.csv"]).fit.free[-1] == "sensor.displacement_offset"


def test_small_offsets_of_a_residual_that_differ_are_fitted_for_each_recording(rig, recording):
    recordings = [dataclasses.replace(recording, name=name) for name in ("0.csv", "1.csv")]
    offsets = [ResidualOffset("displacement", (6e-5, -6e-5), 0.98)]
    findings = residual_findings(recordings, offsets, {"displacement": 2e-5}, "and fit again")
    assert with_free_offsets(rig, findings, ["0.csv", "1.csv"]).fit.per_recording == ("sensor.displacement_offset",)


def test_an_offset_of_the_holdout_alone_is_not_fitted(rig, recording):
    holdout = dataclasses.replace(spoiled(recording, displacement=lambda v: v + 2e-3), name="holdout.csv")
    findings = bench_findings(rig.plant, [recording, holdout], rig.fit)
    assert with_free_offsets(rig, findings, ["train.csv"]) is rig
    (entry,) = bench_entries(findings, ["train.csv"])
    assert entry["text"].endswith("no training recording shows it, so that it is not fitted.")


@pytest.mark.slow
def test_recordings_with_different_offsets_have_one_each(few, recording):
    recordings = [
        dataclasses.replace(spoiled(recording, displacement=lambda v, c=c: v + c), name=f"{k}.csv")
        for k, c in enumerate((2e-3, 12.4e-3))
    ]
    study = sma.fit(few, recordings, auto=True)
    values = [study.parameters[f"sensor.displacement_offset@{k}.csv"].value for k in (0, 1)]
    assert values == pytest.approx([2e-3, 12.4e-3], abs=1e-4)


def test_wrong_parameters_that_fit_a_wrong_unit_have_no_intervals(few, recording):
    """A tenth of the motion is fitted by a tenth of the strain, with a residual far above the noise."""
    study = sma.fit(few, spoiled(recording, displacement=lambda v: 0.1 * v))
    assert study.exit_code == 3 and "displacement is a tenth of" in str(study).partition("Fitted")[0]


@pytest.mark.slow
def test_a_fit_with_several_parameters_at_bounds_far_above_the_noise_is_a_failure(rig, recording):
    """Bounds that exclude the truth: no finding is needed for the failure."""
    bounds = {"material.austenite_shift": (20.0, 40.0), "material.max_transformation_strain": (0.001, 0.002)}
    free = tuple(bounds)
    narrow = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, free=free, bounds=bounds, starts=1))
    values = {"material.austenite_shift": 30.0, "material.max_transformation_strain": 0.0015}
    start = dataclasses.replace(narrow, plant=parameters.replace(rig.plant, values))
    study = sma.fit(start, recording)
    assert study.exit_code == 3 and "2 parameters at their bounds" in study.reason
    assert [name for name, entry in study.parameters.items() if entry.at_bound] == list(free)


def smajax(*words):
    return CliRunner().invoke(cli.app, [str(word) for word in words])


@pytest.mark.slow
def test_check_and_fit_begin_with_what_the_recording_shows(few, recording, tmp_path):
    few.write(tmp_path / "rig.toml")
    spoiled(recording, displacement=lambda v: v + 12.4e-3).write(tmp_path / "own.csv")
    beginning = "own.csv: displacement begins at 12.4"
    checked = smajax("check", tmp_path / "rig.toml", tmp_path / "own.csv")
    assert checked.exit_code == 0 and checked.stdout.startswith(beginning)
    with_offset = smajax("check", tmp_path / "rig.toml", tmp_path / "own.csv", "--auto")
    assert "sensor.displacement_offset is free, as --auto asks" in with_offset.stdout
    assert re.search(r"^sensor.displacement_offset +12[.]\d+ mm +none .. none", with_offset.stdout, re.MULTILINE)
    fitted = smajax("fit", tmp_path / "rig.toml", tmp_path / "own.csv", "--out", tmp_path / "out")
    assert fitted.exit_code == 3 and fitted.stdout.startswith(beginning)
    assert f"smajax: {beginning}" in fitted.stderr.partition("smajax: fitting")[0]
    assert (tmp_path / "out" / "fit.json").is_file() and (tmp_path / "out" / "report.html").is_file()
    assert "displacement begins at 12.4" in (tmp_path / "out" / "report.html").read_text("utf-8")
    auto = smajax("fit", tmp_path / "rig.toml", tmp_path / "own.csv", "--auto", "--out", tmp_path / "auto")
    assert auto.exit_code == 0 and "sensor.displacement_offset" in auto.stdout
    assert "sensor.displacement_offset" in (tmp_path / "auto" / "rig.toml").read_text("utf-8")


@pytest.mark.slow
def test_no_recording_of_others_is_in_doubt(shared):
    for path in sorted((shared / "blind").glob("*/rig.toml")):
        rig = read_rig(path, drop_misplaced=True)
        recordings = [rig.read(path.parent / f"{part}.csv") for part in ("train", "select", "holdout")]
        assert [finding.sentence for finding in rig_findings(rig, recordings)] == [], path
