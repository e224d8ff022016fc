"""Controller files with section and key names from before version 0.2, and the example file with current names."""

import dataclasses

import equinox as eqx
import numpy as np
import pytest

from smajax.control.controller_file.read import read_controller
from smajax.errors import InputError
from smajax.files.channel_settings import ChannelSettings
from smajax.files.rig_file import read_rig
from smajax.recordings.column_mapping import ChannelMap
from tests.conftest import ROOT

CURRENT = """[controller]
period = "50 ms"
output = ["0 A", "0.5 A"]
[gains]
kp = "30 A/m"
[reference]
kind = "step"
high = "3 mm"
duration = "10 s"
[temperature_limiter]
limit = "90 degC"
kp = "0.05 A/K"
[estimator]
kind = "extended"
unknown = { "environment.ambient" = "4 K", "material.max_transformation_strain" = "0.1 %" }
temperature_process_noise = "3 K"
fraction_process_noise = "20 %"
use_estimate = true
[instruments]
voltage = { noise = "2 mV" }
[robust]
vary = { "material.max_transformation_strain" = ["4 %", "5 %"] }
[[change]]
parameter = "material.max_transformation_strain"
at = "5 s"
value = "4.4 %"
"""
OLD_NAMES = {
    "[temperature_limiter]": "[guard]",
    "[estimator]": "[observer]",
    "[instruments]": "[meters]",
    "temperature_process_noise": "drift",
    "fraction_process_noise": "walk",
    "use_estimate": "steers",
    "material.max_transformation_strain": "material.max_strain",
}


def with_old_names(text: str) -> str:
    for name, old in OLD_NAMES.items():
        text = text.replace(name, old)
    return text


@pytest.fixture(scope="module")
def rig():
    return read_rig(ROOT / "data" / "recordings" / "dead-weight" / "rig.toml")


@pytest.fixture
def read(rig, tmp_path):
    def of(text):
        (tmp_path / "controller.toml").write_text(text)
        return read_controller(tmp_path / "controller.toml", rig)

    return of


def test_old_and_current_names_give_the_same_content(read):
    current, old = read(CURRENT), read(with_old_names(CURRENT))
    assert eqx.tree_equal(current.loop, old.loop) and eqx.tree_equal(current.scenario, old.scenario)
    assert current.robust is not None and current.robust == old.robust
    assert list(current.scenario.changes) == ["material.max_transformation_strain"]


def test_the_old_name_of_a_thermal_observers_gain_is_read(read):
    limiter = CURRENT[: CURRENT.index("[estimator]")]
    current = read(limiter + '[estimator]\ngain = "0.2 1/s"\n').loop
    assert eqx.tree_equal(current, read(limiter + '[observer]\ntrust = "0.2 1/s"\n').loop)
    assert float(current.estimator.gain) == 0.2


@pytest.mark.parametrize(
    ("added", "sentence"),
    [
        (
            '[guard]\nlimit = "80 degC"\nkp = "1 A/K"\n',
            r"\[guard\] is the old name of \[temperature_limiter\], and both",
        ),
        (
            '[meters]\nvoltage = { noise = "1 mV" }\n',
            r"\[meters\] is the old name of \[instruments\], and both are given",
        ),
    ],
)
def test_a_section_under_both_names_raises(read, added, sentence):
    with pytest.raises(InputError, match=sentence):
        read(CURRENT + added)


@pytest.mark.parametrize(
    ("name", "old", "sentence"),
    [
        (
            "use_estimate = true",
            "steers = true",
            "estimator.steers is the old name of estimator.use_estimate, and both",
        ),
        (
            '"environment.ambient" = "4 K"',
            '"material.max_strain" = "0.1 %"',
            "estimator.unknown: material.max_strain is the old name of material.max_transformation_strain, and both",
        ),
    ],
)
def test_a_key_under_both_names_raises(read, name, old, sentence):
    joint = ", " if "{" not in name and '" = ' in name else "\n"
    with pytest.raises(InputError, match=sentence):
        read(CURRENT.replace(name, name + joint + old))


def test_the_commented_example_uses_current_names_only():
    text = (ROOT / "data" / "controllers" / "dead-weight.toml").read_text("utf-8")
    assert not any(f"[{old}]" in text for old in ("guard", "observer", "meters"))
    assert all(f"# [{name}]" in text for name in ("temperature_limiter", "estimator", "instruments"))


LOG = """logged on the bench
Clock;Laser;current [A];note
0,0;0,0;0,0;a
0,5;1000,0;0,2;b
1,0;2500,0;0,4;c
1,5;1500,0;0,3;d
"""
RECORDED = """[controller]
period = "0.5 s"
output = ["0 A", "0.5 A"]
[gains]
kp = "30 A/m"
[reference]
kind = "recorded"
file = "log.csv"
[feedforward]
operators = 3
recording = "log.csv"
"""


def test_recordings_of_a_controller_are_read_with_the_options_of_the_rig(rig, tmp_path):
    """A title, semicolons, decimal commas, other headers and a column to ignore, as ``[recording]`` and ``[channels]`` say."""
    channels = ChannelSettings({"time": ChannelMap("Clock", "s"), "displacement": ChannelMap("Laser", "um")}, ("note",))
    bench = dataclasses.replace(rig, channels=channels).with_read_options(skip_rows=1, delimiter=";", decimal=",")
    (tmp_path / "log.csv").write_text(LOG)
    (tmp_path / "controller.toml").write_text(RECORDED)
    content = read_controller(tmp_path / "controller.toml", bench)
    np.testing.assert_allclose(np.asarray(content.scenario.reference)[:4], [0.0, 1e-3, 2.5e-3, 1.5e-3], rtol=1e-12)
    with pytest.raises(InputError, match="log.csv: row 1"):
        read_controller(tmp_path / "controller.toml", rig)


@pytest.mark.parametrize(
    ("section", "noise"),
    [("", 2e-5), ('[sensor]\nquantum = "1 um"\n', 2e-5), ('[sensor]\nnoise = "5 um"\n', 5e-6)],
)
def test_the_sensor_has_the_noise_of_the_rig_where_the_controller_gives_none(rig, tmp_path, section, noise):
    text = CURRENT.split("[temperature_limiter]")[0] + section
    (tmp_path / "controller.toml").write_text(text)
    noisy = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, noise={"displacement": 2e-5}))
    assert float(read_controller(tmp_path / "controller.toml", noisy).loop.sensor.noise) == pytest.approx(noise)


def test_a_controller_that_takes_an_estimate_gets_no_noise_of_a_sensor(rig, tmp_path):
    (tmp_path / "controller.toml").write_text(CURRENT)
    noisy = dataclasses.replace(rig, fit=dataclasses.replace(rig.fit, noise={"displacement": 2e-5}))
    assert float(read_controller(tmp_path / "controller.toml", noisy).loop.sensor.noise) == 0.0
