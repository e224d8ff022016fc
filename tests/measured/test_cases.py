"""Small inputs of the kinds that went wrong for others: each gives the right value, or the right sentence."""

import pytest

import smajax as sma
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig

# Estimates by the README of each case, and how far the noise may move them.
RIGHT = {
    "false-bound": {"drive.gain": (0.0298, 0.0004), "heat.h0": (99.3, 1.5)},
    "measured-ambient": {"heat.h0": (60.0, 0.3), "heat.capacity": (2.05e6, 0.02e6)},
    "quantised-thermometer": {"heat.h0": (30.0, 0.2)},
}


def fitted(folder, recording="recording.csv", rig="rig.toml"):
    """Return the document of a fit, and the estimates of its free parameters."""
    document = sma.fit(folder / rig, folder / recording).document
    return document, {name: entry for name, entry in document["parameters"].items() if entry["free"]}


@pytest.mark.slow
@pytest.mark.parametrize("name", RIGHT)
def test_fits_have_the_right_values_and_floors(shared, name):
    document, estimates = fitted(shared / "cases" / name)
    assert estimates.keys() == RIGHT[name].keys()
    for parameter, (value, tolerance) in RIGHT[name].items():
        entry = estimates[parameter]
        assert entry["estimate"] == pytest.approx(value, abs=tolerance) and not entry["at_bound"], parameter
        assert entry["lower95"] < entry["estimate"] < entry["upper95"]
    assert document["rmse"]["temperature"]["train"] < 1.4 * document["noise_floor"]["temperature"]["value"]


def test_a_clock_changes_nothing_of_a_path(shared):
    folder = shared / "cases" / "path-with-clock"
    (_, timed), (_, untimed) = (fitted(folder, name) for name in ("with_time.csv", "without_time.csv"))
    assert timed == untimed
    assert timed["material.max_transformation_strain"]["estimate"] == pytest.approx(0.03774, abs=2e-4)
    assert timed["material.martensite_shift"]["estimate"] == pytest.approx(3.88, abs=0.1)


@pytest.mark.slow
def test_starts_from_which_nothing_transforms_are_left(shared):
    folder = shared / "cases" / "nothing-transforms"
    document, estimates = fitted(folder, "loops.csv")
    assert "this wire does not transform on loops.csv and stays martensite" in document["notices"][0]
    assert "lower transformation temperatures are needed" in document["notices"][0]
    assert document["rmse"]["stress"]["train"] < 10.9e6  # Pa, what the start near the wire's temperatures reaches
    assert all(not entry["at_bound"] and entry["lower95"] is not None for entry in estimates.values())
    with pytest.raises(InputError, match="set material.austenite_shift to a value within them, such as -85 K"):
        sma.read_rig(folder / "rig-bounds.toml")


def test_the_log_of_a_micro_controller_is_told_what_is_missing(shared):
    folder = shared / "cases" / "raw-microcontroller-log"
    text = (folder / "rig.toml").read_text("utf-8")
    with pytest.raises(InputError, match="'counts' is not a unit of force: give the scale and the unit of the result"):
        parse_rig(text)
    scaled = text.replace('unit = "counts"', 'factor = -0.0087, offset = 7.5, unit = "N"')
    with pytest.raises(InputError, match="'1/255' is not a unit of duty: give the number that stands for 1"):
        parse_rig(scaled)
    scaled = scaled.replace('unit = "1/255"', "full_scale = 255")
    with pytest.raises(InputError, match=r'set sample_period = "20 ms" under \[recording\] if the file has none'):
        parse_rig(scaled).read(folder / "log.csv")
    recording = parse_rig(scaled + '[recording]\nsample_period = "20 ms"\n').read(folder / "log.csv")
    assert len(recording) == 60 and recording.time[-1] == pytest.approx(1.18)
    assert recording.channels["force"][0] == pytest.approx(7.5 - 0.0087 * 804)
    assert recording.channels["duty"].max() == pytest.approx(120 / 255)


# Options of each export, by its README.
EXPORTS = {
    "good.csv": {},
    "no-header.csv": {"columns": "time [s],temperature [degC],stress [MPa],strain [%]"},
    "other-names.csv": {"columns": "time [s],temperature [degC],stress [MPa],strain [%]"},
    "units-row.csv": {"columns": "time,temperature,stress,strain"},
    "title-lines.csv": {"columns": "time,temperature,stress,strain", "skip_rows": 2},
    "latin1.csv": {"columns": "time,temperature,stress,strain"},
    "utf16.csv": {},
    "time-of-day.csv": {},
}


@pytest.mark.parametrize("name", EXPORTS)
def test_the_same_cycle_is_read_from_each_export(shared, name):
    options = {key: value.split(",") if key == "columns" else value for key, value in EXPORTS[name].items()}
    study = sma.thermal_cycle_properties(shared / "cases" / "instrument-exports" / name, **options)
    values = study.document["recordings"][0]["mean"]
    assert values["martensite_start"]["value"] == pytest.approx(63.4, abs=0.1)
    assert values["martensite_finish"]["value"] == pytest.approx(56.6, abs=0.1)


@pytest.mark.parametrize("name", ["sheet-per-stress.xlsx", "sheet-per-stress-no-header.xlsx"])
def test_sheets_are_stresses(shared, name):
    path = shared / "cases" / "instrument-exports" / name
    columns = ["temperature [degC]", "stress [MPa]", "strain [%]"] if "no-header" in name else None
    first = sma.thermal_cycle_properties(path, columns=columns)
    assert "sheet '50MPa' was read, and not 100MPa, 200MPa" in first.summary()
    groups = sma.thermal_cycle_properties(path, columns=columns, sheet="all").document["recordings"]
    starts = [group["mean"]["martensite_start"]["value"] for group in groups]
    assert starts == pytest.approx([56.4, 63.4, 77.4], abs=0.1)
