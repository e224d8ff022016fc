"""Valid recordings: formats, mapping, units, dropped rows, slices, resampling, interpolation of inputs, size."""

import hashlib
import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording
from smajax.recordings.readers import base, csv
from smajax.recordings.recording import Recording, sample_channels

ROOT = Path(__file__).parents[3]
SHARED = ROOT.parent / "shared"
GOOD = (
    "time [s],current [A],displacement [mm],temperature [K]\n0,0.3,0,293.15\n0.02,0.31,0.5,294\n0.04,0.32,1.5,300.25\n"
)
ROTARY = "time [ms],current_1 [mA],current_2 [mA],angle [deg]\n0,300,0,0\n20,310,0,90\n40,320,5,180\n"


@pytest.fixture
def written(tmp_path):
    def write(content, name="wire.csv"):
        path = tmp_path / name
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
        return path

    return write


def test_a_recording_is_in_si_with_temperatures_in_celsius(written):
    path = written(GOOD)
    recording = read_recording(path, required=["current"], observed=["displacement"])
    assert recording.name == "wire.csv"
    assert len(recording) == 3
    np.testing.assert_array_equal(recording.time, [0, 0.02, 0.04])
    np.testing.assert_array_equal(recording.channels["current"], [0.3, 0.31, 0.32])
    np.testing.assert_array_equal(recording.channels["displacement"], [0, 0.0005, 0.0015])
    np.testing.assert_allclose(recording.channels["temperature"], [20, 20.85, 27.1], atol=1e-12)
    assert recording.units == {"time": "s", "current": "A", "displacement": "mm", "temperature": "K"}
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()
    assert recording.has_clock and recording.notes == ()


def test_wires_are_numbered_and_angles_are_in_radians(written):
    recording = read_recording(written(ROTARY))
    np.testing.assert_array_equal(recording.time, [0, 0.02, 0.04])
    np.testing.assert_array_equal(recording.channels["current_2"], [0, 0, 0.005])
    np.testing.assert_allclose(recording.channels["angle"], [0, np.pi / 2, np.pi], rtol=1e-15)


def test_arrays_are_read_only_and_the_callers_stay_writable(written):
    recording = read_recording(written(GOOD))
    for values in (recording.time, recording.channels["current"]):
        with pytest.raises(ValueError, match="read-only"):
            values[0] = 1.0
    mine = np.array([0.0, 1.0])
    Recording("made", mine, {"current": mine}, {"time": "s", "current": "A"})
    mine[0] = -1.0
    with pytest.raises(TypeError):
        recording.channels["current"] = mine  # type: ignore[index]


@pytest.mark.parametrize(
    ("name", "change"),
    [
        ("windows", lambda text: text.replace("\n", "\r\n").encode()),
        ("mark", lambda text: b"\xef\xbb\xbf" + text.encode()),
        ("no_last_line_feed", lambda text: text.rstrip("\n").encode()),
        ("blank_rows_at_the_end", lambda text: (text + "\n\n\r\n").encode()),
        ("spaces", lambda text: text.replace(",", " , ").encode()),
        (
            "quotes",
            lambda text: "".join(
                ",".join(f'"{cell}"' for cell in row.split(",")) + "\n" for row in text.splitlines()
            ).encode(),
        ),
        ("tabs", lambda text: text.replace(",", "\t").encode()),
        ("comma_decimals", lambda text: text.replace(",", ";").replace(".", ",").encode()),
        ("preamble", lambda text: ("logger 3\n\n" + text).encode()),
        (
            "exponents",
            lambda text: text.replace("0.31", "+3.1E-1").replace("1.5", "15e-1").replace("0.5", ".5").encode(),
        ),
        ("spaces_before_unit", lambda text: text.replace(" [", "   [ ").encode()),
        ("ending", lambda text: text.encode()),
    ],
)
def test_variants_of_the_same_table(written, name, change):
    options: dict[str, dict[str, Any]] = {
        "tabs": {"delimiter": "\t"},
        "comma_decimals": {"delimiter": ";", "decimal": ","},
        "preamble": {"skip_rows": 2},
    }
    recording = read_recording(
        written(change(GOOD), "wire.TXT" if name == "ending" else "wire.csv"), **options.get(name, {})
    )
    expected = read_recording(written(GOOD, "plain.csv"))
    np.testing.assert_array_equal(recording.time, expected.time)
    assert list(recording.channels) == list(expected.channels)
    for channel, values in expected.channels.items():
        np.testing.assert_array_equal(recording.channels[channel], values)


def test_columns_are_mapped_and_ignored_by_header_or_name(written):
    path = written("t_ms,Laser (um),TC [K],state,PSU\n0,10,300,HEAT,0.3\n20,20.5,310,HEAT,0.3\n45,40,320,COOL,0\n")
    mapping = {
        "time": ChannelMap("t_ms", "ms"),
        "displacement": ChannelMap("Laser (um)", "um"),
        "temperature": ChannelMap("TC"),
        "current_1": ChannelMap("PSU", "A"),
        "current_2": ChannelMap("PSU", "A"),
        "force": ChannelMap("load cell", "N"),
    }
    recording = read_recording(path, mapping=mapping, ignore=["state", "not there"])
    np.testing.assert_array_equal(recording.time, [0, 0.02, 0.045])
    np.testing.assert_array_equal(recording.channels["displacement"], [1e-5, 2.05e-5, 4e-5])
    np.testing.assert_array_equal(recording.channels["current_1"], recording.channels["current_2"])
    assert recording.units["temperature"] == "K" and recording.channels["temperature"][0] == pytest.approx(26.85)
    assert "force" not in recording.channels and "state" not in recording.channels


def test_a_unit_in_the_rig_overrides_the_header_and_is_noted(written):
    path = written("time [s],current [A]\n0,300\n1,310\n")
    recording = read_recording(path, mapping={"current": ChannelMap("current [A]", "mA")})
    np.testing.assert_array_equal(recording.channels["current"], [0.3, 0.31])
    assert recording.notes == ("column 'current [A]' was read in mA, as the rig says",)
    high = read_recording(path, mapping={"current": ChannelMap("current [A]", any_scale=True)})
    np.testing.assert_array_equal(high.channels["current"], [300, 310])
    assert high.notes == ()


def test_a_path_needs_no_clock_and_fractions_need_no_unit(written):
    path = written("temperature [degC],stress [MPa],strain\n20,100,0.01\n20,100,0.01\n40,100,0.02\n")
    recording = read_recording(path, clock=False, observed=["strain"])
    assert not recording.has_clock
    np.testing.assert_array_equal(recording.time, [0, 1, 2])
    np.testing.assert_array_equal(recording.channels["stress"], 1e8)
    assert recording.units["strain"] == "1"
    assert len(recording.slice(1, 3)) == 2
    with pytest.raises(InputError, match="a path without a clock cannot be resampled"):
        recording.resample(0.1)
    with pytest.raises(InputError, match="the channel time is missing"):
        read_recording(path)


def test_bad_rows_are_dropped_on_request_counted_and_listed(written):
    rows = [
        "0,0.3,0",
        "0.1,,1",
        "0.2,nan,2",
        "0.2,0.3,2",
        "0.2,0.3,3",
        "0.1,0.3,4",
        "text,0.3,5",
        "",
        "0.3,0.3",
        "0.35,0.4,5",
    ]
    rows += [f"{0.4 + 0.1 * i:.1f},0.3,{i}" for i in range(12)]
    path = written("time [s],current [A],displacement [mm]\n" + "\n".join(rows) + "\n")
    recording = read_recording(path, drop_bad_rows=True)
    assert recording.notes == (
        "5 of 22 rows with a blank or unreadable cell dropped on request: row 3, 4, 8, 9, 10",
        "2 of 22 rows in which time does not increase dropped on request: row 6, 7",
    )
    np.testing.assert_allclose(recording.time[:4], [0, 0.2, 0.35, 0.4])
    np.testing.assert_array_equal(recording.channels["current"][:4], [0.3, 0.3, 0.4, 0.3])
    assert len(recording) == 15
    spoilt = "".join(f"{row / 10},{'' if row % 2 else 0.3}\n" for row in range(40))
    assert read_recording(written("time [s],current [A]\n" + spoilt), drop_bad_rows=True).notes == (
        "20 of 40 rows with a blank or unreadable cell dropped on request: row 3, 5, 7, 9, 11 and 15 more",
    )
    assert read_recording(written(GOOD), drop_bad_rows=True).notes == ()


def test_a_row_after_dropped_ones_keeps_its_number_in_messages(written):
    rows = "".join(f"{i},{'x' if i == 3 else 0.3},{3 if i == 7 else 0.1 + i / 100}\n" for i in range(10))
    with pytest.raises(InputError, match=r"row 9, column 'displacement \[m\]': the displacement of 3 m is above 1 m"):
        read_recording(written("time [s],current [A],displacement [m]\n" + rows), drop_bad_rows=True)


def test_rows_are_found_across_blocks(written, monkeypatch):
    monkeypatch.setattr(csv, "BLOCK", 100)
    rows = [f"{i / 100},{0.3 + i % 7 / 100:.2f},{i % 11 / 10}" for i in range(500)]
    text = "time [s],current [A],displacement [mm]\n" + "\n".join(rows)
    recording = read_recording(written(text + "\n\n\n"))
    np.testing.assert_array_equal(recording.time, np.arange(500) / 100)
    assert recording.sha256 == hashlib.sha256((text + "\n\n\n").encode()).hexdigest()
    for row in (0, 37, 256, 499):
        bad = rows.copy()
        bad[row] = "0,?,0"
        with pytest.raises(InputError, match=rf"row {row + 2}, column 'current \[A\]': '\?' is not a number"):
            read_recording(written("time [s],current [A],displacement [mm]\n" + "\n".join(bad)))
    gap = "time [s],current [A],displacement [mm]\n" + "\n".join([*rows[:200], "", *rows[200:]])
    with pytest.raises(InputError, match="row 202: the row is blank"):
        read_recording(written(gap))


UNITS = {
    "current": "mA",
    "temperature": "K",
    "ambient": "degF",
    "displacement": "mm",
    "angle": "deg",
    "strain": "%",
    "stress": "MPa",
}
VALUES = {
    "current": (-5, 5),
    "temperature": (10, 400),
    "ambient": (-30, 60),
    "displacement": (-0.1, 0.1),
    "angle": (-6, 6),
}
VALUES |= {"strain": (-0.1, 0.1), "stress": (-1e9, 1e9)}


@settings(max_examples=40, deadline=None)
@given(data=st.data(), suffix=st.sampled_from([".csv", ".parquet"]), clock=st.sampled_from(["s", "ms", None]))
def test_what_is_written_is_read_back_to_the_same_floats(tmp_path_factory, data, suffix, clock):
    count = data.draw(st.integers(2, 12))
    names = data.draw(st.lists(st.sampled_from(sorted(UNITS)), min_size=1, max_size=4, unique=True))
    channels = {}
    for name in names:
        channels[name] = np.array(data.draw(st.lists(st.floats(*VALUES[name]), min_size=count, max_size=count)))
    time = None
    if clock:
        time = np.cumsum(data.draw(st.lists(st.floats(1e-3, 10), min_size=count, max_size=count)))
    recording = Recording.from_arrays(
        "made", time, channels, {name: UNITS[name] for name in names} | ({"time": clock} if clock else {})
    )
    for name in names:
        np.testing.assert_allclose(recording.channels[name], channels[name], rtol=1e-12, atol=1e-12)
    path = tmp_path_factory.mktemp("written") / f"again{suffix}"
    recording.write(path)
    again = read_recording(
        path, clock=clock is not None, mapping={name: ChannelMap(name, any_scale=True) for name in recording.units}
    )
    np.testing.assert_array_equal(again.time, recording.time)
    assert again.units == recording.units and again.has_clock == recording.has_clock and list(again.channels) == names
    for name in names:
        np.testing.assert_array_equal(again.channels[name], recording.channels[name])
    assert [other.name for other in path.parent.iterdir()] == [path.name]


@settings(max_examples=40, deadline=None)
@given(
    values=st.lists(st.floats(0.002, 0.9), min_size=2, max_size=9),
    unit=st.sampled_from([("m", 1), ("mm", 1e3), ("um", 1e6), ("inch", 1 / 0.0254)]),
)
def test_values_do_not_depend_on_the_unit_of_the_column(tmp_path_factory, values, unit):
    name, factor = unit
    path = tmp_path_factory.mktemp("units") / "wire.csv"
    rows = "".join(f"{i},{value * factor!r}\n" for i, value in enumerate(values))
    path.write_text(f"time [s],displacement [{name}]\n{rows}")
    recording = read_recording(path, mapping={"displacement": ChannelMap("displacement", any_scale=True)})
    np.testing.assert_allclose(recording.channels["displacement"], values, rtol=1e-15)


def test_writing_refuses_other_endings_and_missing_folders(written, tmp_path):
    recording = read_recording(written(GOOD))
    with pytest.raises(InputError, match=r"recordings are written as \.csv or \.parquet"):
        recording.write(tmp_path / "wire.xls")
    with pytest.raises(InputError, match=r"the file cannot be written \(No such file or directory\)"):
        recording.write(tmp_path / "nowhere" / "wire.csv")


def test_a_slice_keeps_times_and_is_open_at_its_end(written):
    recording = read_recording(written(GOOD))
    part = recording.slice(0.02, 0.04)
    np.testing.assert_array_equal(part.time, [0.02])
    np.testing.assert_array_equal(part.channels["displacement"], [0.0005])
    assert part.sha256 == recording.sha256 and part.units == recording.units
    assert part.notes == ("cut to 1 of 3 rows, 0.02 <= time < 0.04 s",)
    assert len(recording.slice(-1, 9)) == 3
    with pytest.raises(InputError, match=r"wire.csv: no row lies in \[5, 9\) s: the recording runs from 0 to 0.04 s"):
        recording.slice(5, 9)


def test_resampling_is_linear_or_held(written):
    recording = read_recording(written("time [s],current [A],displacement [mm]\n0,0.1,0\n0.1,0.5,1\n0.3,0.2,3\n"))
    fine = recording.resample(0.05, hold={"current"})
    np.testing.assert_allclose(fine.time, np.arange(7) * 0.05)
    np.testing.assert_array_equal(fine.channels["current"], [0.1, 0.1, 0.5, 0.5, 0.5, 0.5, 0.2])
    np.testing.assert_allclose(fine.channels["displacement"], np.array([0, 0.5, 1, 1.5, 2, 2.5, 3]) * 1e-3, rtol=1e-12)
    assert fine.notes == ("resampled from 3 rows to 7, every 0.05 s",)
    same = recording.resample(0.3)
    assert len(same) == 2
    for step in (0.0, -1.0, np.nan, np.inf):
        with pytest.raises(InputError, match="give a positive one"):
            recording.resample(step)
    with pytest.raises(InputError, match=r"there is no channel 'curent' to hold \(did you mean 'current'\?\)"):
        recording.resample(0.1, hold={"curent"})
    with pytest.raises(InputError, match="give a larger one"):
        recording.resample(1e-12)


def test_inputs_between_samples():
    time = np.array([0.0, 0.1, 0.3])
    recording = Recording(
        "made", time, {"current": np.array([1.0, 2.0, 4.0]), "voltage": np.array([5.0, 5.0, 1.0])}, {}
    )
    times = np.array([-1.0, 0.0, 0.05, 0.1, 0.2, 0.3, 9.0])
    hold = sample_channels(recording, ["voltage", "current"], times, "hold")
    np.testing.assert_array_equal(hold, [[5, 1], [5, 1], [5, 1], [5, 2], [5, 2], [1, 4], [1, 4]])
    linear = sample_channels(recording, ["current"], times, "linear")
    np.testing.assert_allclose(linear[:, 0], [1, 1, 1.5, 2, 3, 4, 4])
    assert sample_channels(recording, [], times, "hold").shape == (7, 0)
    with pytest.raises(InputError, match="there is no channel 'curent'"):
        sample_channels(recording, ["curent"], times, "hold")
    with pytest.raises(InputError, match="interpolation = 'cubic' is not known"):
        sample_channels(recording, ["current"], times, "cubic")  # type: ignore[arg-type]


def test_rounding_does_not_delay_the_hold():
    # Times that are summed step by step differ from the samples by rounding, in both directions.
    time = np.array([float(f"{0.02 * i:.2f}") for i in range(6000)])
    recording = Recording("made", time, {"current": np.arange(6000.0)}, {})
    added_up = np.cumsum(np.full(6000, 0.02)) - 0.02
    assert (added_up < time).any() and (added_up > time).any()
    for times in (time, added_up, time + np.spacing(time), time - np.spacing(time), 0.02 * np.arange(6000)):
        np.testing.assert_array_equal(
            sample_channels(recording, ["current"], np.asarray(times, float), "hold")[:, 0], np.arange(6000.0)
        )
    np.testing.assert_array_equal(
        sample_channels(recording, ["current"], time[1:] - 1e-4, "hold")[:, 0], np.arange(5999.0)
    )


def test_matlab_files(tmp_path):
    import scipy.io

    path = tmp_path / "wire.mat"
    time = np.arange(5) * 20.0
    units = {"time": "ms", "current": "mA"}
    scipy.io.savemat(
        path, {"time": time, "current": time[:, None] + 100, "Laser": time.astype("int16"), "units": units}
    )
    recording = read_recording(path, mapping={"displacement": ChannelMap("Laser", "um")})
    np.testing.assert_array_equal(recording.time, np.arange(5) * 20 / 1000)
    np.testing.assert_array_equal(recording.channels["current"], (time + 100) / 1000)
    np.testing.assert_array_equal(recording.channels["displacement"], time / 1e6)
    assert recording.units == {"time": "ms", "current": "mA", "displacement": "um"}
    assert recording.sha256 == hashlib.sha256(path.read_bytes()).hexdigest()


def test_parquet_files_with_integers_and_gaps(tmp_path):
    path = tmp_path / "wire.parquet"
    table = {"time [ms]": [0, 20, 40, 60], "current [A]": [0.1, None, 0.3, 0.2], "state": ["a", "b", "c", "d"]}
    pyarrow.parquet.write_table(pyarrow.table(table), path)
    with pytest.raises(InputError, match=r"row 2, column 'current \[A\]': the cell is blank or not finite"):
        read_recording(path, ignore=["state"])
    named = read_recording(path, columns=["-", "current", "-"], sample_period="20 ms", drop_bad_rows=True)
    np.testing.assert_array_equal(named.channels["current"], [0.1, 0.3, 0.2])
    recording = read_recording(path, ignore=["state"], drop_bad_rows=True)
    np.testing.assert_array_equal(recording.time, [0, 0.04, 0.06])
    assert recording.notes == ("1 of 4 rows with a blank or unreadable cell dropped on request: row 2",)


def test_excel_sheets(tmp_path):
    openpyxl = pytest.importorskip("openpyxl")
    book = openpyxl.Workbook()
    book.active.append(["not this one"])
    sheet = book.create_sheet("run 2")
    table = [
        ["taken on Monday"],
        ["time [s]", "current [A]", "displacement [mm]"],
        [0, 0.3, 0],
        [1, "0.4", 2.5],
        [2, 0.5, 3],
    ]
    for row in [*table, [None, None, None]]:
        sheet.append(row)
    path = tmp_path / "wire.xlsx"
    book.save(path)
    recording = read_recording(path, sheet="run 2", skip_rows=1)
    np.testing.assert_array_equal(recording.channels["current"], [0.3, 0.4, 0.5])
    np.testing.assert_array_equal(recording.channels["displacement"], [0, 0.0025, 0.003])
    assert len(recording) == 3
    with pytest.raises(InputError, match=r"there is no sheet 'run2' \(did you mean 'run 2'\?\): it has Sheet, run 2"):
        read_recording(path, sheet="run2")
    with pytest.raises(InputError, match="column 'not this one' is not a known channel"):
        read_recording(path)
    sheet["B4"] = "none"
    book.save(path)
    with pytest.raises(InputError, match=r"row 4, column 'current \[A\]': 'none' is not a finite number"):
        read_recording(path, sheet="run 2", skip_rows=1)


def test_a_missing_extra_is_named(written, monkeypatch):
    monkeypatch.setitem(sys.modules, "openpyxl.reader.excel", None)
    with pytest.raises(InputError, match=r'need openpyxl: run pip install "smajax\[io\]"'):
        read_recording(written(b"not a workbook", "wire.xlsx"))


def test_too_large_a_file_is_refused_before_it_is_read(tmp_path, monkeypatch):
    path = tmp_path / "huge.csv"
    with path.open("wb") as file:
        file.write(b"time [s],current [A],displacement [mm]\n" + b"0.00,0.30,0.100\n" * (2 * csv.BLOCK // 16))
        file.truncate(40 * 2**30)  # a sparse file: it uses no space on the disk, and reading it would take minutes
    with pytest.raises(
        InputError, match=r"huge.csv: 2.68e\+09 rows of 3 columns need 180.0 GiB to read, above the limit of 2 GiB: cut"
    ):
        read_recording(path)


def test_rows_are_counted_while_they_are_read(written, monkeypatch):
    # 500 long rows, then short ones: the size of the file does not determine their number.
    monkeypatch.setattr(csv, "BLOCK", 1000)
    monkeypatch.setattr(base, "MEMORY_LIMIT", 8 * 8 * 2000)
    rows = "".join(f"{i}.000000000000000000000000000000000000000000,0.3\n" for i in range(500))
    assert len(read_recording(written("time [s],current [A]\n" + rows))) == 500
    with pytest.raises(InputError, match=r"2.*e\+03 rows of 2 columns need 0.0 GiB to read, above the limit of"):
        read_recording(written("time [s],current [A]\n" + rows + "".join(f"{i},0\n" for i in range(500, 2200))))


def rows_of_digits(numbers, width):
    digits = np.empty((len(numbers), width), np.uint8)
    for place in range(width - 1, -1, -1):
        digits[:, place] = ord("0") + numbers % 10
        numbers = numbers // 10
    return digits


READER = """
import resource
resource.setrlimit(resource.RLIMIT_AS, (2 * 2**30, 2 * 2**30))
import sys
from smajax.recordings.read import read_recording
recording = read_recording(sys.argv[1], required=["current"], observed=["displacement"])
print(len(recording), recording.time[-1], recording.channels["displacement"].sum())
"""


@pytest.mark.slow
@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="the limit of memory is that of Linux")
def test_ten_million_rows_are_read_within_two_gibibytes(tmp_path):
    path, total, block = tmp_path / "long.csv", 10_000_000, 1_000_000
    displacement_sum = 0
    with path.open("wb") as file:
        file.write(b"time [s],current [A],displacement [mm]\n")
        for start in range(0, total, block):
            row = np.arange(start, start + block)
            text = np.full((block, 23), ord(","), np.uint8)
            text[:, 0:5], text[:, 5], text[:, 6:9] = (
                rows_of_digits(row // 1000, 5),
                ord("."),
                rows_of_digits(row % 1000, 3),
            )
            text[:, 10:12], text[:, 12:15] = np.frombuffer(b"0.", np.uint8), rows_of_digits(row // 500 % 900 + 50, 3)
            displacement = 10_000 + row * 7919 % 10_000
            displacement_sum += int(displacement.sum())
            text[:, 16:17], text[:, 17] = rows_of_digits(displacement // 10_000, 1), ord(".")
            text[:, 18:22] = rows_of_digits(displacement, 4)
            text[:, 22] = ord("\n")
            file.write(text.tobytes())
    try:
        environment = {"OPENBLAS_NUM_THREADS": "1", "PYTHONPATH": str(ROOT)}
        result = subprocess.run(
            [sys.executable, "-c", READER, str(path)], env=environment, capture_output=True, text=True
        )
    finally:
        path.unlink()
    assert result.returncode == 0, result.stderr
    count, last, total_displacement = result.stdout.split()
    assert (int(count), float(last)) == (total, 9999.999)
    assert float(total_displacement) == pytest.approx(displacement_sum * 1e-7, rel=1e-12)


@pytest.mark.skipif(not (SHARED / "blind").is_dir(), reason="the shared recordings are not next to this checkout")
def test_every_shared_recording_is_in_order():
    paths = sorted((SHARED / "blind").glob("case-*/*.csv"))
    assert len(paths) >= 42
    for path in paths:
        observed = "angle" if "angle [deg]" in path.read_text()[:80] else "displacement"
        recording = read_recording(path, observed=[observed])
        table = np.loadtxt(path, delimiter=",", skiprows=1)
        np.testing.assert_array_equal(recording.time, table[:, 0])
        assert len(recording) in (4000, 6000) and set(recording.units) == {"time", *recording.channels}
