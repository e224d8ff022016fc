"""Dates: columns of DataFrames and Parquet files, and date and time of day in two columns of a text file or sheet."""

import datetime
from pathlib import Path
from typing import Any

import numpy as np
import openpyxl
import pandas as pd
import pyarrow as pa
import pyarrow.parquet as pq
import pytest

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording
from smajax.recordings.recording import Recording

CURRENT = [0.0, 1.0, 2.0]
TIMES = [0.0, 0.5, 65.0]
START = datetime.datetime(2024, 3, 1, 23, 59, 30)
STAMPS = [START + datetime.timedelta(seconds=t) for t in TIMES]
SECONDS = np.array(TIMES)
DATES = pd.DatetimeIndex(STAMPS)


def assert_is_the_recording(recording: Recording) -> None:
    np.testing.assert_allclose(recording.time, TIMES, rtol=1e-12)
    assert recording.channels["current"].tolist() == CURRENT


def frame(time: Any, name: str = "time") -> pd.DataFrame:
    return pd.DataFrame({name: time, "current [A]": CURRENT})


TABLES: dict[str, tuple[Any, dict[str, Any]]] = {
    "pandas dates": (frame(DATES), {}),
    "pandas dates in microseconds": (frame(DATES.as_unit("us")), {}),
    "pandas dates in a zone": (frame(DATES.tz_localize("Europe/Berlin")), {}),
    "pandas durations": (frame(pd.to_timedelta(SECONDS, unit="s")), {}),
    "pandas texts": (frame([str(stamp) for stamp in STAMPS]), {}),
    "pandas texts of a format": (frame([f"{s:%d.%m.%Y %H:%M:%S.%f}" for s in STAMPS]), {"time_format": "%d.%m.%Y %H:%M:%S.%f"}),
    "pandas times of day": (frame([stamp.time() for stamp in STAMPS]), {}),
    "pandas dates of another name": (frame(DATES, "Stamp"), {"mapping": {"time": ChannelMap("Stamp")}}),
    "pyarrow dates": (pa.table({"time": STAMPS, "current [A]": CURRENT}), {}),
    "pyarrow durations": (pa.table({"time": [s - START for s in STAMPS], "current [A]": CURRENT}), {}),
    "dictionary of datetime64": ({"time": np.array(STAMPS, "datetime64[us]"), "current [A]": CURRENT}, {}),
    "dictionary of datetimes": ({"time": STAMPS, "current [A]": CURRENT}, {}),
}  # fmt: skip


@pytest.mark.parametrize("table", TABLES)
def test_dates_in_memory_are_the_time(table):
    source, options = TABLES[table]
    assert_is_the_recording(read_recording(source, **options))


FILES: dict[str, tuple[pa.Table, dict[str, Any]]] = {
    "dates": (pa.table({"time": STAMPS, "current [A]": CURRENT}), {}),
    "dates in ms": (pa.table({"time": pa.array(STAMPS, pa.timestamp("ms")), "current [A]": CURRENT}), {}),
    "dates in a zone": (pa.table({"time": pa.array(STAMPS, pa.timestamp("us", "Asia/Tokyo")), "current [A]": CURRENT}), {}),
    "durations": (pa.table({"time": pa.array([s - START for s in STAMPS]), "current [A]": CURRENT}), {}),
    "times of day": (pa.table({"time": pa.array([s.time() for s in STAMPS]), "current [A]": CURRENT}), {}),
    "texts": (pa.table({"time": [str(stamp) for stamp in STAMPS], "current [A]": CURRENT}), {}),
    "index of pandas": (pa.Table.from_pandas(frame(DATES).set_index("time")), {}),
    "index of pandas without a name": (pa.Table.from_pandas(frame(DATES).set_index("time").rename_axis(None)), {}),
    "another name": (pa.table({"t": STAMPS, "current [A]": CURRENT}), {"mapping": {"time": ChannelMap("t")}}),
}  # fmt: skip


@pytest.mark.parametrize("file", FILES)
def test_dates_in_parquet_files_are_the_time(tmp_path, file):
    table, options = FILES[file]
    pq.write_table(table, tmp_path / "wire.parquet")
    assert_is_the_recording(read_recording(tmp_path / "wire.parquet", **options))


def test_missing_dates_are_bad_rows(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    dates = [STAMPS[0], None, STAMPS[2]]
    pq.write_table(pa.table({"time": dates, "current [A]": CURRENT}), "wire.parquet")
    for source, place in (
        ("wire.parquet", "wire.parquet: row 2, column 'time'"),
        (frame(dates), "the DataFrame: row 1, column 'time'"),
    ):
        with pytest.raises(InputError) as refusal:
            read_recording(source)
        assert str(refusal.value).startswith(place)
        assert read_recording(source, drop_bad_rows=True).time.tolist() == [0.0, 65.0]
    with pytest.raises(
        InputError, match=r"the DataFrame: row 1, column 'time': 'noon' is not a time stamp like the first"
    ):
        read_recording(frame([str(STAMPS[0]), "noon", str(STAMPS[2])]))


HEADER = "Date,Time,current [A]\n"
MAPPING = {"time": ChannelMap("Time")}


def rows(date_format: str, time_format: str) -> str:
    return "".join(f"{s:{date_format}},{s:{time_format}},{c}\n" for s, c in zip(STAMPS, CURRENT, strict=True))


TEXTS: dict[str, tuple[str, dict[str, Any]]] = {
    "ISO": (HEADER + rows("%Y-%m-%d", "%H:%M:%S.%f"), {}),
    "format": (HEADER + rows("%d.%m.%Y", "%H:%M:%S.%f"), {"time_format": "%d.%m.%Y %H:%M:%S.%f"}),
    "twelve hours": (HEADER + rows("%m/%d/%Y", "%I:%M:%S.%f %p"), {"time_format": "%m/%d/%Y %I:%M:%S.%f %p"}),
    "other names": ("Tag,Uhrzeit,current [A]\n" + rows("%d.%m.%Y", "%H:%M:%S.%f"), {"time_format": "%d.%m.%Y %H:%M:%S.%f", "date_column": "Tag", "mapping": {"time": ChannelMap("Uhrzeit")}}),
    "time first": ("time,date,current [A]\n" + rows("%H:%M:%S.%f", "%Y-%m-%d"), {"mapping": {}}),
    "no header": (rows("%Y-%m-%d", "%H:%M:%S.%f"), {"columns": ("date", "time", "current [A]"), "mapping": {}}),
    "date left out": (HEADER + rows("%Y-%m-%d", "%H:%M:%S.%f"), {"ignore": ["Date"]}),
}  # fmt: skip


@pytest.mark.parametrize("text", TEXTS)
def test_date_and_time_of_day_in_two_columns_are_joined(tmp_path, text):
    content, options = TEXTS[text]
    (tmp_path / "wire.csv").write_text(content)
    recording = read_recording(tmp_path / "wire.csv", **{"mapping": MAPPING, **options})
    assert_is_the_recording(recording)
    assert ("were joined to date and time" in " ".join(recording.notes)) == ("ignore" not in options)


def test_two_columns_of_a_workbook_are_joined(tmp_path):
    for name, cells in {
        "cells": [(s.date(), s.time()) for s in STAMPS],
        "texts": [(f"{s:%Y-%m-%d}", f"{s:%H:%M:%S.%f}") for s in STAMPS],
    }.items():
        book = openpyxl.Workbook()
        sheet: Any = book.active
        sheet.append(["Date", "Time", "current [A]"])
        for cell, current in zip(cells, CURRENT, strict=True):
            sheet.append([*cell, current])
        book.save(tmp_path / f"{name}.xlsx")
        assert_is_the_recording(read_recording(tmp_path / f"{name}.xlsx", mapping=MAPPING))


REFUSED: dict[str, tuple[str, dict[str, Any], str]] = {
    "other dates": (HEADER + rows("%d.%m.%Y", "%H:%M:%S"), {}, "wire.csv: row 2: columns 'Date' and 'Time' are not read as date and time of day: give the format of both with a space between, as in time_format"),
    "format of the dates alone": (HEADER + rows("%d.%m.%Y", "%H:%M:%S"), {"time_format": "%d.%m.%Y", "date_column": "Date"}, "columns 'Date' and 'Time' are not read as date and time of day"),
    "misspelt": (HEADER + rows("%Y-%m-%d", "%H:%M:%S"), {"date_column": "Dat"}, "there is no column 'Dat' for date_column (did you mean 'Date'?): it has Date, Time, current [A]"),
    "bad date": (HEADER + rows("%Y-%m-%d", "%H:%M:%S.%f") + "2024-03-32,00:02:00,1\n", {}, "wire.csv: row 5, column 'Time': '2024-03-32 00:02:00' is a time stamp of another format"),
    "no dates": ("Date,time [s],current [A]\nx,0,0\nx,1,1\n", {"mapping": {}}, "wire.csv: column 'Date' is not a known channel"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_the_option(tmp_path, monkeypatch, fault):
    content, options, sentence = REFUSED[fault]
    monkeypatch.chdir(tmp_path)
    Path("wire.csv").write_text(content)
    with pytest.raises(InputError) as refusal:
        read_recording("wire.csv", **{"mapping": MAPPING, **options})
    assert str(refusal.value).startswith("wire.csv: ") and sentence in str(refusal.value)


def test_dates_of_a_table_in_memory_are_not_joined():
    table = pd.DataFrame({"Date": DATES.date, "Time": DATES.time, "current [A]": CURRENT})
    with pytest.raises(InputError, match="the DataFrame: date_column is for text files and workbooks: join the dates"):
        read_recording(table, mapping=MAPPING, date_column="Date")
    assert_is_the_recording(read_recording(frame(DATES), date_column="Date"))
