"""Files that are valid in their format and hold anything: tables of any values in rigs, JSON and sheets (hypothesis)."""

import json
import math
from pathlib import Path
from typing import Any

import openpyxl
from hypothesis import given, settings
from hypothesis import strategies as st
from openpyxl.cell.cell import ILLEGAL_CHARACTERS_RE

from smajax.errors import InputError, printable, printable_sentence
from smajax.files.rig_file import read_rig
from smajax.files.toml import parse_toml
from smajax.recordings.read import read_recordings
from smajax.recordings.recognition.recognise import recognise
from tests.fuzz.attempts import limited
from tests.fuzz.settings import example

SEEDED = settings(derandomize=True, deadline=None, max_examples=150)
TEXTS = st.one_of(
    st.text(max_size=12),
    st.sampled_from(
        ["time [s]", "current [A]", "displacement [mm]", "nan", "1e999", "0,3", "12:00:01", "2024-01-01", "\u202ea"]
    ),
    st.sampled_from(["\ud800", "\x1b]0;a\x07", "</script>", "../a", "65 degC", "0.1 mm", "dead-weight", "-", "=1+1"]),
)
VALUES = st.recursive(
    st.one_of(TEXTS, st.floats(), st.integers(), st.integers(-(10**400), 10**400), st.booleans(), st.none()),
    lambda inner: st.one_of(st.lists(inner, max_size=4), st.dictionaries(TEXTS, inner, max_size=4)),
    max_leaves=12,
)


def places(table: dict[str, Any], path: tuple[str, ...] = ()) -> list[tuple[str, ...]]:
    """The paths of all keys of nested tables."""
    found = []
    for key, value in table.items():
        found.append((*path, key))
        if isinstance(value, dict):
            found += places(value, (*path, key))
    return found


RIG = parse_toml((example() / "example.toml").read_text("utf-8"), "example.toml")


@SEEDED
@given(st.lists(st.tuples(st.sampled_from(places(RIG)), VALUES), min_size=1, max_size=3))
def test_rigs_with_any_values_are_read_or_refused(changes):
    data = json.loads(json.dumps(RIG))
    for (*path, key), value in changes:
        table = data
        for part in path:
            table = table[part] if isinstance(table.get(part), dict) else {}
        table[key] = value
    with limited():
        try:
            read_rig(data)
        except InputError as error:
            assert "\n" not in printable_sentence(str(error))


@SEEDED
@given(VALUES, st.booleans())
def test_any_json_is_read_or_refused(tmp_path_factory, value, has_lines):
    path: Path = tmp_path_factory.mktemp("json") / ("wire.jsonl" if has_lines else "wire.json")
    lines = value if has_lines and isinstance(value, list) else [value]
    path.write_text("\n".join(map(json.dumps, lines)) + "\n", "utf-8")
    _read_and_recognise(path)


@settings(derandomize=True, deadline=None, max_examples=60)  # a sheet takes longer than the others
@given(
    st.lists(
        st.lists(
            st.one_of(TEXTS, st.floats(), st.integers(-(2**53), 2**53), st.booleans(), st.none(), st.dates()),
            max_size=4,
        ),
        max_size=6,
    )
)
def test_any_sheet_is_read_or_refused(tmp_path_factory, rows):
    book = openpyxl.Workbook()
    for row in rows:
        book.active.append([_cell(value) for value in row])
    path: Path = tmp_path_factory.mktemp("sheet") / "wire.xlsx"
    book.save(path)
    _read_and_recognise(path)


def _cell(value: Any) -> Any:
    if isinstance(value, str):
        return ILLEGAL_CHARACTERS_RE.sub("", value.encode("utf-8", "replace").decode())
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _read_and_recognise(path: Path) -> None:
    for read in (lambda: read_recordings(path), lambda: recognise(path, {}, {})):
        with limited():
            try:
                read()
            except InputError as error:
                line = printable_sentence(str(error))
                assert "\n" not in line and printable(line) == line and line.encode("utf-8")
