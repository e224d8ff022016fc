"""Recordings from memory: DataFrames, dictionaries, arrays and recordings are taken where a path is, with the same checks."""

import subprocess
import sys
from dataclasses import replace
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import pandas as pd
import pyarrow
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra import numpy as arrays

from smajax.errors import InputError
from smajax.files.rig_file import parse_rig, read_rig
from smajax.files.train_and_holdout import read_train_and_holdout
from smajax.recordings import ChannelMap, Recording, as_source_list, read_recording
from smajax.recordings.readers import base
from smajax.recordings.shared_rows import has_same_content, refuse_copies
from tests.conftest import ROOT

ROWS = 40
RIG = (ROOT / "data" / "templates" / "dead-weight.toml").read_text("utf-8")


def columns(rows: int = ROWS, scale: float = 1.0) -> dict[str, Any]:
    """Columns of a recording of a dead weight."""
    time = np.arange(rows) / 50
    return {
        "time [s]": time,
        "current [A]": 0.3 + 0.1 * np.sin(time),
        "displacement [mm]": scale * (1.0 + np.sin(3.0 * time)),
        "temperature [degC]": 21.0 + time,
    }


def assert_same(recording: Recording, other: Recording) -> None:
    """Check that two recordings are equal to the last bit."""
    assert list(recording.channels) == list(other.channels)
    np.testing.assert_array_equal(recording.time, other.time)
    for name, values in other.channels.items():
        np.testing.assert_array_equal(recording.channels[name], values)
    assert dict(recording.units) == dict(other.units)
    assert recording.has_clock == other.has_clock


def structured(table: dict[str, Any]) -> np.ndarray:
    """Return the columns as a structured array."""
    array = np.zeros(len(next(iter(table.values()))), [(name, float) for name in table])
    for name, values in table.items():
        array[name] = values
    return array


SOURCES = {
    "dictionary": (lambda table: table, {}),
    "dictionary of lists": (lambda table: {name: list(values) for name, values in table.items()}, {}),
    "DataFrame": (lambda table: pd.DataFrame(table), {}),
    "DataFrame with a time index": (lambda table: pd.DataFrame(table).set_index("time [s]"), {}),
    "DataFrame with nullable columns": (lambda table: pd.DataFrame(table).astype("Float64"), {}),
    "structured array": (structured, {}),
    "record array": (lambda table: structured(table).view(np.recarray), {}),
    "array": (lambda table: np.column_stack(list(table.values())), {"headers": list(columns())}),
    "nested lists": (
        lambda table: [list(row) for row in zip(*table.values(), strict=True)],
        {"headers": list(columns())},
    ),
    "pyarrow table": (lambda table: pyarrow.table(table), {}),
}


@pytest.mark.parametrize("kind", SOURCES)
def test_every_kind_of_table_equals_the_file(kind, tmp_path):
    pd.DataFrame(columns()).to_csv(tmp_path / "run.csv", index=False)
    convert, options = SOURCES[kind]
    recording = read_recording(convert(columns()), **options)
    assert_same(recording, read_recording(tmp_path / "run.csv"))
    assert recording.name == "recording" and len(recording.sha256) == 64 and recording.notes == ()
    assert_same(read_recording(convert(columns()), **options, drop_bad_rows=True), recording)


def test_a_polars_table_is_read_by_its_methods():
    class PolarsFrame:
        """The methods of a polars DataFrame that are used."""

        columns = tuple(columns())

        def get_column(self, name):
            return pd.Series(columns()[name])

    assert_same(read_recording(PolarsFrame()), read_recording(columns()))


def test_pandas_is_not_imported_to_read_a_table():
    code = (
        "import sys, smajax.recordings as r;"
        "r.read_recording({'time [s]': [0.0, 1.0, 2.0], 'current [A]': [0.1, 0.2, 0.3]});"
        "assert not {'pandas', 'pyarrow', 'polars', 'jax'} & set(sys.modules)"
    )
    subprocess.run([sys.executable, "-c", code], check=True, cwd=ROOT)


def test_durations_and_dates_are_times():
    table = columns()
    time = table.pop("time [s]")
    frame = pd.DataFrame(table)
    durations = pd.to_timedelta(np.round(time * 1e9).astype(int), unit="ns")
    for index in (
        durations,
        pd.Timestamp("2026-03-29 01:59:59.5") + durations,
        pd.Timestamp("2026-03-29 00:59:59.5", tz="Europe/Berlin") + durations,  # summer time begins in between
        (pd.Timestamp("2026-01-01") + durations).rename("clock"),
        (pd.Timestamp("2026-01-01") + durations).as_unit("us"),
    ):
        assert_same(read_recording(frame.set_index(index)), read_recording(columns()))


def test_a_column_of_time_counts_more_than_an_index_of_dates():
    frame = pd.DataFrame(columns()).set_index(pd.date_range("2026-01-01", periods=ROWS, freq="1h"))
    assert_same(read_recording(frame), read_recording(columns()))
    renamed = frame.rename(columns={"time [s]": "t"})
    recording = read_recording(renamed, mapping={"time": ChannelMap("t", "s")})
    np.testing.assert_array_equal(recording.time, columns()["time [s]"])


def test_an_index_that_counts_rows_is_no_column():
    frame = pd.DataFrame(columns())
    assert_same(
        read_recording(frame.iloc[5:]), read_recording({name: values[5:] for name, values in columns().items()})
    )
    frame.index.name = "sample"
    with pytest.raises(InputError, match=r"^the DataFrame: column 'sample' is not a known channel"):
        read_recording(frame)
    assert_same(read_recording(frame, ignore=["sample"]), read_recording(columns()))


def test_columns_are_mapped_and_ignored_as_in_a_rig():
    table = {"t": columns()["time [s]"], "I": 1e3 * columns()["current [A]"], "state": ["on"] * ROWS}
    mapping = {"time": ChannelMap("t", "s"), "current": ChannelMap("I", "mA")}
    recording = read_recording(table, mapping=mapping, ignore=["state"])
    np.testing.assert_allclose(recording.channels["current"], columns()["current [A]"], rtol=1e-15)


def test_float32_integers_and_masks_are_converted():
    table = columns()
    table["current [A]"] = table["current [A]"].astype(np.float32)
    table["displacement [mm]"] = np.arange(ROWS)
    recording = read_recording(table)
    assert recording.channels["current"].dtype == np.float64
    np.testing.assert_array_equal(recording.channels["current"], table["current [A]"])
    table["current [A]"] = np.ma.masked_greater(columns()["current [A]"], 0.36)
    with pytest.raises(InputError, match=r"row \d+, column 'current \[A\]': the value nan is not a finite number"):
        read_recording(table)
    assert len(read_recording(table, drop_bad_rows=True)) == (columns()["current [A]"] <= 0.36).sum()


def changed(header: str, values: Any, **more: Any) -> dict[str, Any]:
    """Return the columns with one of them replaced."""
    return columns() | {header: values} | more


def spoilt(header: str, row: int, value: float) -> dict[str, Any]:
    """Return the columns with one value replaced."""
    table = columns()
    table[header][row] = value
    return table


DROP = "correct it, or leave such rows out with drop_bad_rows=True"
FLOATS = "convert it to floats in the unit of its header, as in astype(float)"
BAD: dict[str, tuple[Any, dict[str, Any], str]] = {
    "no time": (
        {"current [A]": [0.1, 0.2]},
        {},
        "the dictionary: the channel time is missing: it has current, so add a column 'time [s]' or map one to time under "
        '[channels] in the rig, or set sample_period = "20 ms" under [recording] if the file has none',
    ),
    "no input": (
        pd.DataFrame({"time [s]": [0.0, 1.0]}),
        {"required": ["current"]},
        "the DataFrame: the channel current is missing: it has time, so add a column 'current [A]' or map one to current "
        "under [channels] in the rig",
    ),
    "no unit": (
        changed("current [A]", [0.1], current=[0.1]),
        {"ignore": ["current [A]"]},
        "the dictionary: column 'current' has no unit: write the header like 'current [A]', or give the unit under [channels]",
    ),
    "unknown column": (
        pd.DataFrame({"time [s]": [0.0, 1.0], "glow": [0.0, 1.0]}),
        {},
        "the DataFrame: column 'glow' is not a known channel: rename it, map it under [channels] in the rig, or leave it "
        'out with [channels] ignore = ["glow"]',
    ),
    "numbered columns": (
        pd.DataFrame(np.zeros((3, 2))),
        {},
        "the DataFrame: column '0' is not a known channel: rename it, map it under [channels] in the rig, or leave it out "
        'with [channels] ignore = ["0"], or set skip_rows if the header comes further down',
    ),
    "two columns": (
        pd.DataFrame([[0.0, 0.1, 0.1], [1.0, 0.2, 0.3]], columns=["time [s]", "current [A]", "current [mA]"]),
        {},
        "the DataFrame: columns 2 ('current [A]') and 3 ('current [mA]') are both current: number them current_1 and "
        "current_2, or ignore one",
    ),
    "two equal headers": (
        pd.DataFrame([[0.0, 0.1, 0.1], [1.0, 0.2, 0.3]], columns=["time [s]", "current [A]", "current [A]"]),
        {},
        "the DataFrame: columns 2 ('current [A]') and 3 ('current [A]') are both current: number them current_1 and "
        "current_2, or ignore one",
    ),
    "other lengths": (
        changed("current [A]", np.zeros(3)),
        {},
        f"the dictionary: column 'current [A]' has 3 values and 'time [s]' {ROWS}: give every column one value per row",
    ),
    "NaN": (
        spoilt("current [A]", 17, np.nan),
        {},
        f"the dictionary: row 17, column 'current [A]': the value nan is not a finite number: {DROP}",
    ),
    "infinity": (
        pd.DataFrame(spoilt("displacement [mm]", 3, -np.inf)),
        {},
        f"the DataFrame: row 3, column 'displacement [mm]': the value -inf is not a finite number: {DROP}",
    ),
    "NaN in a nullable column": (
        pd.DataFrame(columns()).assign(**{"current [A]": pd.array([0.1, None] * 20, "Float64")}),
        {},
        f"the DataFrame: row 1, column 'current [A]': the value nan is not a finite number: {DROP}",
    ),
    "time decreases": (
        structured(spoilt("time [s]", 5, 0.02)),
        {},
        f"the structured array: row 5, column 'time [s]': time decreases from 0.08 to 0.02 s: {DROP}",
    ),
    "rows not sorted": (
        pd.DataFrame(columns()).iloc[::-1],
        {},
        "the DataFrame: row 1, column 'time [s]': time decreases from 0.78 to 0.76 s: sort the rows by time, or leave such "
        "rows out with drop_bad_rows=True",
    ),
    "wrong unit": (
        changed("current [A]", np.linspace(300.0, 400.0, ROWS)),
        {},
        "the dictionary: row 0, column 'current [A]': the current of 300 A is above 50 A, and the numbers look like mA: "
        "correct the header to 'current [mA]', or, if it is right, give current any_scale = true under [channels] in the rig",
    ),
    "constant": (
        changed("displacement [mm]", np.ones(ROWS)),
        {"observed": ["displacement"]},
        f"the dictionary: column 'displacement [mm]': the observed channel displacement is 1 mm in all {ROWS} rows: check "
        "the sensor, or remove it from [fit] observe",
    ),
    "single row": (
        {name: values[:1] for name, values in columns().items()},
        {},
        "the dictionary: the recording has a single row of data: record at least two",
    ),
    "no rows": (
        pd.DataFrame(columns()).iloc[:0],
        {},
        "the DataFrame: there are columns and no rows: record at least two rows of data",
    ),
    "no rows in a dictionary": (
        {"time [s]": [], "current [A]": []},
        {},
        "the dictionary: there are columns and no rows: record at least two rows of data",
    ),
    "empty dictionary": (
        {},
        {},
        "the dictionary: there is no column: give it columns such as 'time [s]' and 'current [A]'",
    ),
    "empty DataFrame": (
        pd.DataFrame(),
        {},
        "the DataFrame: there is no column: give it columns such as 'time [s]' and 'current [A]'",
    ),
    "text": (
        changed("current [A]", ["0.1"] * 3 + ["off"] * 37),
        {},
        f"the dictionary: row 0, column 'current [A]': '0.1' is not a number: correct it, and {FLOATS}",
    ),
    "text in a DataFrame": (
        pd.DataFrame(changed("current [A]", ["off"] * ROWS)),
        {},
        f"the DataFrame: row 0, column 'current [A]': 'off' is not a number: correct it, and {FLOATS}",
    ),
    "one text": (
        pd.DataFrame(changed("current [A]", [0.1] * 17 + ["out of range " * 3] + [0.1] * 22)),
        {},
        "the DataFrame: row 17, column 'current [A]': 'out of range out of range ... is not a number: correct it, and "
        + FLOATS,
    ),
    "nothing": (
        changed("current [A]", [0.1] * 39 + [None]),
        {},
        f"the dictionary: row 39, column 'current [A]': None is not a number: correct it, and {FLOATS}",
    ),
    "objects": (
        changed("current [A]", np.full(ROWS, 0.1, object)),
        {},
        f"the dictionary: column 'current [A]': the numbers are stored as objects: {FLOATS}",
    ),
    "complex": (
        changed("current [A]", np.full(ROWS, 0.1j)),
        {},
        f"the dictionary: column 'current [A]': the values are of type complex128 and not real numbers: {FLOATS}",
    ),
    "truth values": (
        changed("duty", np.full(ROWS, True)),
        {},
        f"the dictionary: column 'duty': the values are of type bool and not real numbers: {FLOATS}",
    ),
    "dates": (
        pd.DataFrame(changed("current [A]", pd.date_range("2026-01-01", periods=ROWS, unit="ns"))),
        {},
        f"the DataFrame: column 'current [A]': the values are of type datetime64[ns] and not real numbers: {FLOATS}",
    ),
    "a matrix": (
        changed("current [A]", np.zeros((ROWS, 1))),
        {},
        "the dictionary: column 'current [A]': this is an array of shape (40, 1) and not a vector: give one value per row",
    ),
    "a number": (
        changed("current [A]", 0.1),
        {},
        "the dictionary: column 'current [A]': this is a single value and not a vector: give one value per row",
    ),
    "too large": (
        changed("current [A]", np.full(ROWS, 0.1), **{"stress [GPa]": np.full(ROWS, 1e300)}),
        {"mapping": {"stress": ChannelMap("stress [GPa]", any_scale=True)}},
        "the dictionary: column 'stress [GPa]': numbers too large for Pa: correct the unit",
    ),
    "several levels": (
        pd.DataFrame(columns()).set_index(["time [s]", "current [A]"]),
        {},
        "the DataFrame: its index has several levels: make them columns with reset_index()",
    ),
    "an undated row": (
        pd.DataFrame({"current [A]": [0.1, 0.2]}, index=pd.DatetimeIndex(["2026-01-01", None])),
        {},
        f"the DataFrame: row 1, column 'time [s]': the value nan is not a finite number: {DROP}",
    ),
    "array without headers": (
        np.zeros((3, 2)),
        {},
        "the array: its columns have no names: add headers=['time [s]', 'current [A]', ...], or give a dictionary of columns",
    ),
    "array with other headers": (
        np.zeros((3, 2)),
        {"headers": ["time [s]"]},
        "the array: its shape is (3, 2), and 1 columns are named: give it the shape (rows, 1), or a name per column",
    ),
    "vector": (
        np.zeros(3),
        {"headers": ["time [s]"]},
        "the array: its shape is (3,), and 1 columns are named: give it the shape (rows, 1), or a name per column",
    ),
    "headers of a table": (
        pd.DataFrame(columns()),
        {"headers": ["time [s]"]},
        "the DataFrame: only the columns of plain arrays and text files can be named: leave out headers",
    ),
    "another type": (
        5,
        {},
        "a recording cannot be read from an object of type int: give a path, a DataFrame, a dictionary of columns, an array "
        "with headers, or a Recording",
    ),
}


@pytest.mark.parametrize("fault", BAD)
def test_faults_are_refused_in_one_sentence(fault):
    source, options, sentence = BAD[fault]
    with pytest.raises(InputError) as refusal:
        read_recording(source, **options)
    assert str(refusal.value) == sentence


def test_lists_of_unequal_lengths_are_refused():
    with pytest.raises(InputError, match="^the array: the values are not an array .*: give one number per row$"):
        read_recording([[0.0, 1.0], [0.0]], headers=["time [s]", "current [A]"])


def test_a_name_stands_in_the_sentence_and_in_the_result():
    with pytest.raises(InputError, match=r"^run 3 \(DataFrame\): row 17, column 'current \[A\]': the value nan"):
        read_recording(pd.DataFrame(spoilt("current [A]", 17, np.nan)), name="run 3")
    assert read_recording(pd.DataFrame(columns()), name="run 3").name == "run 3"


def test_the_memory_limit_holds(monkeypatch):
    monkeypatch.setattr(base, "MEMORY_LIMIT", 1000)
    with pytest.raises(InputError, match=r"^the dictionary: 40 rows of 4 columns need"):
        read_recording(columns())


def test_bad_rows_are_dropped_and_counted_on_request(tmp_path):
    table = spoilt("current [A]", 17, np.nan)
    table["time [s]"][20] = 0.0
    recording = read_recording(pd.DataFrame(table), drop_bad_rows=True)
    assert recording.notes == (
        "1 of 40 rows with a blank or unreadable cell dropped on request: row 17",
        "1 of 40 rows in which time does not increase dropped on request: row 20",
    )
    pd.DataFrame(table).to_csv(tmp_path / "run.csv", index=False)
    assert_same(recording, read_recording(tmp_path / "run.csv", drop_bad_rows=True))
    table["displacement [mm]"][30:] = 5000.0  # a row is named by its number in the table
    with pytest.raises(InputError, match=r"row 30, column 'displacement \[mm\]'"):
        read_recording(table, drop_bad_rows=True)


def test_later_changes_of_the_table_do_not_change_the_recording():
    table = columns()
    recording = read_recording(table)
    for values in table.values():
        values[:] = -1.0
    assert_same(recording, read_recording(columns()))


def test_the_sum_is_of_the_columns_with_their_headers():
    reference = read_recording(columns()).sha256
    assert read_recording(pd.DataFrame(columns())).sha256 == reference
    assert read_recording(spoilt("current [A]", 17, 0.31)).sha256 != reference
    renamed = {("temperature [K]" if name.startswith("temp") else name): v + 0.0 for name, v in columns().items()}
    renamed["temperature [K]"] += 273.0
    assert read_recording(renamed).sha256 != reference


def test_copies_are_refused():
    first, again = read_recording(columns(), name="first"), read_recording(pd.DataFrame(columns()), name="again")
    assert has_same_content(first, again)
    with pytest.raises(InputError, match="^again has the same content as first: name a recording of another input"):
        refuse_copies([first, again])
    refuse_copies([first, read_recording(columns(scale=1.5))])


def test_recordings_of_arrays_without_a_sum_are_no_copies():
    made = [Recording.from_arrays("made", np.arange(3.0), {"current": np.full(3, k + 0.1)}, {}) for k in range(2)]
    refuse_copies(made)
    assert made[0].sha256 == "" and read_recording(made[0]).sha256 != read_recording(made[1]).sha256


def test_two_parts_of_one_recording_are_no_copies():
    whole = read_recording(columns(200))
    refuse_copies([whole.slice(0.0, 2.0), whole.slice(2.0, 4.0)])
    with pytest.raises(InputError, match="has rows of"):
        refuse_copies([whole.slice(0.0, 2.0), whole.slice(0.8, 2.6)])


def test_a_recording_is_returned_if_it_has_the_channels():
    recording = read_recording(columns())
    assert read_recording(recording, required=["current"], observed=["displacement"]) is recording
    assert read_recording(recording, name="run 3").name == "run 3"


def bad_recording(**changes: Any) -> Recording:
    """Return a recording with some channels replaced."""
    recording = replace(read_recording(columns()), name="made")
    time = changes.pop("time", recording.time)
    channels = {name: changes.get(name, values) for name, values in recording.channels.items()}
    return replace(recording, time=time, channels={n: v for n, v in channels.items() if v is not None})


@pytest.mark.parametrize(
    ("recording", "sentence"),
    [
        (
            bad_recording(current=None),
            "made: the channel current is missing: it has time, displacement, temperature, so add a column 'current [A]' or "
            "map one to current under [channels] in the rig",
        ),
        (
            replace(bad_recording(), has_clock=False),
            "made: the channel time is missing: it has current, displacement, temperature, so add a column 'time [s]' or map "
            'one to time under [channels] in the rig, or set sample_period = "20 ms" under [recording] if the file has none',
        ),
        (
            bad_recording(displacement=np.ones(ROWS)),
            "made: column 'displacement [m]': the observed channel displacement is 1 m in all 40 rows: check the sensor, or "
            "remove it from [fit] observe",
        ),
        (
            bad_recording(displacement=np.full(ROWS, np.nan)),
            "made: column 'displacement [m]': no value is a finite number: correct them",
        ),
        (
            bad_recording(current=np.full(ROWS, np.nan)),
            "made: row 0, column 'current [A]': the value nan is not a finite number: correct it, or leave such rows out "
            "with drop_bad_rows=True",
        ),
        (
            bad_recording(time=np.zeros(ROWS)),
            "made: row 1, column 'time [s]': time does not increase at 0 s: sort the rows by time, or leave such rows out "
            "with drop_bad_rows=True",
        ),
        (bad_recording().slice(0.0, 0.01), "made: the recording has a single row of data: record at least two"),
    ],
)
def test_a_recording_that_cannot_be_used_is_refused(recording, sentence):
    with pytest.raises(InputError) as refusal:
        read_recording(recording, required=["current"], observed=["displacement"])
    assert str(refusal.value) == sentence


def test_bad_rows_of_a_recording_are_dropped_on_request():
    """Rows in which an observed channel was not measured are kept."""
    time, current, measured = (
        np.array(bad_recording().time), np.array(bad_recording().channels["current"]), np.linspace(0.0, 1e-3, ROWS)
    )  # fmt: skip
    time[20], current[17], measured[5] = 0.0, np.nan, np.nan
    recording = bad_recording(time=time, current=current, displacement=measured)
    read = read_recording(recording, required=["current"], observed=["displacement"], drop_bad_rows=True)
    rows = np.delete(np.arange(ROWS), [17, 20])
    np.testing.assert_array_equal(read.time, time[rows])
    np.testing.assert_array_equal(read.channels["displacement"], measured[rows])
    assert read.sha256 == recording.sha256 and read.notes == (
        "1 of 40 rows with a blank or unreadable cell dropped on request: row 17",
        "1 of 40 rows in which time does not increase dropped on request: row 20",
    )
    whole = bad_recording()
    assert read_recording(whole, required=["current"], drop_bad_rows=True) is whole


def test_headers_of_a_recording_are_refused():
    with pytest.raises(InputError, match="^made: a Recording has channels with names already: leave out headers$"):
        read_recording(bad_recording(), headers=["time [s]", "current [A]"])


def test_an_observed_channel_may_be_missing_in_some_rows_of_a_recording():
    partly = np.where(np.arange(ROWS) % 2, np.nan, np.linspace(0.0, 1e-3, ROWS))
    assert read_recording(bad_recording(displacement=partly), observed=["displacement"])


@pytest.mark.parametrize("kind", SOURCES)
def test_a_rig_reads_every_kind_of_table(kind):
    rig = parse_rig(RIG)
    convert, options = SOURCES[kind]
    assert_same(rig.read(convert(columns()), **options), rig.read(columns()))
    table = columns()
    del table["current [A]"]
    with pytest.raises(InputError, match="the channel current is missing"):
        rig.read(table)


def test_recordings_from_memory_and_files_get_distinct_names(tmp_path):
    rig = parse_rig(RIG)
    pd.DataFrame(columns()).to_csv(tmp_path / "run.csv", index=False)
    frame, other = pd.DataFrame(columns(scale=1.1)), columns(scale=1.2)
    whole = rig.read(columns(200), name="long")
    pairs = read_train_and_holdout(
        rig, [str(tmp_path / "run.csv"), frame, whole.slice(0.0, 2.0)], [other, whole.slice(2.0, 4.0)]
    )
    assert [(recording.name, role) for recording, role in pairs] == [
        ("run.csv", "train"),
        ("recording", "train"),
        ("long", "train"),
        ("recording 2", "holdout"),
        ("long 2", "holdout"),
    ]
    [(recording, _)] = read_train_and_holdout(rig, frame)
    assert_same(recording, rig.read(frame))


def test_faults_of_several_tables_are_distinguished():
    rig = parse_rig(RIG)
    bad = pd.DataFrame(spoilt("current [A]", 17, np.nan))
    with pytest.raises(InputError, match=r"^recording 2 \(DataFrame\): row 17, column"):
        read_train_and_holdout(rig, columns(), bad)
    with pytest.raises(InputError, match=r"^the DataFrame: row 17, column"):
        read_train_and_holdout(rig, bad)


def test_an_object_that_is_given_twice_is_refused():
    table = columns()
    with pytest.raises(InputError, match="^recording: this recording is given twice: name each one once"):
        read_train_and_holdout(parse_rig(RIG), table, table)


def test_one_source_or_several_become_a_list(tmp_path):
    frame = pd.DataFrame(columns())
    assert as_source_list("a.csv") == ["a.csv"] and as_source_list([tmp_path, "b"]) == [tmp_path, "b"]
    assert as_source_list(frame)[0] is frame and as_source_list(()) == []


def test_a_recording_describes_itself():
    recording = read_recording(columns(), name="run 3")
    assert repr(recording) == (
        "<Recording 'run 3': 40 rows, time [s] 0 to 0.78, current [A] 0.3 to 0.3703, displacement [mm] 1 to 2, "
        "temperature [degC] 21 to 21.78>"
    )
    path = Recording.from_arrays("path", None, {"strain": np.array([0.01, np.nan]), "stress": np.full(2, np.nan)}, {})
    assert repr(path) == "<Recording 'path': 2 rows, no time, strain [1] 0.01 to 0.01, stress [Pa] without values>"


@given(
    arrays.arrays(float, st.tuples(st.integers(2, 30), st.just(2)), elements=st.floats(-0.1, 0.1)),
    st.floats(1e-3, 10.0),
    st.booleans(),
)
@settings(deadline=None)
def test_a_table_of_pandas_and_back_is_the_same(values, step, has_clock):
    time = step * np.arange(len(values)) if has_clock else None
    channels = {"displacement": values[:, 0], "temperature": 20.0 + values[:, 1]}
    recording = Recording.from_arrays("made", time, channels, {"displacement": "mm", "temperature": "K", "time": "ms"})
    table = recording.to_pandas()
    assert table.index.name == ("time [ms]" if has_clock else None)
    mapping = {
        "displacement": ChannelMap("displacement [mm]", any_scale=True),
        "time": ChannelMap("time [ms]", any_scale=True),
    }
    again = read_recording(table, mapping=mapping, clock=has_clock)
    assert_same(again, recording)
    assert read_recording(again.to_pandas(), mapping=mapping, clock=has_clock).sha256 == again.sha256


def test_a_rig_is_read_from_a_dictionary(monkeypatch):
    import tomllib

    data = tomllib.loads(RIG)
    monkeypatch.chdir(ROOT / "data" / "templates")
    rig, expected = read_rig(data), parse_rig(RIG)
    assert rig.path is None and rig.name == "rig" and rig.to_toml() == expected.to_toml()
    data["fit"]["starts"] = np.int64(3)
    data["fit"]["free"] = tuple(data["fit"]["free"])
    assert read_rig(data).fit.starts == 3


@pytest.mark.parametrize(
    ("changes", "sentence"),
    [
        ({"wier": {}}, "rig: [wier] is not a section of a rig (did you mean 'wire'?)"),
        ({"schema": None}, "rig: schema = None is of type NoneType: give text, a number, true or false, a list or"),
        ({"wire": {"diameter": object}}, "rig: wire.diameter = <class 'object'> is of type type: give text"),
        ({"rig": {"kind": "dead-weight"}}, "rig: rig.control is missing"),
    ],
)
def test_a_bad_dictionary_is_refused_with_the_sentence_of_the_file(changes, sentence):
    import tomllib

    with pytest.raises(InputError) as refusal:
        read_rig(tomllib.loads(RIG) | changes)
    assert str(refusal.value).startswith(sentence)


TRACED = {
    "array": lambda a: a * jnp.asarray(columns()["current [A]"]),
    "list": lambda a: [a * value for value in columns()["current [A]"]],
}


REFUSED = {
    "a dictionary": (
        lambda current: read_recording(columns() | {"current [A]": current}),
        "the dictionary: column 'current [A]'",
    ),
    "rows": (
        lambda current: read_recording([[0.0, current[0]], [0.1, current[1]]], headers=["time [s]", "current [A]"]),
        "the array",
    ),
    "channels": (
        lambda current: Recording.from_arrays("pulse", np.arange(ROWS) / 50, {"current": current}),
        "pulse: channel 'current'",
    ),
    "times": (
        lambda current: Recording.from_arrays("pulse", current, {"current": columns()["current [A]"]}),
        "pulse: time",
    ),
    "a copy": (
        lambda current: replace(read_recording(columns(), name="pulse"), channels={"current": current}),
        "pulse: channel 'current'",
    ),
}


@pytest.mark.parametrize("kind", TRACED)
@pytest.mark.parametrize("source", REFUSED)
def test_traced_values_are_refused_with_what_to_trace_instead(source, kind):
    read, place = REFUSED[source]
    for trace in (jax.grad, jax.jit):
        with pytest.raises(InputError) as refusal:
            trace(lambda a: read(TRACED[kind](a)).channels["current"][0])(1.0)
        assert str(refusal.value) == (
            f"{place}: the values are traced by JAX, and a recording is not: make the inputs by discretise() outside "
            "of the traced function, and in it take Inputs.scale() or replace their before, after and sample_signals"
        )


def test_arrays_of_jax_that_are_not_traced_are_taken():
    recording = read_recording({name: jnp.asarray(values) for name, values in columns().items()})
    assert_same(recording, read_recording(columns()))
    doubled = replace(recording, channels={"current": 2.0 * jnp.asarray(recording.channels["current"])})
    np.testing.assert_array_equal(doubled.channels["current"], 2.0 * columns()["current [A]"])
