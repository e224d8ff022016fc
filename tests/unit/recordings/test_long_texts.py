"""Headers, cells and answers of ten thousands of characters: read or refused as fast as they are loaded."""

import contextlib
import csv
import io
import json
import time
from pathlib import Path

import pyarrow
import pyarrow.parquet
import pytest

from smajax.channels import channel_suggestion
from smajax.errors import InputError
from smajax.recordings.column_mapping import name_and_unit
from smajax.recordings.read import read_recordings
from smajax.recordings.readers.base import parse_number
from smajax.recordings.recognition.answers import parse_answer
from smajax.recordings.recognition.header_words import split_unit
from smajax.recordings.recognition.recognise import recognise

LENGTH = 30_000
# Seconds of the processor for a text of that length; a pattern that tries all pairs of its characters needs minutes.
LIMIT = 4.0
TEXTS = {
    "digits": "1" * LENGTH,
    "digits and a sign": "1" * LENGTH + "-",
    "points": "1." * (LENGTH // 2),
    "exponents": "1e" * (LENGTH // 2),
    "spaces": "a" + " " * LENGTH + "b",
    "open brackets": "a [" + "[" * LENGTH,
    "brackets": "a(" * (LENGTH // 2),
    "slashes": "a/ " * (LENGTH // 3),
    "commas": "a, " * (LENGTH // 3),
    "in": "a in " * (LENGTH // 5),
    "powers": "x [" + "m^9" * (LENGTH // 3) + "]",
    "zeros": "current_" + "0" * LENGTH + "a",
    "words": "Ab1#" * (LENGTH // 4),
    "quotes": '"' * LENGTH,
}


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    return tmp_path


def rows_with(text: str, place: str) -> list[list[str]]:
    """A table with a text as a header, as a cell, as the first time, or as all times."""
    rows = [["time [s]", "current [A]", "displacement [mm]"], *[[f"{k / 2}", f"{k / 10}", f"{k}"] for k in range(8)]]
    if place == "header":
        rows[0][1] = text
    elif place == "cell":
        rows[3][1] = text
    else:
        for row in rows[1:2] if place == "first time" else rows[1:]:
            row[0] = text
    return rows


def files_of(rows: list[list[str]]) -> list[Path]:
    """The table as CSV with and without quotes, as JSON, and, where its cells are numbers, as Parquet."""
    stream = io.StringIO()
    csv.writer(stream).writerows(rows)
    Path("quoted.csv").write_text(stream.getvalue(), "utf-8")
    Path("bare.csv").write_text("".join(",".join(row) + "\n" for row in rows), "utf-8")
    Path("wire.json").write_text(json.dumps([dict(zip(rows[0], row, strict=True)) for row in rows[1:]]), "utf-8")
    names = ["quoted.csv", "bare.csv", "wire.json"]
    with contextlib.suppress(ValueError):
        columns = {header: [float(row[k]) for row in rows[1:]] for k, header in enumerate(rows[0])}
        pyarrow.parquet.write_table(pyarrow.table(columns), "wire.parquet")
        names.append("wire.parquet")
    return [Path(name) for name in names]


@pytest.mark.slow
@pytest.mark.parametrize("place", ["header", "cell", "first time", "all times"])
@pytest.mark.parametrize("text", TEXTS)
def test_long_texts_are_read_or_refused_at_once(text, place):
    for path in files_of(rows_with(TEXTS[text], place)):
        for read in (read_recordings, lambda path: recognise(path, {}, {})):
            begin = time.process_time()
            with contextlib.suppress(InputError):
                read(path)
            assert time.process_time() - begin < LIMIT, path


@pytest.mark.parametrize("text", TEXTS)
def test_long_names_and_answers_are_understood_at_once(text):
    begin = time.process_time()
    for function in (name_and_unit, split_unit, channel_suggestion, lambda word: parse_number(word, ".")):
        function(TEXTS[text])
    with contextlib.suppress(InputError):
        parse_answer("F", TEXTS[text])
    with pytest.raises(InputError, match="does not say what it is"):
        parse_answer("F", "force" + ",a=b" * 100 + " ]")
    assert time.process_time() - begin < LIMIT


@pytest.mark.parametrize(
    ("header", "name", "unit"),
    [
        ("Force (N)", "Force", "N"),
        ("a) Force [N] ", "a) Force", "N"),
        ("f(x) <mm>", "f(x)", "mm"),
        ("Temperatur / °C", "Temperatur", "°C"),
        ("stroke/ mm", "stroke", "mm"),
        ("stroke /mm", "stroke", "mm"),
        ("stroke in mm", "stroke", "mm"),
        ("stroke, mm", "stroke", "mm"),
        ("stroke,mm", "stroke", "mm"),
        ("m/s", "m/s", ""),
        ("begin mm", "begin mm", ""),
        ("pin mm", "pin mm", ""),
        ("in mm", "in mm", ""),
        ("Force (N", "Force (N", ""),
        ("]", "]", ""),
        ("", "", ""),
    ],
)
def test_units_of_headers(header, name, unit):
    assert split_unit(header) == (name, unit)


def test_numbers_and_headers_are_read_as_before():
    cells = ["1", "+1.", ".5", "-1.5e-3", "1e5", "1e", ".", "", "1.2.3", "--1", "1 ", "1e999", "0x1"]
    assert [parse_number(cell, ".") for cell in cells[:5]] == [1, 1, 0.5, -0.0015, 1e5]
    assert [parse_number(cell, ".") for cell in cells[5:]] == [None] * 8
    assert parse_number("1,5", ",") == 1.5 and parse_number("1.5", ",") is None
    assert name_and_unit("current \t[A]") == ("current", "A")
    assert name_and_unit("current ") == ("current", None)
    assert name_and_unit("a [b] c") == ("a [b] c", None)


def test_a_factor_with_a_decimal_comma_is_refused():
    """It would be read as 0 otherwise."""
    with pytest.raises(InputError, match="does not say what it is"):
        parse_answer("F", "force [N] factor=0,5")
    assert parse_answer("F", "force [N] factor=-0.5, offset=2")[0] == "force"
