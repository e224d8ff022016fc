"""Options of the one reader: layout, clock, scales of columns, sheets and bad rows."""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pytest
import scipy.io
from typer.testing import CliRunner

import smajax as sma
from smajax.app.cli import app
from smajax.errors import InputError
from smajax.files.rig_file import parse_rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording, read_recordings
from smajax.recordings.read_options import ReadOptions
from smajax.recordings.recording import Recording
from tests.conftest import ROOT

COLUMNS = ("time [s]", "temperature [degC]", "strain [%]")
TABLE = "0,30,4\n5,60,2\n10,90,0.5\n"
GOOD = ",".join(COLUMNS) + "\n" + TABLE
NAMES = "Time,Temp,Strain\n"
PLAIN = ("time", "temperature", "strain")


@pytest.fixture
def read(tmp_path, monkeypatch):
    """Reads the content of a file cycle.csv."""
    monkeypatch.chdir(tmp_path)

    def call(content: str | bytes, **options: Any) -> Recording:
        Path("cycle.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_recording("cycle.csv", **options)

    return call


def assert_is_the_cycle(recording: Recording) -> None:
    assert recording.time.tolist() == [0.0, 5.0, 10.0]
    assert recording.channels["temperature"].tolist() == [30.0, 60.0, 90.0]
    np.testing.assert_allclose(recording.channels["strain"], [0.04, 0.02, 0.005], rtol=1e-15)


LAYOUTS: dict[str, tuple[str | bytes, dict[str, Any]]] = {
    "no header": (TABLE, {"columns": COLUMNS}),
    "other names": (NAMES + TABLE, {"columns": COLUMNS}),
    "other names with units": ("Time [s],Temp [degC],Strain [%]\n" + TABLE, {"columns": PLAIN}),
    "header that is said to be none": (TABLE, {"columns": COLUMNS, "header": False}),
    "numbers as headers": ("1,2,3\n" + TABLE, {"columns": COLUMNS, "header": True}),
    "units row": (NAMES + "s,degC,%\n" + TABLE, {"columns": PLAIN}),
    "units row in brackets": (",".join(PLAIN) + "\n[s],[°C],(%)\n" + TABLE, {}),
    "units row that is skipped": ("Time,Temp,Strain\nsec.,Cels.,pct.\n" + TABLE, {"columns": COLUMNS, "skip_rows": 2}),
    "units row with a blank": ("time [s],temperature,strain [%]\n,degC,\n" + TABLE, {}),
    "title": ("Specimen: wire 3\nOperator: NN\n" + GOOD, {"skip_rows": 2}),
    "title and units": ("Specimen\n" + NAMES + "s,degC,%\n" + TABLE, {"skip_rows": 1, "columns": PLAIN}),
    "cp1252": (GOOD.replace("degC", "°C").encode("cp1252"), {}),
    "cp1252 by name": (GOOD.replace("degC", "°C").encode("cp1252"), {"encoding": "cp1252"}),
    "utf-16": (GOOD.replace("degC", "°C").encode("utf-16"), {}),
    "utf-16 without mark": (GOOD.encode("utf-16-be"), {}),
    "utf-16 by name": (GOOD.encode("utf-16-le"), {"encoding": "utf-16-le"}),
    "utf-8 with mark": (GOOD.replace("degC", "°C").encode("utf-8-sig"), {}),
    "semicolons": (GOOD.replace(",", ";").replace(".", ","), {"delimiter": ";", "decimal": ","}),
    "dates": (GOOD.replace("\n0,", "\n2024-03-01 12:00:00.000,").replace("\n5,", "\n2024-03-01 12:00:05.000,").replace("\n10,", "\n2024-03-01 12:00:10,"), {}),
    "dates in a zone": (GOOD.replace("\n0,", "\n2024-03-01T12:00:00Z,").replace("\n5,", "\n2024-03-01T12:00:05Z,").replace("\n10,", "\n2024-03-01T13:00:10+01:00,"), {}),
    "dates without header": (TABLE.replace("0,30", "2024-03-01 12:00:00,30").replace("5,60", "2024-03-01 12:00:05,60").replace("10,90", "2024-03-01 12:00:10,90"), {"columns": ("time", *COLUMNS[1:])}),
    "time of day over midnight": (GOOD.replace("\n0,", "\n23:59:55,").replace("\n5,", "\n00:00:00.0,").replace("\n10,", "\n0:00:05,"), {}),
    "format": (GOOD.replace("\n0,", "\n01.03.2024 12:00:00,").replace("\n5,", "\n01.03.2024 12:00:05,").replace("\n10,", "\n01.03.2024 12:00:10,"), {"time_format": "%d.%m.%Y %H:%M:%S"}),
    "several spaces": (" " + TABLE.replace(",", "   ").replace("\n", " \n  "), {"columns": COLUMNS, "delimiter": " "}),
    "several spaces and stamps": ("time temperature strain\n 12:00:00   30    4\n 12:00:05   60    2\n 12:00:10   90  0.5 \n", {"columns": COLUMNS, "delimiter": " "}),
    "delimiter at the end of each row": (GOOD.replace("\n", ",\n"), {}),
    "delimiter at the end of the rows of data": (",".join(COLUMNS) + "\n" + TABLE.replace("\n", ",\n"), {}),
    "milliseconds": (GOOD.replace("[s]", "[ms]").replace("\n5,", "\n5000,").replace("\n10,", "\n10000,"), {}),
    "sample period": ("temperature [degC],strain [%]\n30,4\n60,2\n90,0.5\n", {"sample_period": "5 s"}),
    "row numbers": (",temperature [degC],strain [%]\n0,30,4\n1,60,2\n2,90,0.5\n", {"sample_period": 5.0}),
    "row numbers saved again": ("Unnamed: 0,time [s],temperature [degC],strain [%]\n7,0,30,4\n8,5,60,2\n9,10,90,0.5\n", {}),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_gives_the_same_recording(read, layout):
    content, options = LAYOUTS[layout]
    assert_is_the_cycle(read(content, **options))


def test_what_is_recognised_is_noted(read):
    assert read(",".join(PLAIN) + "\ns,degC,%\n" + TABLE).notes == ("row 2 was read as units",)
    notes = read(",temperature [degC],strain [%]\n0,30,4\n1,60,2\n", sample_period="20 ms").notes
    assert notes == ("column 1, which has no header and counts the rows, was left out",)


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "title": ("Specimen: 3\n" + GOOD, {}, "row 1: the row has a single cell, 'Specimen: 3', and row 2 has 3: set skip_rows = 1"),
    "unknown units": (",".join(COLUMNS) + "\nsec.,Cels.,pct.\n" + TABLE, {}, "row 2, column 'time [s]': 'sec.' is not a number: set units_row = true"),
    "units that differ": (GOOD.replace("\n0", "\nmin,degC,%\n0", 1), {}, "row 2: the header 'time [s]' and the unit 'min' below it differ"),
    "other stamps": (GOOD.replace("\n0,", "\n01.03.2024 12:00:00,"), {}, "is a time stamp of another format: give its format, as in time_format ="),
    "wrong encoding": (GOOD, {"encoding": "utf-99"}, 'encoding = "utf-99" is not known'),
    "codec that is no encoding": (GOOD, {"encoding": "zlib"}, 'encoding = "zlib" is not known'),
    "clock twice": (GOOD, {"sample_period": "5 s"}, "there is a time column, and sample_period = 5000 ms: remove sample_period"),
    "number of columns": (GOOD, {"columns": PLAIN[:2]}, "row 1: the row has 3 cells, and 2 columns are named: name every column"),
    "header false": (GOOD, {"header": False}, "header = false needs names: give columns"),
    "misspelt": (GOOD, {"skiprows": 1}, "'skiprows' is not an option of reading (did you mean 'skip_rows'?)"),
    "bad rows": (GOOD, {"on_bad_rows": "drops"}, "on_bad_rows = \"drops\" is not known (did you mean 'drop'?)"),
    "period": (GOOD, {"sample_period": -1.0}, "sample_period = -1.0 is not a time"),
    "format": (GOOD, {"time_format": "HH:MM"}, 'time_format = "HH:MM" is not a format'),
    "no row numbers": (",time [s],temperature [degC]\n5,0,30\n5,5,60\n", {}, "column 1 has no header, and does not count the rows"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_the_option(read, fault):
    content, options, sentence = REFUSED[fault]
    with pytest.raises(InputError) as refusal:
        read(content, **options)
    assert str(refusal.value).startswith("cycle.csv: ") and sentence in str(refusal.value)


def test_raw_numbers_are_scaled(read):
    """Counts of a load cell that fall as the force rises, a duty of 8 bits, and a voltage from a fraction of 5 V."""
    mapping = {
        "force": ChannelMap("load cell", "N", factor=-0.0087, offset=7.5),
        "duty": ChannelMap("pwm", full_scale=255),
        "voltage": ChannelMap("adc", "V", factor=5.0, full_scale=1023),
    }
    recording = read("load cell,pwm,adc\n804,0,0\n100,255,1023\n", mapping=mapping, sample_period="20 ms")
    np.testing.assert_allclose(recording.channels["force"], [7.5 - 0.0087 * 804, 7.5 - 0.87])
    assert recording.channels["duty"].tolist() == [0.0, 1.0] and recording.time.tolist() == [0.0, 0.02]
    assert recording.channels["voltage"].tolist() == [0.0, 5.0]
    assert "force was read as (-0.0087 * number + 7.5) N of column 'load cell', as the rig says" in recording.notes


def test_a_value_that_a_wrong_scale_makes_impossible_names_the_scale(read):
    mapping = {"duty": ChannelMap("pwm", full_scale=255.0)}
    with pytest.raises(InputError, match="of 1.56863 is above 1: correct factor, offset or full_scale of duty under"):
        read("time [s],pwm\n0,0\n1,400\n2,30\n", mapping=mapping)


def test_values_beyond_the_limits_of_a_register_count_as_the_limit(read, tmp_path):
    """A register of 8 bits that a corrupt packet sets to 1000 is always on; limits need no scale."""
    mapping = {"duty": ChannelMap("pwm", full_scale=255, limits=(0.0, 1.0)), "ambient": ChannelMap("room", "degC")}
    recording = read("pwm,room\n0,20\n51,21\n1000,22\n-3,23\n", mapping=mapping, sample_period="20 ms")
    assert recording.channels["duty"].tolist() == [0.0, 0.2, 1.0, 0.0]
    assert "2 of 4 values of duty were limited to 0 to 1, as the rig says" in recording.notes
    unscaled = {"ambient": ChannelMap("room", "degC", limits=(21.0, 22.0))}
    recording = read("room\n20\n21\n23\n", mapping=unscaled, sample_period="20 ms")
    assert recording.channels["ambient"].tolist() == [21.0, 21.0, 22.0]
    within = read("room\n21\n21.5\n", mapping=unscaled, sample_period="20 ms")
    assert not any("limited" in note for note in within.notes)
    with pytest.raises(InputError, match="limits = .* are not possible: give the least and the largest value"):
        ChannelMap("pwm", limits=(1.0, 0.0))
    text = RIG + SCALED.replace("full_scale = 255", "full_scale = 255, limits = [0, 1]")
    (tmp_path / "log.csv").write_text(LOG.replace("2,700,255", "2,700,1025"))
    rig = parse_rig(text + '[recording]\nsample_period = "20 ms"\n')
    again = parse_rig(rig.to_toml())
    assert again.channels == rig.channels and rig.channels.columns["duty"].limits == (0.0, 1.0)
    assert again.read(tmp_path / "log.csv").channels["duty"].tolist() == [0.0, 1.0, 1.0]
    with pytest.raises(InputError, match="channels.duty.limits"):
        parse_rig(text.replace("limits = [0, 1]", "limits = [0]"))


RIG = """
schema = 1
[rig]
kind = "bias-spring"
control = "duty"
[material]
set = "rotary-table1"
[heat]
h0 = "60 W/m^2/K"
capacity = "2.05 MJ/m^3/K"
[drive]
supply = "5 V"
[wire]
diameter = "0.15 mm"
length = "230 mm"
[spring]
stiffness = "0.5 N/mm"
preload = "0.5 N"
[environment]
ambient = "24 degC"
[fit]
observe = ["force"]
"""
SCALED = """
[channels]
force = {column = "load cell", factor = -0.0087, offset = 7.5, unit = "N"}
duty = {column = "pwm", full_scale = 255}
"""
LOG = ",load cell,pwm\n0,804,0\n1,800,255\n2,700,255\n"


def test_a_rig_reads_a_raw_log_and_is_written_with_its_options(tmp_path):
    (tmp_path / "log.csv").write_text(LOG)
    rig = parse_rig(RIG + SCALED + '[recording]\nsample_period = "20 ms"\non_bad_rows = "drop"\n')
    again = parse_rig(rig.to_toml())
    assert again.recording == rig.recording == ReadOptions(sample_period=0.02, on_bad_rows="drop")
    assert again.channels == rig.channels
    for each in (rig, again):
        recording = each.read(tmp_path / "log.csv")
        assert recording.time.tolist() == [0.0, 0.02, 0.04] and recording.channels["duty"].tolist() == [0.0, 1.0, 1.0]
    slower = rig.with_read_options(sample_period="1 s")
    assert slower.read(tmp_path / "log.csv").time.tolist() == [0.0, 1.0, 2.0]


@pytest.mark.parametrize(
    ("section", "sentence"),
    [
        ('[channels]\nforce = {column = "x", unit = "counts"}', "channels.force: 'counts' is not a unit of force: give the scale"),
        ('[channels]\nduty = {column = "x", unit = "1/255"}', "channels.duty: '1/255' is not a unit of duty: give the number that stands for 1"),
        ('[channels]\nforce = {column = "x", factor = 0.0, unit = "N"}', "channels.force: factor = 0.0 of column 'x' is not possible"),
        ("[recording]\nskip_rows = -1", "recording.skip_rows"),
        ('[recording]\nsample_period = "20 mm"', "recording.sample_period"),
        ('[recording]\non_bad_rows = "dorp"', "recording.on_bad_rows"),
        ("[channels]\nskip_rows = 1\n[recording]\nskip_rows = 1", "channels.skip_rows and recording.skip_rows are both given"),
        ('[recording]\ndelimiter = ","\ndecimal = ","', 'recording.delimiter and recording.decimal are both ","'),
    ],
)  # fmt: skip
def test_sections_that_are_refused(section, sentence):
    with pytest.raises(InputError) as refusal:
        parse_rig(RIG + section)
    assert sentence in str(refusal.value)


def test_old_keys_of_channels_are_read():
    old = parse_rig(RIG + '[channels]\nskip_rows = 2\ndelimiter = ";"\ndecimal = ","\nsheet = "run 2"\n')
    assert old.recording == ReadOptions(skip_rows=2, delimiter=";", decimal=",", sheet=("run 2",))


RESTART = ",".join(COLUMNS) + "\n0,30,4\n1,31,4.1\n2,32,4.2\n0,40,3\n1,41,3.1\n2,42,3.2\n"


def test_a_restart_of_the_clock_splits_the_recording_on_request(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(RESTART)
    with pytest.raises(
        InputError, match=r"row 5, column 'time \[s\]': time decreases from 2 to 0 s, where the clock beg"
    ):
        read_recording("log.csv")
    parts = read_recordings("log.csv", on_bad_rows="split")
    assert [part.name for part in parts] == ["log.csv part 1", "log.csv part 2"]
    assert [part.channels["temperature"].tolist() for part in parts] == [[30, 31, 32], [40, 41, 42]]
    assert parts[1].notes == (
        "part 2 of 2: rows 5 to 7",
        "1 of 6 rows in which the clock begins again begin a part: row 5",
    )
    with pytest.raises(InputError, match="2 recordings were read"):
        read_recording("log.csv", on_bad_rows="split")


def test_a_corrupt_row_and_a_repeated_stamp(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    Path("log.csv").write_text(
        ",".join(COLUMNS) + "\n0,30,4\n1,31,4.1\n2,\xff,4\n3,33,4\n4,34,4.2\n4,35,4\n5,36,4.5\n", "cp1252"
    )
    with pytest.raises(InputError, match=r"row 4, column 'temperature \[degC\]': 'ÿ' is not a number"):
        read_recording("log.csv")
    dropped = read_recording("log.csv", on_bad_rows="drop")
    assert dropped.time.tolist() == [0, 1, 3, 4, 5] and "row 4" in dropped.notes[0] and "row 7" in dropped.notes[1]
    (part,) = read_recordings("log.csv", on_bad_rows="split")
    assert part.time.tolist() == [0, 1, 3, 4, 5] and part.name == "log.csv"
    assert part.notes == (
        "1 of 7 rows with a blank or unreadable cell left out on request: row 4",
        "1 of 7 rows in which time does not increase left out on request: row 7",
    )


# Times of a log, those that are kept by drop, and those of the parts by split.
CLOCKS = {
    "single rows out of order": ([0, 1, 2, 1.5, 3, 4], [0, 1, 2, 3, 4], [[0, 1, 2, 3, 4]]),
    "the last row out of order": ([0, 1, 2, 3, 2.5], [0, 1, 2, 3], [[0, 1, 2, 3]]),
    "a corrupt stamp": ([0, 1, 999, 3, 4, 5], [0, 1, 3, 4, 5], [[0, 1, 3, 4, 5]]),
    "a corrupt stamp that is too low": ([0, 1, -7, 3, 4, 5], [0, 1, 3, 4, 5], [[0, 1, 3, 4, 5]]),
    "two restarts": ([0, 1, 2, 3, 4, 0, 1, 0, 1], [0, 1, 2, 3, 4], [[0, 1, 2, 3, 4], [0, 1], [0, 1]]),
    "a restart and repeated stamps": ([0, 1, 1, 2, 3, 4, 4, 0, 0, 1], [0, 1, 2, 3, 4], [[0, 1, 2, 3, 4], [0, 1]]),
    "a restart at a later time": ([10, 11, 12, 13, 14, 5, 6], [10, 11, 12, 13, 14], [[10, 11, 12, 13, 14], [5, 6]]),
    "a restart of a single row": ([0, 1, 2, 3, 0, 0], [0, 1, 2, 3], [[0, 1, 2, 3]]),
}


@pytest.mark.parametrize("kind", CLOCKS)
def test_a_part_begins_where_the_clock_does_and_other_bad_rows_are_left_out(tmp_path, kind):
    times, dropped, split = CLOCKS[kind]
    path = tmp_path / "log.csv"
    path.write_text("time [s],current [A]\n" + "".join(f"{t},{k}\n" for k, t in enumerate(times)))
    recording = read_recording(path, on_bad_rows="drop")
    assert (
        recording.time.tolist() == dropped and f"{len(times) - len(dropped)} of {len(times)} rows" in recording.notes[0]
    )
    parts = read_recordings(path, on_bad_rows="split")
    assert [part.time.tolist() for part in parts] == split
    assert len(parts) == 1 or parts[0].notes[0].startswith(f"part 1 of {len(parts)}: rows 2 to ")


def test_a_clock_that_is_coarser_than_the_rows_says_so(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text("time [s],current [A]\n" + "".join(f"{k // 10},{k % 7}\n" for k in range(50)))
    for on_bad_rows in ("drop", "split"):
        with pytest.raises(InputError, match="45 of 50 rows are bad.*the time is coarser than the rows: leave its col"):
            read_recordings(path, on_bad_rows=on_bad_rows)


@pytest.fixture
def workbook(tmp_path):
    book = openpyxl.Workbook()
    for k, name in enumerate(("50 MPa", "100 MPa", "notes")):
        sheet = book.active if k == 0 else book.create_sheet()
        sheet.title = name
        for row in (COLUMNS, (0, 30 + k, 4), (5, 60 + k, 2), (10, 90 + k, 0.5)) if k < 2 else ():
            sheet.append(row)
    book.save(tmp_path / "cycles.xlsx")
    return tmp_path / "cycles.xlsx"


def test_sheets_are_named_or_all_and_those_left_out_are_named(workbook):
    first = read_recording(workbook)
    assert first.notes == ("sheet '50 MPa' was read, and not 100 MPa: name others, or all, by sheet (--sheet)",)
    both = read_recordings(workbook, sheet="all")
    assert [recording.channels["temperature"][0] for recording in both] == [30.0, 31.0]
    assert not any(recording.notes for recording in both)
    assert read_recording(workbook, sheet="100 MPa").channels["temperature"][0] == 31.0
    with pytest.raises(InputError, match="there is no sheet '200 MPa'"):
        read_recordings(workbook, sheet=["50 MPa", "200 MPa"])


RESTARTED = {"time": [0.0, 1.0, 2.0, 0.0, 1.0, 2.0], "current": [0.0, 0.1, np.nan, 0.3, 0.4, 0.5]}


def test_a_workbook_with_decimal_commas_needs_no_delimiter(tmp_path):
    book = openpyxl.Workbook()
    for row in (COLUMNS, *(line.replace(".", ",").split(";") for line in ("0;30;4", "5;60;2", "10;90;0.5"))):
        book.active.append(row)
    book.save(tmp_path / "cycle.xlsx")
    assert_is_the_cycle(read_recording(tmp_path / "cycle.xlsx", decimal=","))
    options = parse_rig(RIG + '[recording]\ndecimal = ","\n').recording
    assert_is_the_cycle(read_recording(tmp_path / "cycle.xlsx", options=options))


def test_a_column_without_header_and_values_is_left_out_and_noted(read):
    recording = read(GOOD.replace("\n", ",\n"))
    assert recording.notes == ("column 4, with neither a header nor values in the first rows, was left out",)


def test_a_recording_and_a_table_in_memory_are_split(tmp_path):
    table = pd.DataFrame({"time [s]": RESTARTED["time"], "current [A]": RESTARTED["current"]})
    recording = Recording.from_arrays("run", np.array(RESTARTED["time"]), {"current": np.array(RESTARTED["current"])})
    for source, name in ((table, "recording"), (recording, "run")):
        parts = read_recordings(source, required=("current",), on_bad_rows="split")
        assert [part.name for part in parts] == [f"{name} part 1", f"{name} part 2"]
        assert [part.time.tolist() for part in parts] == [[0.0, 1.0], [0.0, 1.0, 2.0]]
        assert parts[1].channels["current"].tolist() == [0.3, 0.4, 0.5]
        assert parts[1].notes[0] == "part 2 of 2: rows 3 to 5" and "1 of 6 rows with a blank" in parts[1].notes[1]
    with pytest.raises(InputError, match=r"^run: row 2, column 'current \[A\]'"):
        read_recordings(recording, required=("current",))
    with pytest.raises(InputError, match="^run: no part has two rows"):
        still = Recording.from_arrays("run", np.zeros(2), {"current": np.ones(2)})
        read_recordings(still, required=("current",), on_bad_rows="split")


def test_an_observed_channel_may_be_missing_in_rows_where_a_recording_is_split():
    channels = {"current": np.full(4, 0.2), "force": np.array([1.0, np.nan, 2.0, 3.0])}
    recording = Recording.from_arrays("run", np.array([0.0, 1.0, 0.0, 1.0]), channels)
    parts = read_recordings(recording, required=("current",), on_bad_rows="split")
    assert [len(part) for part in parts] == [2, 2]


def test_parts_of_recordings_with_one_name_have_distinct_names():
    channels = {"duty": np.array([0.0, 1.0, 0.0, 1.0]), "force": np.array([1.0, 2.0, 3.0, 4.0])}
    runs = [Recording.from_arrays("run", np.array([0.0, 1.0, 0.0, 1.0]), channels) for _ in range(2)]
    pairs = read_train_and_holdout(parse_rig(RIG + '[recording]\non_bad_rows = "split"\n'), runs, [])
    assert [part.name for part, _ in pairs] == ["run part 1", "run part 2", "run 2 part 1", "run 2 part 2"]


NEW_OPTIONS = """
[recording]
date_column = "Date"
sheet = ["run 1", "run 2"]
variable = "run.data"
clock_topic = "/cell"
topic_interpolation = "linear"
"""


def test_options_of_formats_are_read_from_the_rig_and_written():
    rig = parse_rig(RIG + NEW_OPTIONS)
    expected = ReadOptions(
        date_column="Date",
        sheet=("run 1", "run 2"),
        variable="run.data",
        clock_topic="/cell",
        topic_interpolation="linear",
    )
    assert rig.recording == parse_rig(rig.to_toml()).recording == expected
    with pytest.raises(InputError, match="recording.topic_interpolation"):
        parse_rig(RIG + '[recording]\ntopic_interpolation = "cubic"\n')


@pytest.mark.slow
def test_the_same_options_are_on_the_command_line(tmp_path):
    cycle = np.concatenate([np.linspace(20.0, 110.0, 200), np.linspace(110.0, 20.0, 200)])
    lag = np.concatenate([np.full(200, 75.0), np.full(200, 50.0)])
    strain = 2.0 - 1.5 * np.tanh((cycle - lag) / 8.0)
    scipy.io.savemat(tmp_path / "cycles.mat", {"raw": np.ones((3, 3)), "data": np.column_stack([cycle, strain])})
    command = ["properties", str(tmp_path / "cycles.mat")]
    names = ["--columns", "temperature [degC],strain [%]"]
    done = CliRunner().invoke(app, [*command, "--variable", "data", *names])
    assert done.exit_code == 0, done.output
    refused = CliRunner().invoke(app, [*command, *names])
    assert refused.exit_code == 2 and "name it by --variable, as in --variable raw" in " ".join(refused.output.split())
    options = ["--date-column", "D", "--clock-topic", "/a", "--topic-interpolation", "hold", "--sheet", "all"]
    unused = CliRunner().invoke(app, [*command, "--variable", "data", *names, *options])
    assert unused.exit_code == 0, unused.output


BAD_FILES = {
    "log.jsonl": b"{}",
    "log.json": b"{",
    "log.tdms": b"x",
    "log.mcap": b"x",
    "log.bag": b"x",
    "log.mat": b"MATLAB 7.3 MAT-file",
}


@pytest.mark.parametrize("name", BAD_FILES)
def test_bad_files_are_refused_before_jax_is_loaded(tmp_path, name):
    (tmp_path / name).write_bytes(BAD_FILES[name])
    code = (
        "import sys, smajax.recordings as r\n"
        "try:\n"
        f"    r.read_recording({str(tmp_path / name)!r})\n"
        "except ValueError as error:\n"
        "    print(error)\n"
        "print('jax' in sys.modules)"
    )
    done = subprocess.run([sys.executable, "-c", code], check=True, capture_output=True, text=True, cwd=ROOT)
    sentence, loaded = done.stdout.splitlines()
    assert loaded == "False" and sentence.startswith(str(tmp_path / name))


@pytest.mark.parametrize("ending", [".tsv", ".dat", ".log", ".LOG"])
def test_text_of_other_endings_is_read(tmp_path, ending):
    (tmp_path / f"a{ending}").write_text("time [s]\tcurrent [A]\n0\t1\n1\t2\n")
    recording = read_recording(tmp_path / f"a{ending}", delimiter="\t")
    assert recording.time.tolist() == [0.0, 1.0] and recording.channels["current"].tolist() == [1.0, 2.0]
    with pytest.raises(InputError, match=r"give --delimiter|delimiter = "):
        read_recording(tmp_path / f"a{ending}")


QUOTED = {
    "as one cell": '"time [s],current [A]"\n"0,0.1"\n"1,0.2"\n',
    "with names in marks": '"""time [s]"",""current [A]"""\n"0,0.1"\n"1,0.2"\n',
    "with a title": '"Test, of Monday"\n"time [s],current [A]"\n"0,0.1"\n"1,0.2"\n',
    "with units": '"time,current"\n"s,A"\n"0,0.1"\n"1,0.2"\n',
}


@pytest.mark.parametrize("kind", QUOTED)
def test_rows_in_quotation_marks_as_a_whole_are_divided(tmp_path, kind):
    path = tmp_path / "log.csv"
    path.write_text(QUOTED[kind])
    recording = read_recording(path, skip_rows=int(kind == "with a title"))
    assert recording.time.tolist() == [0, 1] and recording.channels["current"].tolist() == [0.1, 0.2]
    assert "every row is in quotation marks as a whole, which were taken off" in recording.notes
    assert sma.import_recording(path).recordings[0].channels["current"].tolist() == [0.1, 0.2]


def test_a_remark_in_quotation_marks_stays_one_cell(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text('time [s],current [A],remark\n0,0.1,"warm, dry"\n1,0.2,"wet, cold"\n')
    recording = read_recording(path, ignore=["remark"])
    assert recording.channels["current"].tolist() == [0.1, 0.2] and not any("marks" in n for n in recording.notes)
