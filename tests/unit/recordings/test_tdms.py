"""TDMS files, written by nptdms: groups, units, waveform properties and time channels."""

import sys
from pathlib import Path
from typing import Any

import nptdms
import numpy as np
import pytest

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording, read_recordings
from smajax.recordings.recording import Recording

CURRENT, STROKE = np.linspace(0.0, 2.0, 5), np.linspace(0.0, 3.0, 5)
START = np.datetime64("2024-03-01T12:00:00")
WAVEFORM = {"wf_increment": 0.02, "wf_start_offset": 0.0, "wf_start_time": START}
CURRENT_PROPERTIES = {"unit_string": "A", **WAVEFORM}
STROKE_PROPERTIES = {"unit_string": "mm", **WAVEFORM}

Channels = list[tuple[str, str, np.ndarray, dict[str, Any]]]
WAVE: Channels = [
    ("Bench", "current", CURRENT, CURRENT_PROPERTIES),
    ("Bench", "displacement", STROKE, STROKE_PROPERTIES),
]


def write(channels: Channels) -> None:
    """Writes channels to wire.tdms: group, name, values and properties."""
    with nptdms.TdmsWriter("wire.tdms") as writer:
        writer.write_segment([nptdms.ChannelObject(g, name, v, properties=p) for g, name, v, p in channels])


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(channels: Channels, **options: Any) -> Recording:
        write(channels)
        return read_recording("wire.tdms", **options)

    return call


def with_time(name: str, values: np.ndarray) -> Channels:
    return [("Bench", name, values, {}), *WAVE]


DATES = START + (np.arange(5) * 20_000).astype("timedelta64[us]")
LAYOUTS: dict[str, tuple[Channels, dict[str, Any]]] = {
    "waveform": (WAVE, {}),
    "time channel": (with_time("time [s]", np.arange(5) * 0.02), {}),
    "mapped time channel": (
        with_time("Untitled", np.arange(5) * 20.0),
        {"mapping": {"time": ChannelMap("Untitled", "ms")}},
    ),
    "dates": (with_time("time", DATES), {}),
    "other names": (
        [("Bench", "I", CURRENT, WAVEFORM), ("Bench", "Laser", STROKE, STROKE_PROPERTIES)],
        {"columns": ("current [A]", "displacement")},
    ),
    "sample period": (
        [(g, n, v, {"unit_string": p["unit_string"]}) for g, n, v, p in WAVE],
        {"sample_period": "20 ms"},
    ),
    "other group": ([("Slow", "temperature", CURRENT[:2], {}), *WAVE], {"sheet": "Bench"}),
}


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_gives_the_same_recording(read, layout):
    channels, options = LAYOUTS[layout]
    recording = read(channels, **options)
    np.testing.assert_allclose(recording.time, np.arange(5) * 0.02, rtol=1e-12)
    np.testing.assert_array_equal(recording.channels["current"], CURRENT)
    np.testing.assert_allclose(recording.channels["displacement"], STROKE / 1000, rtol=1e-15)


def test_the_clock_and_the_groups_that_are_left_out_are_noted(read):
    notes = read([*WAVE, ("Slow", "temperature", CURRENT[:2], {})]).notes
    assert notes[0] == "group 'Bench' was read, and not Slow: name others, or all, by sheet (--sheet)"
    assert notes[1].startswith(
        "time is every 0.02 s, as the waveform properties say, from wf_start_time 2024-03-01T12:00:00"
    )


def test_groups_are_recordings(read):
    write([*WAVE, *(("Second", *channel[1:]) for channel in WAVE)])
    recordings = read_recordings("wire.tdms", sheet="all")
    assert [recording.name for recording in recordings] == ["wire.tdms group 'Bench'", "wire.tdms group 'Second'"]


SLOW = {**STROKE_PROPERTIES, "wf_increment": 0.1}
REFUSED: dict[str, tuple[Channels, dict[str, Any], str]] = {
    "no clock": ([(g, n, v, {"unit_string": "A"}) for g, n, v, _ in WAVE[:1]], {"required": ("time",)}, "the channel time is missing"),
    "two clocks": ([WAVE[0], ("Bench", "displacement", STROKE, SLOW)], {}, "wire.tdms: the clocks of channels 'current' and 'displacement' differ (0.02 s from "),
    "two lengths": ([WAVE[0], ("Bench", "displacement", STROKE[:3], STROKE_PROPERTIES)], {}, "channel 'displacement' has 3 values and 'current' 5: put channels of other rates"),
    "missing group": (WAVE, {"sheet": "Bensh"}, "there is no group 'Bensh' (did you mean 'Bench'?): it has Bench"),
    "bad cell": ([("Bench", "current", np.where(CURRENT == 1, np.nan, CURRENT), CURRENT_PROPERTIES)], {}, "wire.tdms: row 3, column 'current [A]': the value is not finite: correct it"),
    "clock twice": (WAVE, {"sample_period": "20 ms"}, "there is a time column, and sample_period = 20 ms: remove sample_period"),
    "names": (WAVE, {"columns": ("a", "b", "c")}, "the number of named columns is 3, and the file has 2 (current [A], displacement [mm]): name every"),
    "texts": ([*WAVE, ("Bench", "force", np.array(["a", "b", "c", "d", "e"]), {"unit_string": "N"})], {}, "column 'force [N]': the values are texts and not numbers: record numbers"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_the_cure(read, fault):
    channels, options, sentence = REFUSED[fault]
    with pytest.raises(InputError) as refusal:
        read(channels, **options)
    assert str(refusal.value).startswith("wire.tdms: ") and sentence in str(refusal.value)


def test_damaged_files_are_refused(read, tmp_path):
    for content in (b"time,current", b"TDSm" + bytes(100)):
        Path("wire.tdms").write_bytes(content)
        with pytest.raises(InputError, match=r"^wire.tdms: (the file is not readable as TDMS|no group has a channel)"):
            read_recording("wire.tdms")


def test_a_missing_package_is_named(read, monkeypatch):
    monkeypatch.setitem(sys.modules, "nptdms", None)
    Path("wire.tdms").write_bytes(b"TDSm")
    with pytest.raises(
        InputError, match=r'^wire.tdms: TDMS files need nptdms: run pip install "smajax\[io\]", or export'
    ):
        read_recording("wire.tdms")
