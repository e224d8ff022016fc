"""Recognition of files: headers, units by the values, layouts, clocks and rows that cannot be used."""

from pathlib import Path

import numpy as np
import openpyxl
import pytest

import smajax as sma
from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap, ColumnNote
from smajax.recordings.recognition.answers import answer_text, answers_by_header, parse_answer
from smajax.recordings.recognition.clock import time_scale
from smajax.recordings.recognition.header_words import read_header
from smajax.recordings.recognition.recognise import recognise
from smajax.recordings.recognition.value_ranges import scale_of

TIMES = np.arange(40) * 0.5


def table(columns: dict[str, object], delimiter: str = ",", decimal: str = ".") -> str:
    """A text file with 40 rows; a column is a list, or a function of the times."""
    lists = [c(TIMES).tolist() if callable(c) else list(c) for c in columns.values()]
    rows = [delimiter.join(str(value).replace(".", decimal) for value in row) for row in zip(*lists, strict=True)]
    return "\n".join([delimiter.join(columns), *rows]) + "\n"


def taken(path: Path, text: str | bytes, answers: dict[str, str] | None = None, **changes: object) -> dict[str, str]:
    """Write a file, recognise it, and return what each column was taken for."""
    path.write_bytes(text if isinstance(text, bytes) else text.encode())
    return {c.header: c.text for c in recognise(path, answers or {}, changes).columns}


def temperature(t):
    return 24 + t


@pytest.mark.parametrize(
    ("header", "channel", "unit"),
    [
        ("current", "current", None),
        ("I", "current", None),
        ("i_A", "current", "A"),
        ("Strom?", "current", None),
        ("PWM", "duty", None),
        ("T", "temperature", None),
        ("t", "time", None),
        ("X_Value", "time", None),
        ("T_amb", "ambient", None),
        ("room temp", "ambient", None),
        ("MCPtemp_0", "temperature", None),
        ("load", "force", None),
        ("pos", "displacement", None),
        ("Temp_C", "temperature", "degC"),
        ("force_N", "force", "N"),
        ("t_ms", "time", "ms"),
        ("Time(sec)", "time", "s"),
        ("Timestamp (millisec since midnight today)", "time", "ms"),
        ("Kraft / N", "force", "N"),
        ("Temp in °C", "temperature", "degC"),
        ("Spannung [MPa]", "stress", "MPa"),
        ("Weight (g)", "force", "gf"),
        ("_COM1 (C)", "temperature", "degC"),
        ("fan_pwm", "fan", None),
        ("tagid_x_101", None, None),
        ("multimeter", None, None),
    ],
)
def test_a_header_says_channel_and_unit(header, channel, unit):
    reading = read_header(header)
    assert (reading.channel, reading.unit) == (channel, unit)


@pytest.mark.parametrize("header", ["Temperature derivative", "u_setpoint", "temp_limit", "target_v"])
def test_a_set_value_is_not_a_measurement(header):
    assert read_header(header).other_quantity


@pytest.mark.parametrize(
    ("channel", "values", "unit", "others"),
    [
        ("temperature", [297, 310, 350], "K", ()),
        ("temperature", [24, 80, 24], "degC", ()),
        ("temperature", [320, 350, 390], "K", ("[degC]",)),
        ("temperature", [72, 180, 90], "degC", ("[degF]",)),
        ("current", [0, 0.4, 0.8], "A", ()),
        ("current", [0, 300, 500], "mA", ()),
        ("strain", [0, 0.02, 0.04], "1", ()),
        ("strain", [0.3, 4.3], "%", ()),
        ("stress", [100, 100], "MPa", ()),
        ("displacement", [0, 4.5], "mm", ()),
        ("displacement", [0, 0.05], "mm", ("[m]",)),
        ("angle", [0, 14], "deg", ()),
        ("force", [0, 8], "N", ("[gf]",)),
        ("duty", [0, 0.4], "1", ()),
        ("duty", [0, 100], "%", ()),
        ("duty", [0, 12.5, 60], "%", ()),
        ("duty", [0, 40], "%", ("full_scale=255",)),
    ],
)
def test_values_decide_a_unit_or_leave_a_doubt(channel, values, unit, others):
    scale = scale_of(channel, np.array(values, float))
    assert (scale.unit, scale.others) == (unit, others)
    assert bool(scale.doubt) == bool(others)


def test_a_pwm_has_the_full_scale_of_its_bits_despite_corrupt_packets():
    values = np.array([0.0, 105] * 200)
    assert scale_of("duty", values).full_scale == 255
    values[7] = 1025
    scale = scale_of("duty", values)
    assert scale.full_scale == 255 and "1 row outside 0 to 255 (up to 1025)" in scale.doubt
    assert scale_of("duty", np.array([0.0, 700, 1000])).full_scale == 1023


@pytest.mark.parametrize(
    ("word", "step", "rows", "unit", "doubtful"),
    [
        ("millis", 20, 100, "ms", False),
        ("Time", 0.014, 100, "s", False),
        ("Time", 5, 82, "s", False),
        ("Time", 20, 2000, "ms", False),
        ("Time", 20, 200, "ms", True),
        ("Time", 20000, 2000, "us", False),
    ],
)
def test_the_unit_of_a_time_is_judged_by_its_name_or_its_steps(word, step, rows, unit, doubtful):
    scale = time_scale(word, np.arange(rows) * float(step))
    assert (scale.unit, bool(scale.doubt)) == (unit, doubtful)


def test_seconds_since_1970_are_recognised():
    assert time_scale("Time", 1777061156.5 + np.arange(9.0)).unit == "s"
    assert time_scale("Time", 1777061156500 + 20 * np.arange(9.0)).unit == "ms"


@pytest.mark.parametrize(
    ("delimiter", "decimal"), [(",", "."), (";", ","), ("\t", "."), (" ", "."), ("\t", ","), ("|", ".")]
)
def test_delimiter_and_decimal_sign_are_recognised(tmp_path, delimiter, decimal):
    columns = {"time": TIMES, "temp": temperature, "current": lambda t: 0.1 * t / (1 + t)}
    path = tmp_path / "log.csv"
    path.write_text(table(columns, delimiter, decimal))
    recognition = recognise(path, {}, {})
    assert (recognition.options.delimiter, recognition.options.decimal) == (delimiter, decimal)
    assert [c.text for c in recognition.columns] == ["time [s]", "temperature [degC]", "current [A]"]
    assert not recognition.questions


def test_title_lines_units_row_and_a_blank_row_before_the_data(tmp_path):
    head = 'Operator: NN\n"Specimen","7"\nTime,Temp,Load\n'
    rows = "".join(f"{t},{24 + t},{2 + t / 10}\n" for t in TIMES)
    path = tmp_path / "log.csv"
    assert taken(path, f"{head}s,degC,N\n{rows}") == {
        "Time [s]": "time [s]",
        "Temp [degC]": "temperature [degC]",
        "Load [N]": "force [N]",
    }
    assert recognise(path, {}, {}).options.changed() == {"skip_rows": 2}
    assert taken(path, f"{head}\n{rows}")["Load"] == "force [N]"
    assert recognise(path, {}, {}).options.columns == ("Time", "Temp", "Load")


def test_the_heads_of_labview_are_no_data_also_where_they_have_numbers(tmp_path):
    block = ["Samples\t30\t30\t", "X0\t0,0\t0,0\t", "Delta_X\t0,5\t0,5\t", "***End_of_Header***\t\t\t"]
    names = "X_Value\tCurrent\tTemperature\tComment"
    rows = [f"{k / 2:.6f}\t{k % 3:.6f}\t{24 + k / 7:.6f}\t".replace(".", ",") for k in range(30)]
    path = tmp_path / "log.txt"
    path.write_text("\n".join(["LabVIEW Measurement\t", "Date\t2025/03/01", "", *block, names, *rows] * 2) + "\n")
    result = sma.import_recording(path)
    assert [len(recording) for recording in result.recordings] == [30, 30]
    assert all(recording.time[-1] == 14.5 for recording in result.recordings)
    assert result.recordings[1].channels["temperature"][-1] == pytest.approx(24 + 29 / 7, abs=1e-6)


def test_units_of_an_oscilloscope_are_words(tmp_path):
    path = tmp_path / "scope.csv"
    rows = "".join(f"{k / 5 - 2:.6E},{k % 5:.4E}\n" for k in range(20))
    path.write_text("Model,DS1054Z\nSample Interval,0.2\n\nTIME,CH1\nSecond,Volt\n" + rows)
    (recording,) = sma.import_recording(path).recordings
    assert recording.time[0] == -2.0 and recording.channels["voltage"][4] == 4.0


def test_repeated_and_blank_names_get_numbers(tmp_path):
    rows = "".join(f"{t},{24 + t},x,{25 + t}\n" for t in TIMES)
    names = taken(tmp_path / "log.csv", f"time,temp,,temp\n{rows}")
    assert list(names) == ["time", "temp", "column 3", "temp column 4"]


@pytest.mark.parametrize(("encoding", "text"), [("utf-16", "UTF-16"), ("cp1252", "cp1252")])
def test_encodings_are_named(tmp_path, encoding, text):
    path = tmp_path / "log.csv"
    content = table({"Zeit [s]": TIMES, "Temperatur [°C]": temperature}).encode(encoding)
    assert list(taken(path, content).values()) == ["time [s]", "temperature [degC]"]
    assert [f.choice for f in recognise(path, {}, {}).findings if f.subject == "encoding"] == [text]


def test_stamps_of_another_format_and_of_the_day(tmp_path):
    path = tmp_path / "log.csv"
    stamps = [f"13.03.2024 12:{k:02d}:00" for k in range(40)]
    assert taken(path, table({"Zeit": stamps, "temp": temperature}))["Zeit"] == "time [s]"
    assert recognise(path, {}, {}).options.time_format == "%d.%m.%Y %H:%M:%S"
    stamps = [f"3/4/2024 12:{k:02d}:00" for k in range(40)]
    assert taken(path, table({"when": stamps, "temp": temperature}))["when"] == "time [s]"
    question = next(q for q in recognise(path, {}, {}).questions if q.key == "time_format")
    assert question.choice == "%d/%m/%Y %H:%M:%S" and question.others == ("%m/%d/%Y %H:%M:%S",)
    stamps = [f"23:59:{k:02d}" for k in range(40)]
    assert taken(path, table({"clock": stamps, "temp": temperature}))["clock"] == "time [s]"


def test_a_file_without_a_time_asks_for_the_period_and_invents_none(tmp_path):
    path = tmp_path / "log.csv"
    text = table({"": range(40), "temp": temperature, "pwm": lambda t: 120 + 0 * t, "tick": lambda t: 0.019 * t / 0.5})
    assert taken(path, text) == {"": "-", "temp": "temperature [degC]", "pwm": "duty full_scale=255", "tick": "-"}
    recognition = recognise(path, {}, {})
    assert not recognition.has_clock and recognition.options.sample_period is None
    question = next(q for q in recognition.questions if q.key == "sample_period")
    assert question.choice == "" and question.option == "--sample-period '19 ms'" and "'tick'" in question.text
    assert recognise(path, {}, {"sample_period": "20 ms"}).has_clock


def test_counts_are_left_out_until_their_factor_is_given(tmp_path):
    path = tmp_path / "log.csv"
    text = table({"time": TIMES, "temp": temperature, "load cell": lambda t: np.round(800 - t).astype(int)})
    assert taken(path, text)["load cell"] == "-"
    question = next(q for q in recognise(path, {}, {}).questions if q.key == "load cell")
    assert "counts of a converter, whose factor the file does not say" in question.text
    answer = "force [N] factor=-0.0087 offset=7.5"
    assert taken(path, text, {"load cell": answer})["load cell"] == answer
    assert not recognise(path, {"load cell": answer}, {}).questions


def test_constant_empty_and_repeated_columns_are_left_out(tmp_path):
    columns = {
        "time": TIMES,
        "duty_a": lambda t: 0.4 * (t > 5),
        "duty_b": lambda t: 0 * t,
        "temp": temperature,
        "temp copy": temperature,
        "pos": lambda t: 0 * t,
        "strain": ["****"] * 40,
    }
    path = tmp_path / "log.csv"
    names = taken(path, table(columns))
    assert [h for h, text in names.items() if text == "-"] == ["duty_b", "temp copy", "pos", "strain"]
    reasons = {c.header: c.reason for c in recognise(path, {}, {}).columns}
    assert reasons["duty_b"] == "it is 0 in every row, while column 'duty_a' changes"
    assert reasons["temp copy"] == "it repeats column 'temp'"
    assert reasons["strain"] == "it has no numbers"


def test_the_kind_of_a_reason_is_a_code_and_notes_on_columns_are_of_their_own_class(tmp_path):
    path = tmp_path / "log.csv"
    path.write_text(table({"": lambda t: np.arange(len(t)), "time": TIMES, "temp": temperature, "zz": lambda t: t % 7}))
    choices = {c.header: c for c in recognise(path, {}, {}).columns}
    assert (choices[""].code, choices["temp"].code, choices["zz"].code) == ("counts-rows", "", "unknown")
    assert choices["zz"].reason == "its name says no channel" and choices["zz"].full_reason.endswith(")")
    assert choices["time"].word == "time"
    mapping = {"temperature": ChannelMap("temp", "degC"), "time": ChannelMap("time", "s")}
    notes = sma.read_recording(path, mapping=mapping, ignore=["zz"]).notes
    assert [type(note) for note in notes if "counts the rows" in note] == [ColumnNote]


def test_columns_of_several_wires_are_numbered_and_own_names_stay(tmp_path):
    columns = {
        "time": TIMES,
        "pwm1": lambda t: 0.4 * (t > 5),
        "pwm2": lambda t: 0.4 * (t < 5),
        "pos": lambda t: 0.1 * t,
    }
    path = tmp_path / "log.csv"
    assert list(taken(path, table(columns)).values())[1:3] == ["duty_1", "duty_2"]
    columns = {"time [s]": TIMES, "current_1 [A]": temperature, "current_2 [A]": lambda t: t / 3}
    assert list(taken(path, table(columns)).values())[1:] == ["current_1 [A]", "current_2 [A]"]


def test_repeated_stamps_are_dropped_and_restarts_split(tmp_path):
    path = tmp_path / "log.csv"
    times = np.repeat(np.arange(20), 2)
    path.write_text(table({"time [s]": times, "temp": temperature}))
    question = recognise(path, {}, {}).questions[-1]
    assert (question.key, question.choice) == ("on_bad_rows", "drop")
    assert question.text == "20 of 40 rows repeat the time of the row before, the first in row 3"
    path.write_text(table({"time [s]": np.tile(np.arange(20), 2), "temp": temperature}))
    question = recognise(path, {}, {}).questions[-1]
    assert question.choice == "split" and "1 of 40 rows are those in which the clock begins again" in question.text
    path.write_text(table({"time [s]": np.repeat(np.tile(np.arange(10), 2), 2), "temp": temperature}))
    assert recognise(path, {}, {}).questions[-1].choice == "split"
    assert recognise(path, {}, {"on_bad_rows": "drop"}).options.on_bad_rows == "drop"


def test_sheets_of_one_layout_are_read_and_others_named(tmp_path):
    book = openpyxl.Workbook()
    for k, name in enumerate(("50 MPa", "100 MPa", "Summary")):
        sheet = book.active if k == 0 else book.create_sheet()
        sheet.title = name
        rows = [(None, "Test", 7), (None, "Time", "Temp"), (None, None, None)]
        rows = [("mean", 3), (4, 5)] if k == 2 else [*rows, *((None, t, 24 + t) for t in TIMES)]
        for row in rows:
            sheet.append(row)
    path = tmp_path / "cycles.xlsx"
    book.save(path)
    recognition = recognise(path, {}, {})
    assert recognition.options.sheet == ("50 MPa", "100 MPa") and recognition.rows == (40, 40)
    assert [c.text for c in recognition.columns] == ["-", "time [s]", "temperature [degC]"]
    assert "'Summary' left out" in recognition.findings[0].reason


def test_a_file_without_names_is_asked_about_column_by_column(tmp_path):
    path = tmp_path / "cycle.txt"
    path.write_text("".join(f"{24 + t}\t{0.04 - t / 1000}\n" for t in TIMES))
    recognition = recognise(path, {"column 1": "temperature [degC]"}, {})
    assert [c.text for c in recognition.columns] == ["temperature [degC]", "-"]
    assert [(q.key, q.others[0]) for q in recognition.questions] == [("column 2", "strain [1]")]


def test_what_is_not_a_table_is_refused_in_a_sentence(tmp_path):
    path = tmp_path / "notes.txt"
    path.write_text("These are notes.\nNothing else.\n")
    with pytest.raises(InputError, match="no row of numbers was recognised in the first 2 rows"):
        recognise(path, {}, {})


@pytest.mark.parametrize(
    "text", ["force [N]", "force [N] factor=-0.0087 offset=7.5", "duty full_scale=255", "current_2 [mA]", "strain", "-"]
)
def test_an_answer_is_written_as_it_is_read(text):
    assert answer_text(*parse_answer("x", text)) == text


@pytest.mark.parametrize(
    ("text", "problem"),
    [
        ("forse [N]", "'forse' is not a channel"),
        ("force", "'force' has no unit: write it like 'force \\[N\\]'"),
        ("force [mm]", "'mm' is not a unit of force"),
        ("force [N] gain=2", "'gain' is not known"),
        ("force [N] factor=x", "factor = 'x' is not a number"),
        ("force [N] factor=0", "factor = 0.0 of column 'load' is not possible"),
        ("what?", "does not say what it is"),
    ],
)
def test_a_wrong_answer_is_refused(text, problem):
    with pytest.raises(InputError, match=problem):
        parse_answer("load", text)


def test_answers_on_the_command_line_name_their_column():
    texts = ["load cell = force [N] factor=-0.0087", "a=b=current [A]", "note=-"]
    assert answers_by_header(texts) == {"load cell": "force [N] factor=-0.0087", "a=b": "current [A]", "note": "-"}
    with pytest.raises(InputError, match="does not say what a column is"):
        answers_by_header(["load cell"])


def test_an_answer_for_a_column_that_is_not_there_is_refused(tmp_path):
    with pytest.raises(InputError, match=r"there is no column 'tmp' \(did you mean 'temp'\?\)"):
        taken(tmp_path / "log.csv", table({"time": TIMES, "temp": temperature}), {"tmp": "temperature [degC]"})


@pytest.mark.parametrize(
    ("header", "channel", "unit"),
    [
        ("force_mN", "force", "mN"),
        ("load_kN", "force", "kN"),
        ("current_mA", "current", "mA"),
        ("i_mA", "current", "mA"),
        ("v_mV", "voltage", "mV"),
        ("power_mW", "power", "mW"),
        ("stress_MPa", "stress", "MPa"),
        ("T_degC", "temperature", "degC"),
        ("Fz_N", "force", "N"),
        ("tempC", "temperature", "degC"),
    ],
)
def test_a_unit_after_the_last_separator_keeps_its_prefix(header, channel, unit):
    reading = read_header(header)
    assert (reading.channel, reading.unit) == (channel, unit)


# Neighbours of exports of instruments: text in bytes, with the same cycle.
def cycle(row: str, end: str = "\n") -> str:
    return "".join(row.format(t=5 * k, T=20 + 2 * k, e=4 - k / 10, s=100 + 0.1 * (k % 3)) + end for k in range(40))


EXPORTS = {
    "title, units and decimal commas": (
        "Versuch 7\r\n\r\nZeit;Temperatur;Dehnung;Spannung\r\ns;°C;%;MPa\r\n" + cycle("{t};{T};{e:.2f};{s:.1f}", "\r\n")
    ).replace(".", ",").encode("cp1252"),
    "UTF-16 with tabs": (
        "Time [s]\tTemp [°C]\tStrain [%]\tStress [MPa]\n" + cycle("{t}\t{T}\t{e:.2f}\t{s:.1f}")
    ).encode("utf-16-be"),
    "units as suffixes": ("t_ms,T_C,strain_pct,stress_MPa\n" + cycle("{t}000,{T},{e:.2f},{s:.1f}")).encode(),
}  # fmt: skip


@pytest.mark.parametrize("kind", EXPORTS)
def test_neighbours_of_exports_give_the_same_cycle(tmp_path, kind):
    path = tmp_path / "cycle.csv"
    path.write_bytes(EXPORTS[kind])
    (recording,) = sma.import_recording(path).recordings
    assert recording.time[-1] == pytest.approx(195.0)
    ends = {name: (values[0], values[-1]) for name, values in recording.channels.items()}
    assert ends["temperature"] == pytest.approx((20.0, 98.0)) and ends["strain"] == pytest.approx((0.04, 0.001))
    assert ends["stress"] == pytest.approx((1.0e8, 1.0e8))
