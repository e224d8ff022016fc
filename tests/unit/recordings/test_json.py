"""JSON lines, and JSON files with rows or columns."""

import json
import time
from pathlib import Path
from typing import Any

import pandas as pd
import pytest

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording, read_recordings
from smajax.recordings.recording import Recording

ROWS = [
    {"time [s]": 0, "current [A]": 0.0},
    {"time [s]": 0.5, "current [A]": 1.5},
    {"time [s]": 1.0, "current [A]": 2.0},
]
TABLE = pd.DataFrame(ROWS)
PLAIN = {"time": ChannelMap("t", "ms"), "current": ChannelMap("drive.i", "mA")}
NESTED = [{"t": 0, "drive": {"i": 0}}, {"t": 500, "drive": {"i": 1500}}, {"t": 1000, "drive": {"i": 2000}}]
LISTS = [[0, 0.0, "a"], [0.5, 1.5, "b"], [1.0, 2.0, "c"]]
# Seconds of processor time in which a small file is refused.
AT_ONCE = 5.0
NAMES = ("time [s]", "current [A]", "-")


def lines(rows: list[Any]) -> str:
    return "\n".join(json.dumps(row) for row in rows) + "\n"


def stamped(text: str) -> list[dict[str, Any]]:
    return [
        {"time": f"{text}{k // 2:02d}.{k % 2 * 5}", "current [A]": row["current [A]"]} for k, row in enumerate(ROWS)
    ]


@pytest.fixture
def read(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)

    def call(name: str, content: str | bytes, **options: Any) -> Recording:
        Path(name).write_bytes(content if isinstance(content, bytes) else content.encode())
        return read_recording(name, **options)

    return call


LAYOUTS: dict[str, tuple[str, str | bytes, dict[str, Any]]] = {
    "lines": ("log.jsonl", lines(ROWS), {}),
    "lines of another name, without the last line feed": ("log.ndjson", lines(ROWS).rstrip(), {}),
    "lines of pandas": ("log.jsonl", TABLE.to_json(orient="records", lines=True), {}),
    "lines in UTF-16": ("log.jsonl", lines(ROWS).encode("utf-16"), {}),
    "nested": ("log.jsonl", lines(NESTED), {"mapping": PLAIN}),
    "keys in another order": ("log.jsonl", lines([ROWS[0], dict(reversed(ROWS[1].items())), ROWS[2]]), {}),
    "lists": ("log.jsonl", lines(LISTS), {"columns": NAMES}),
    "keys of other names": ("log.jsonl", lines([dict(zip("ab", row.values(), strict=True)) for row in ROWS]), {"columns": NAMES[:2]}),
    "texts of numbers": ("log.jsonl", lines([{k: str(v) for k, v in row.items()} for row in ROWS]), {}),
    "dates": ("log.jsonl", lines(stamped("2024-03-01T12:00:")), {}),
    "times of day": ("log.jsonl", lines(stamped("12:00:")), {}),
    "format": ("log.jsonl", lines(stamped("01.03.2024 12:00:")), {"time_format": "%d.%m.%Y %H:%M:%S.%f"}),
    "title": ("log.jsonl", "boot 3.1\n" + lines(ROWS), {"skip_rows": 1}),
    "list of rows": ("log.json", json.dumps(ROWS), {}),
    "list of lists": ("log.json", json.dumps(LISTS), {"columns": NAMES}),
    "member with the rows": ("log.json", json.dumps({"meta": {"rig": 3}, "run": {"rows": ROWS}}), {"variable": "run.rows"}),
    "columns": ("log.json", json.dumps({key: [row[key] for row in ROWS] for key in ROWS[0]}), {}),
    "pandas": ("log.json", TABLE.to_json(), {}),
    "pandas, rows": ("log.json", TABLE.to_json(orient="records"), {}),
    "pandas, split": ("log.json", TABLE.to_json(orient="split"), {}),
}  # fmt: skip


@pytest.mark.parametrize("layout", LAYOUTS)
def test_each_layout_gives_the_same_recording(read, layout):
    name, content, options = LAYOUTS[layout]
    recording = read(name, content, **options)
    assert recording.time.tolist() == [0.0, 0.5, 1.0] and recording.channels["current"].tolist() == [0.0, 1.5, 2.0]


MISSING = [ROWS[0], {"time [s]": 0.5}, ROWS[2]]
REFUSED: dict[str, tuple[str, str, dict[str, Any], str]] = {
    "missing key": ("log.jsonl", lines(MISSING), {}, "log.jsonl: row 2, column 'current [A]': the row has no such key: correct it, or leave such rows out with --drop-bad-rows"),
    "later key": ("log.jsonl", lines([{"time [s]": 0}, *ROWS[1:]]), {}, "log.jsonl: row 1, column 'current [A]': the row has no such key"),
    "cut line": ("log.jsonl", lines(ROWS)[:-10], {}, "log.jsonl: row 3: the line is not JSON ("),
    "blank line": ("log.jsonl", lines(ROWS).replace("\n", "\n\n", 1), {}, "log.jsonl: row 2: the row is blank"),
    "a list": ("log.jsonl", lines([ROWS[0], [1, 2]]), {}, "log.jsonl: row 2: the row is a list and not an object"),
    "short list": ("log.jsonl", lines([*LISTS, [1.5, 2.0]]), {"columns": NAMES}, "log.jsonl: row 4: the row has 2 cells, and 3 columns are named"),
    "null": ("log.jsonl", lines([*ROWS, {"time [s]": 2, "current [A]": None}]), {}, "log.jsonl: row 4, column 'current [A]': the cell is blank"),
    "text": ("log.jsonl", lines([*ROWS, {"time [s]": 2, "current [A]": "low"}]), {}, "row 4, column 'current [A]': 'low' is not a number"),
    "boolean": ("log.jsonl", lines([*ROWS, {"time [s]": 2, "current [A]": True}]), {}, "row 4, column 'current [A]': 'true' is not a number"),
    "not finite": ("log.jsonl", lines([*ROWS, {"time [s]": 2, "current [A]": float("nan")}]), {}, "row 4, column 'current [A]': 'NaN' is not a finite number"),
    "dates of a channel": ("log.jsonl", lines([{"time [s]": 0, "current [A]": "2024-03-01"}, *ROWS[1:]]), {}, "row 1, column 'current [A]': '2024-03-01' is a time stamp"),
    "names of keys": ("log.jsonl", lines(ROWS), {"columns": NAMES}, "log.jsonl: the number of named columns is 3, and the file has 2 (time [s], current [A]): name every"),
    "other key": ("log.jsonl", lines(NESTED), {}, "log.jsonl: column 't' is not a known channel"),
    "lines in .json": ("log.json", lines(ROWS), {}, "log.json: line 2: the file is not JSON (Extra data at character 1): save it again, or name it .jsonl"),
    "rows in a member": ("log.json", json.dumps({"n": 3, "rows": ROWS}), {}, "has neither rows nor columns of one length: save a list of objects, or an object with a list for each column, or name its member with the rows, as in variable = \"rows\""),
    "misspelt member": ("log.json", json.dumps({"n": 3, "rows": ROWS}), {"variable": "row"}, "there is no member 'row' for variable = \"row\" (did you mean 'rows'?): it has n, rows"),
    "no rows": ("log.json", "[]", {}, "log.json: there are no rows: record at least two"),
}  # fmt: skip


@pytest.mark.parametrize("fault", REFUSED)
def test_what_does_not_fit_is_refused_with_its_row(read, fault):
    name, content, options, sentence = REFUSED[fault]
    with pytest.raises(InputError) as refusal:
        read(name, content, **options)
    assert sentence in str(refusal.value) and str(refusal.value).startswith(f"{name}: ")


def test_bad_lines_are_dropped_and_counted(read):
    content = lines([*ROWS[:2], {"time [s]": 0.7}, {"time [s]": 0.9, "current [A]": 1.0}]) + "oops\n" + lines([ROWS[2]])
    recording = read("log.jsonl", content, drop_bad_rows=True)
    assert recording.time.tolist() == [0.0, 0.5, 0.9, 1.0]
    assert recording.notes == ("2 of 6 rows with a blank or unreadable cell dropped on request: row 3, 5",)
    parts = read_recordings("log.jsonl", on_bad_rows="split")
    assert [part.time.tolist() for part in parts] == [[0.0, 0.5, 0.9, 1.0]]


def test_rows_with_other_keys_each_are_refused_at_once(read):
    rows = [{"time [s]": k, "current [A]": 0.1, f"key {k}": 1} for k in range(8000)]
    begin = time.process_time()
    with pytest.raises(InputError, match="'key 0' is not a known channel"):
        read("a.jsonl", lines(rows))
    assert time.process_time() - begin < AT_ONCE


def test_a_key_that_rows_lack_is_named_in_the_first_of_them(read):
    rows = [ROWS[0], {"time [s]": 0.5}, ROWS[1] | {"time [s]": 0.8}, {"time [s]": 0.9}, ROWS[2]]
    with pytest.raises(InputError, match="row 2, column 'current \\[A\\]': the row has no such key"):
        read("a.jsonl", lines(rows))
    assert read("a.jsonl", lines(rows), drop_bad_rows=True).time.tolist() == [0, 0.8, 1.0]
    with pytest.raises(InputError, match="row 1, column 'current \\[A\\]': the row has no such key"):
        read("a.jsonl", lines([{"time [s]": -1.0}, *ROWS]))
