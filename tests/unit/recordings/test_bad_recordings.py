"""Messages for every kind of mistake in a recording."""

import os
from typing import Any

import numpy as np
import pyarrow.parquet
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax.errors import InputError
from smajax.recordings.column_mapping import ChannelMap
from smajax.recordings.read import read_recording

HEADER = "time [s],current [A],displacement [mm]\n"


def rows(*lines: str) -> str:
    return HEADER + "".join(line + "\n" for line in lines)


def column(header: str, values: Any) -> str:
    return f"time [s],{header}\n" + "".join(f"{0.1 * i:.1f},{value}\n" for i, value in enumerate(values))


# name, content of wire.csv, options of read, the sentence
TABLE = [
    (
        "empty",
        b"",
        {},
        "wire.csv: the file is empty: record a header like 'time [s],current [A]' and rows of numbers",
    ),
    (
        "blank",
        "\n \n",
        {},
        "wire.csv: the file is empty: record a header like 'time [s],current [A]' and rows of numbers",
    ),
    (
        "header_only",
        HEADER,
        {},
        "wire.csv: the file ends after the header in row 1: record at least two rows of data",
    ),
    (
        "header_and_blank_rows",
        HEADER + "\n\n",
        {},
        "wire.csv: the file ends after the header in row 1: record at least two rows of data",
    ),
    (
        "single_row",
        rows("0,0.3,0.1"),
        {},
        "wire.csv: the recording has a single row of data: record at least two",
    ),
    (
        "binary",
        bytes(range(256)) * 20,
        {},
        "wire.csv: row 1: the file is binary (byte 0x00), not text: save it as CSV in UTF-8",
    ),
    (
        "zeros",
        b"\0" * 4096,
        {},
        "wire.csv: row 1: the file is binary (byte 0x00), not text: save it as CSV in UTF-8",
    ),
    (
        "workbook_named_csv",
        b"PK\x03\x04" + bytes(100),
        {},
        "wire.csv: the file is a workbook or archive and not text: save it as CSV in UTF-8, or name it .xlsx",
    ),
    (
        "latin_1_cell",
        rows("0,0.3,0", "1,0.3 ±,1").encode("latin-1"),
        {},
        "wire.csv: row 3, column 'current [A]': '0.3 ±' is not a number: correct it, or leave such rows out "
        "with --drop-bad-rows",
    ),
    (
        "old_macintosh_rows",
        rows("0,0.3,0", "1,0.3,1").replace("\n", "\r"),
        {},
        "wire.csv: row 1: rows end in a bare carriage return: save the file as Unix or Windows text",
    ),
    (
        "return_inside_a_row",
        rows("0,0.3,0", "1,0.3\r,1"),
        {},
        "wire.csv: row 3: the row cannot be divided into cells: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "header_missing",
        "0,0.3,0\n1,0.3,1\n",
        {},
        "wire.csv: row 1: the header is missing ('0' is a number): begin with a row like 'time [s],current "
        "[A]', or set columns under [recording] in the rig",
    ),
    (
        "header_row_blank",
        "\n" + rows("0,0.3,0", "1,0.3,1"),
        {},
        "wire.csv: row 1: the row is blank where the header is expected: give names and units, or set skip_rows",
    ),
    (
        "preamble",
        "logger v3\n" + rows("0,0.3,0", "1,0.3,1"),
        {},
        "wire.csv: row 1: the row has a single cell, 'logger v3', and row 2 has 3: set skip_rows = 1 under "
        "[recording] in the rig",
    ),
    (
        "skip_rows_beyond_the_end",
        rows("0,0.3,0", "1,0.3,1"),
        {"skip_rows": 9},
        "wire.csv: the file has only 3 rows, fewer than skip_rows = 9: lower skip_rows",
    ),
    (
        "skip_rows_negative",
        rows("0,0.3,0", "1,0.3,1"),
        {"skip_rows": -1},
        "wire.csv: skip_rows = -1 is negative: give the number of rows before the header",
    ),
    (
        "skip_rows_past_the_header",
        rows("0,0.3,0", "1,0.3,1"),
        {"skip_rows": 1},
        "wire.csv: row 2: the header is missing ('0' is a number): begin with a row like 'time [s],current "
        "[A]', or set columns under [recording] in the rig",
    ),
    (
        "unit_missing",
        "time [s],current\n0,0.3\n1,0.3\n",
        {},
        "wire.csv: column 'current' has no unit: write the header like 'current [A]', or give the unit under [channels]",
    ),
    (
        "unit_blank",
        "time [s],current []\n0,0.3\n1,0.3\n",
        {},
        "wire.csv: column 'current []' has no unit: write the header like 'current [A]', or give the unit under [channels]",
    ),
    (
        "unit_unknown",
        column("current [mAmp]", [1, 2, 3]),
        {},
        "wire.csv: column 'current [mAmp]': the unit 'mAmp' is not known (did you mean 'mA'?): write one as in '0.3 A'",
    ),
    (
        "unit_of_another_kind",
        column("current [mm]", [1, 2, 3]),
        {},
        "wire.csv: column 'current [mm]': the unit 'mm' does not fit: a unit that converts to A is expected, as in '0.3 A'",
    ),
    (
        "unit_coulomb_for_celsius",
        column("temperature [C]", [20, 30, 40]),
        {},
        "wire.csv: column 'temperature [C]': the unit 'C' does not fit (did you mean 'degC'?): a unit that converts to degC is "
        "expected, as in '20 degC'",
    ),
    (
        "unit_is_code",
        column("current [9**9**9**9]", [1, 2, 3]),
        {},
        "wire.csv: column 'current [9**9**9**9]': the unit '9**9**9**9' is not understood at '9**9**9**9': write it like 'mm', "
        "'N m' or 'W/m^2/K'",
    ),
    (
        "angle_in_percent",
        column("angle [%]", [1, 2, 3]),
        {},
        "wire.csv: column 'angle [%]': the unit '%' does not fit: a unit that converts to rad is expected, as in '20 deg'",
    ),
    (
        "channel_misspelt",
        column("displacment [mm]", [1, 2, 3]),
        {},
        "wire.csv: column 'displacment [mm]' is not a known channel (did you mean 'displacement'?): rename it, map it under "
        '[channels] in the rig, or leave it out with [channels] ignore = ["displacment [mm]"]',
    ),
    (
        "channel_capitalised",
        column("Current_2 [A]", [1, 2, 3]),
        {},
        "wire.csv: column 'Current_2 [A]' is not a known channel (did you mean 'current_2'?): rename it, map it under "
        '[channels] in the rig, or leave it out with [channels] ignore = ["Current_2 [A]"]',
    ),
    (
        "channel_unknown",
        column("humidity [%]", [1, 2, 3]),
        {},
        "wire.csv: column 'humidity [%]' is not a known channel (did you mean 'duty'?): rename it, map it under [channels] in "
        'the rig, or leave it out with [channels] ignore = ["humidity [%]"]',
    ),
    (
        "channel_number_zero",
        column("current_0 [A]", [1, 2, 3]),
        {},
        "wire.csv: column 'current_0 [A]' is not a known channel (did you mean 'current_1'?): rename it, map it under "
        '[channels] in the rig, or leave it out with [channels] ignore = ["current_0 [A]"]',
    ),
    (
        "header_cell_blank",
        "time [s],current [A],\n0,0.3,\n1,0.3,7\n",
        {},
        "wire.csv: column 3 has no header: write one like 'current [A]', or leave the column out with "
        '[channels] ignore = [""] in the rig',
    ),
    (
        "columns_doubled",
        "time [s],current [A],current [mA]\n0,0.3,300\n1,0.3,300\n",
        {},
        "wire.csv: columns 2 ('current [A]') and 3 ('current [mA]') are both current: number them current_1 and current_2, or ignore one",
    ),
    (
        "mapped_and_known",
        "time [s],force [N],Load\n0,1,1\n1,2,2\n",
        {"mapping": {"force": ChannelMap("Load", "N")}},
        "wire.csv: columns 2 ('force [N]') and 3 ('Load') are both force: number them force_1 and force_2, or ignore one",
    ),
    (
        "mapped_without_unit",
        "time [s],Load\n0,1\n1,2\n",
        {"mapping": {"force": ChannelMap("Load")}},
        "wire.csv: column 'Load' has no unit: write the header like 'force [N]', or give the unit under [channels]",
    ),
    (
        "mapped_with_wrong_unit",
        "time [s],Load\n0,1\n1,2\n",
        {"mapping": {"force": ChannelMap("Load", "kg")}},
        "wire.csv: column 'Load': the unit 'kg' does not fit (did you mean 'kgf'?): a unit that converts to N is "
        "expected, as in '9.81 N'",
    ),
    (
        "mapped_to_unknown_channel",
        "time [s],Load\n0,1\n1,2\n",
        {"mapping": {"forces": ChannelMap("Load", "N")}},
        "wire.csv: [channels] forces in the rig is not a known channel (did you mean 'force'?): choose one of time, current, "
        "voltage, power, duty, temperature, ambient, fan, displacement, angle, rate, force, torque, stress, strain, resistance",
    ),
    (
        "mapped_and_ignored",
        "time [s],Load\n0,1\n1,2\n",
        {"mapping": {"force": ChannelMap("Load", "N")}, "ignore": ["Load"]},
        "wire.csv: column 'Load' is both ignored and mapped to force: remove one of the two",
    ),
    (
        "all_ignored",
        "a,b\n0,1\n1,2\n",
        {"ignore": ["a", "b"], "clock": False},
        "wire.csv: every column is ignored: keep at least one of a, b",
    ),
    (
        "time_missing",
        "current [A],displacement [mm]\n0.3,0\n0.3,1\n",
        {},
        "wire.csv: the channel time is missing: it has current, displacement, so add a column 'time [s]' "
        'or map one to time under [channels] in the rig, or set sample_period = "20 ms" under [recording] if '
        "the file has none",
    ),
    (
        "input_missing",
        column("current_1 [A]", [1, 2, 3]),
        {"required": ["current"]},
        "wire.csv: the channel current is missing (did you mean 'current_1'?): it has time, current_1, so add a column "
        "'current [A]' or map one to current under [channels] in the rig",
    ),
    (
        "observed_missing",
        rows("0,0.3,0", "1,0.3,1"),
        {"observed": ["temperature"]},
        "wire.csv: the channel temperature is missing: it has time, current, displacement, so add a column 'temperature "
        "[degC]' or map one to temperature under [channels] in the rig",
    ),
    (
        "mapped_column_missing",
        column("current [A]", [1, 2, 3]),
        {"required": ["displacement"], "mapping": {"displacement": ChannelMap("Laser", "mm")}},
        "wire.csv: the channel displacement, which the rig maps to column 'Laser', is missing: it has time, current, so "
        "add a column 'displacement [m]' or map one to displacement under [channels] in the rig",
    ),
    (
        "row_too_short",
        rows("0,0.3,0", "1,0.3", "2,0.3,1"),
        {},
        "wire.csv: row 3: the row has 2 cells and the header 3: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "row_too_long",
        rows("0,0.3,0", "1,0.3,1,1,1,1,1", "2,0.3,1"),
        {},
        "wire.csv: row 3: the row has 7 cells and the header 3: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "row_cut_off_at_the_end",
        rows("0,0.3,0", "1,0.3,1") + "2,0.",
        {},
        "wire.csv: row 4: the row has 2 cells and the header 3: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "row_blank",
        rows("0,0.3,0", "", "2,0.3,1"),
        {},
        "wire.csv: row 3: the row is blank: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_text",
        rows("0,0.3,0", "1,off,1"),
        {},
        "wire.csv: row 3, column 'current [A]': 'off' is not a number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_blank",
        rows("0,0.3,0", "1,,1"),
        {},
        "wire.csv: row 3, column 'current [A]': the cell is blank: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_spaces",
        rows("0,0.3,0", "1,  ,1"),
        {},
        "wire.csv: row 3, column 'current [A]': the cell is blank: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_nan",
        rows("0,0.3,0", "1,0.3,NaN"),
        {},
        "wire.csv: row 3, column 'displacement [mm]': 'NaN' is not a finite number: correct it, or leave such rows out with "
        "--drop-bad-rows",
    ),
    (
        "cell_minus_infinity",
        rows("0,0.3,0", "1,-inf,1"),
        {},
        "wire.csv: row 3, column 'current [A]': '-inf' is not a finite number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_overflow",
        rows("0,0.3,0", "1,1e999,1"),
        {},
        "wire.csv: row 3, column 'current [A]': '1e999' is too large for a number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_underscore",
        rows("0,0.3,0", "1_0,0.3,1"),
        {},
        "wire.csv: row 3, column 'time [s]': '1_0' is not a number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_hexadecimal",
        rows("0,0.3,0", "1,0x1F,1"),
        {},
        "wire.csv: row 3, column 'current [A]': '0x1F' is not a number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_foreign_digits",
        rows("0,0.3,0", "1,٣,1"),
        {},
        "wire.csv: row 3, column 'current [A]': '٣' is not a number: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "cell_very_long",
        rows("0,0.3,0", "1," + "x" * 500 + ",1"),
        {},
        "wire.csv: row 3, column 'current [A]': 'xxxxxxxxxxxxxxxxxxxxxxxxxxx...' is not a number: correct it, or leave such "
        "rows out with --drop-bad-rows",
    ),
    (
        "comma_decimals_with_semicolons",
        rows("0,0;0,3;0,1", "0,1;0,3;0,2").replace("s],", "s];").replace("A],", "A];"),
        {},
        'wire.csv: row 1: the columns are separated by ";": set delimiter = ";" and decimal = "," under '
        "[recording] in the rig",
    ),
    (
        "semicolons",
        rows("0;0.3;0.1", "1;0.3;0.2").replace(",", ";"),
        {},
        'wire.csv: row 1: the columns are separated by ";": set delimiter = ";" under [recording] in the rig',
    ),
    (
        "tabs",
        rows("0,0.3,0.1", "1,0.3,0.2").replace(",", "\t"),
        {},
        'wire.csv: row 1: the columns are separated by "\\t": set delimiter = "\\t" under [recording] in the rig',
    ),
    (
        "comma_decimals_with_delimiter_set",
        rows("0,0;0,3;0,1", "0,1;0,3;0,2").replace("s],", "s];").replace("A],", "A];"),
        {"delimiter": ";"},
        "wire.csv: row 2, column 'time [s]': '0,0' has a decimal comma: set decimal = \",\" under "
        "[recording] in the rig",
    ),
    (
        "comma_decimals_between_commas",
        rows("0,0,0,3,0,1", "0,1,0,3,0,2"),
        {},
        "wire.csv: row 2: the row has 6 cells and the header 3: if the commas are decimal commas, save with "
        "another delimiter and set delimiter and decimal under [recording]",
    ),
    (
        "decimal_points_where_commas_are_declared",
        rows("0;0.3;0", "1;0.3;1").replace(",", ";"),
        {"delimiter": ";", "decimal": ","},
        "wire.csv: row 2, column 'current [A]': '0.3' has a decimal point although decimal is \",\": write every number in the same way",
    ),
    (
        "delimiter_impossible",
        rows("0,0.3,0", "1,0.3,1"),
        {"delimiter": ";;"},
        'wire.csv: delimiter = \';;\' is not possible: give one such as ",", ";" or "\\t"',
    ),
    (
        "decimal_impossible",
        rows("0,0.3,0", "1,0.3,1"),
        {"decimal": "'"},
        'wire.csv: decimal = "\'" is not known: it is "." or ","',
    ),
    (
        "delimiter_is_decimal",
        rows("0,0.3,0", "1,0.3,1"),
        {"decimal": ","},
        'wire.csv: delimiter and decimal are both ",": set delimiter = ";" or "\\t"',
    ),
    (
        "quote_never_closed",
        rows("0,0.3,0", '1,"0.3,1'),
        {},
        "wire.csv: row 3: the row has 2 cells and the header 3: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "time_stands_still",
        rows("0,0.3,0", "0.02,0.3,1", "0.02,0.3,2"),
        {},
        "wire.csv: row 4, column 'time [s]': time does not increase at 0.02 s: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "time_runs_back",
        rows("0,0.3,0", "0.04,0.3,1", "0.02,0.3,2"),
        {},
        "wire.csv: row 4, column 'time [s]': time decreases from 0.04 to 0.02 s: correct it, or leave such rows out with --drop-bad-rows",
    ),
    (
        "observed_never_changes",
        rows("0,0.3,2.5", "1,0.3,2.5", "2,0.3,2.5"),
        {"observed": ["displacement"]},
        "wire.csv: column 'displacement [mm]': the observed channel displacement is 2.5 mm in all 3 rows: check the sensor, or "
        "remove it from [fit] observe",
    ),
    (
        "milliampere_as_ampere",
        column("current [A]", [280, 300, 320]),
        {},
        "wire.csv: row 2, column 'current [A]': the current of 280 A is above 50 A, and the numbers look like mA: correct the "
        "header to 'current [mA]', or, if it is right, give current any_scale = true under [channels] in the rig",
    ),
    (
        "ampere_as_milliampere",
        column("current [mA]", [0.28, 0.3, 0.32]),
        {},
        "wire.csv: row 4, column 'current [mA]': the largest current, 0.32 mA, is below 1 mA, and the numbers look like A: "
        "correct the header to 'current [A]', or, if it is right, give current any_scale = true under [channels] in the rig",
    ),
    (
        "millimetre_as_metre",
        column("displacement [m]", [0.1, 5, 9.8]),
        {},
        "wire.csv: row 3, column 'displacement [m]': the displacement of 5 m is above 1 m, and the numbers look like mm: "
        "correct the header to 'displacement [mm]', or, if it is right, give displacement any_scale = true under [channels] in "
        "the rig",
    ),
    (
        "micrometre_as_millimetre",
        column("displacement [mm]", [100, 5000, 9800]),
        {},
        "wire.csv: row 3, column 'displacement [mm]': the displacement of 5000 mm is above 1000 mm, and the numbers look like "
        "um: correct the header to 'displacement [um]', or, if it is right, give displacement any_scale = true under "
        "[channels] in the rig",
    ),
    (
        "megapascal_as_pascal",
        column("stress [Pa]", [100, 200, 300]),
        {},
        "wire.csv: row 4, column 'stress [Pa]': the largest stress, 300 Pa, is below 10000 Pa, and the numbers look like MPa: "
        "correct the header to 'stress [MPa]', or, if it is right, give stress any_scale = true under [channels] in the rig",
    ),
    (
        "pascal_as_megapascal",
        column("stress [MPa]", [1e8, 2e8, 3e8]),
        {},
        "wire.csv: row 2, column 'stress [MPa]': the stress of 1e+08 MPa is above 5000 MPa, and the numbers look like Pa: "
        "correct the header to 'stress [Pa]', or, if it is right, give stress any_scale = true under [channels] in the rig",
    ),
    (
        "kelvin_as_celsius",
        column("temperature [degC]", [293.2, 320, 360]),
        {},
        "wire.csv: row 2, column 'temperature [degC]': a temperature that starts at 293.2 degC and is never below 293.2 degC "
        "is not one in degC, and the numbers look like K: correct the header to 'temperature [K]', or, if it is right, give "
        "temperature any_scale = true under [channels] in the rig",
    ),
    (
        "celsius_as_kelvin",
        column("temperature [K]", [20, 50, 90]),
        {},
        "wire.csv: row 2, column 'temperature [K]': the temperature of 20 K is below 73.15 K, and the numbers look like degC: "
        "correct the header to 'temperature [degC]', or, if it is right, give temperature any_scale = true under [channels] in "
        "the rig",
    ),
    (
        "millikelvin_as_celsius",
        column("temperature [degC]", [293150, 300000, 310000]),
        {},
        "wire.csv: row 2, column 'temperature [degC]': the temperature of 293150 degC is above 900 degC, and the numbers look "
        "like mK: correct the header to 'temperature [mK]', or, if it is right, give temperature any_scale = true under "
        "[channels] in the rig",
    ),
    (
        "degrees_as_radian",
        column("angle [rad]", [0, 30, 60]),
        {},
        "wire.csv: row 3, column 'angle [rad]': the angle of 30 rad is above 20 rad, and the numbers look like deg: correct "
        "the header to 'angle [deg]', or, if it is right, give angle any_scale = true under [channels] in the rig",
    ),
    (
        "percent_as_duty",
        column("duty [1]", [0, 50, 100]),
        {},
        "wire.csv: row 3, column 'duty [1]': the duty of 50 is above 1, and the numbers look like %: correct the header to "
        "'duty [%]', or, if it is right, give duty any_scale = true under [channels] in the rig",
    ),
    (
        "negative_duty",
        column("duty [1]", [0, 0.5, -0.1]),
        {},
        "wire.csv: row 4, column 'duty [1]': the duty of -0.1 is below 0, outside the range of rigs with SMA wires: correct "
        "the unit or the value, or, if it is right, give duty any_scale = true under [channels] in the rig",
    ),
    (
        "percent_as_strain",
        column("strain [1]", [0, 2.1, 4.1]),
        {},
        "wire.csv: row 3, column 'strain [1]': the strain of 2.1 is above 0.5, and the numbers look like %: correct the header "
        "to 'strain [%]', or, if it is right, give strain any_scale = true under [channels] in the rig",
    ),
    (
        "beyond_every_unit",
        column("angle [deg]", [0, 1e9, 3e9]),
        {},
        "wire.csv: row 3, column 'angle [deg]': the angle of 1e+09 deg is above 1145.92 deg, outside the range of rigs with SMA "
        "wires: correct the unit or the value, or, if it is right, give angle any_scale = true under [channels] in the "
        "rig",
    ),
    (
        "too_large_in_si",
        column("force [kN]", [1, 1e307, 2]),
        {"mapping": {"force": ChannelMap("force", any_scale=True)}},
        "wire.csv: column 'force [kN]': numbers too large for N: correct the unit",
    ),
    (
        "mapped_in_the_wrong_unit",
        "time [s],PSU\n0,300\n1,310\n",
        {"mapping": {"current_1": ChannelMap("PSU", "A")}},
        "wire.csv: row 2, column 'PSU': the current of 300 A is above 50 A, and the numbers look like mA: correct [channels] "
        'current_1 to unit = "mA", or, if it is right, give current_1 any_scale = true under [channels] in the rig',
    ),
    (
        "current_scale_jumps",
        column("current [A]", [*np.linspace(0.2, 0.3, 20), *np.linspace(305, 400, 20)]),
        {},
        "wire.csv: row 22, column 'current [A]': the scale of current jumps by a factor of 1000 from 0.3 to 305 A, as if the "
        "unit changed: write all rows in one unit",
    ),
    (
        "displacement_scale_jumps_up",
        column("displacement [um]", [*np.linspace(2, 3, 20), *np.linspace(3050, 4000, 20)]),
        {},
        "wire.csv: row 22, column 'displacement [um]': the scale of displacement jumps by a factor of 1000 from 3 to 3050 um, "
        "as if the unit changed: write all rows in one unit",
    ),
    (
        "displacement_scale_jumps_down",
        column("displacement [mm]", [*np.linspace(2, 3, 20), *np.linspace(3.05e-3, 4e-3, 20)]),
        {},
        "wire.csv: row 22, column 'displacement [mm]': the scale of displacement jumps by a factor of 1000 from 3 to 0.00305 "
        "mm, as if the unit changed: write all rows in one unit",
    ),
    (
        "kelvin_half_way",
        column("temperature [degC]", [*np.linspace(20, 60, 20), *np.linspace(335, 360, 20)]),
        {},
        "wire.csv: row 22, column 'temperature [degC]': the temperature jumps by 273.15 from 60 to 335 degC, as if degC and K "
        "were mixed: write all rows in one unit",
    ),
    (
        "time_scale_jumps",
        rows(*(f"{t},0.3,{i}" for i, t in enumerate([1, 1.1, 1.2, 1.3, 1400, 1500, 1600, 1700]))),
        {},
        "wire.csv: row 6, column 'time [s]': the scale of time jumps by a factor of 1000 from 1.3 to 1400 s, as if the unit "
        "changed: write all rows in one unit",
    ),
    (
        "too_many_bad_rows",
        rows("0,0.3,0", "0,x,0", "0,x,0", "0,x,0"),
        {"drop_bad_rows": True},
        "wire.csv: 3 of 4 rows are bad, the first of them row 3, too many to drop: correct them",
    ),
    (
        "nothing_left_but_one_row",
        rows("0,0.3,0", "0,x,0"),
        {"drop_bad_rows": True},
        "wire.csv: the recording has a single row of data: record at least two",
    ),
]


@pytest.mark.parametrize(("content", "options", "sentence"), [row[1:] for row in TABLE], ids=[row[0] for row in TABLE])
def test_bad_recordings_are_refused(tmp_path, monkeypatch, content, options, sentence):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "wire.csv").write_bytes(content if isinstance(content, bytes) else content.encode())
    with pytest.raises(InputError) as refusal:
        read_recording("wire.csv", **options)
    assert str(refusal.value) == sentence
    assert refusal.value.exit_code == 2


def test_every_message_is_one_line():
    assert len({row[0] for row in TABLE}) == len(TABLE) >= 40
    for _, _, _, sentence in TABLE:
        assert sentence.startswith("wire.csv: ") and "\n" not in sentence and not sentence.endswith(".")


def test_rows_that_are_refused_can_be_dropped(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    promised = [row for row in TABLE if "--drop-bad-rows" in row[3]]
    assert len(promised) >= 15
    for name, content, options, _ in promised:
        start = content if isinstance(content, bytes) else content.encode()
        more = "".join(f"{86400 + i},0.3,{0.1 * i:.1f}\n" for i in range(9)).encode()
        (tmp_path / "wire.csv").write_bytes(start + (b"" if start.endswith(b"\n") else b"\n") + more)
        recording = read_recording("wire.csv", **options, drop_bad_rows=True)
        assert len(recording.notes) == 1 and "dropped on request: row" in recording.notes[0], name


def matlab(**variables):
    def write(path):
        import scipy.io

        scipy.io.savemat(path, variables)

    return write


def damaged_matlab(path):
    matlab(time=np.arange(3.0), current=np.arange(3.0), units={"time": "s", "current": "A"})(path)
    content = bytearray(path.read_bytes())
    content[176] = 65  # the type of the first vector's numbers, on which scipy's reader would crash
    path.write_bytes(content)


def parquet(time, current):
    def write(path):
        table = pyarrow.table({"time [s]": time, "current [A]": current})
        pyarrow.parquet.write_table(table, path)

    return write


def excel(*lines):
    def write(path):
        book = pytest.importorskip("openpyxl").Workbook()
        for line in lines:
            book.active.append(line)
        book.save(path)

    return write


def raw(content):
    return lambda path: path.write_bytes(content)


UNITS = {"time": "s", "current": "A"}
TIME = np.arange(3.0)
OTHERS = [
    ("wire.csv", lambda path: None, "wire.csv: there is no such file: check the path"),
    (
        "wire.csv",
        lambda path: (path.parent / "wires.csv").touch(),
        "wire.csv: there is no such file (did you mean 'wires.csv'?): check",
    ),
    (
        "wire.csv",
        lambda path: path.mkdir(),
        "wire.csv: this is a folder: name a recording, a file ending in .csv, .txt, .mat, .parquet",
    ),
    ("wire.csv", lambda path: os.mkfifo(path), "wire.csv: this is not a regular file: name a recording"),
    (
        "wire.xls",
        raw(b"x"),
        "wire.xls: files ending in '.xls' are not read: save the recording as .csv, .txt, .mat, .parquet, .xlsx",
    ),
    ("wire", raw(b"x"), "wire: files ending in '' are not read"),
    ("wire.mat", raw(b""), "wire.mat: the file is empty"),
    ("wire.mat", raw(b"time,current" * 40), "wire.mat: the file is not readable as MATLAB data ("),
    (
        "wire.mat",
        raw(b"MATLAB 7.3 MAT-file".ljust(124) + b"\0\2IM" + bytes(384)),
        "wire.mat: the file is not readable as MATLAB data of version 7.3 (",
    ),
    (
        "wire.mat",
        damaged_matlab,
        "wire.mat: the file is not readable as MATLAB data (it is damaged): save it again with '-v7'",
    ),
    ("wire.mat", matlab(), "wire.mat: the file has no variables: save one vector per channel"),
    (
        "wire.mat",
        matlab(time=TIME, current=TIME),
        "wire.mat: column 'time' has no unit: write the header like 'time [s]'",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current=TIME, units="s"),
        "wire.mat: variable 'units' is not a struct with one text per channel",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current=TIME[:2], units=UNITS),
        "wire.mat: variable 'current' has 2 values and 'time' 3: give every",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current=np.ones((3, 2)), units=UNITS),
        "wire.mat: variable 'current': the array of shape (3, 2) is not",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current=1j * TIME, units=UNITS),
        "wire.mat: variable 'current': the values are not real numbers (type",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current="on", units=UNITS),
        "wire.mat: variable 'current': the values are not real numbers (type",
    ),
    (
        "wire.mat",
        matlab(time=[], current=[], units=UNITS),
        "wire.mat: variable 'time': the vector is empty: record at least two samples",
    ),
    (
        "wire.mat",
        matlab(time=TIME, current=[1, np.nan, 3], units=UNITS),
        "wire.mat: row 2, column 'current': the value is not finite:",
    ),
    (
        "wire.mat",
        matlab(time=TIME[::-1], current=TIME, units=UNITS),
        "wire.mat: row 2, column 'time [s]': time decreases from 2 to 1 s",
    ),
    ("wire.parquet", raw(b"time,current"), "wire.parquet: the file is not readable as Parquet ("),
    ("wire.parquet", raw(b"PAR1" + bytes(99) + b"PAR1"), "wire.parquet: the file is not readable as Parquet ("),
    ("wire.parquet", parquet([], []), "wire.parquet: the table has columns and no rows: record at least two"),
    ("wire.parquet", parquet([1, 2], ["a", "b"]), "wire.parquet: column 'current [A]': the values are of type str"),
    ("wire.parquet", parquet([1, 2], [np.inf, 1]), "wire.parquet: row 1, column 'current [A]': the cell is bla"),
    ("wire.xlsx", raw(b"time,current"), "wire.xlsx: the file is not readable as a workbook ("),
    ("wire.xlsx", raw(b"PK\3\4" + bytes(400)), "wire.xlsx: the file is not readable as a workbook ("),
    (
        "wire.xlsx",
        excel(),
        "wire.xlsx: row 1: the row is blank where the header is expected: give names and units, or set skip_rows",
    ),
    (
        "wire.xlsx",
        excel([0, 0.3], [1, 0.3]),
        "wire.xlsx: row 1: the header is missing ('0' is a number): begin with cells like 'time [s]'",
    ),
    (
        "wire.xlsx",
        excel(["time [s]", "current [A]"]),
        "wire.xlsx: the sheet ends after the header in row 1: record at least two rows",
    ),
    (
        "wire.xlsx",
        excel(["time [s]", "current [A]"], [0, 1], [], [2, 1]),
        "wire.xlsx: row 3, column 'time [s]': the cell is blank:",
    ),
    (
        "wire.xlsx",
        excel(["time [s]", "current [A]"], [0, True], [2, 1]),
        "wire.xlsx: row 2, column 'current [A]': 'True' is not a number",
    ),
    (
        "wire.xlsx",
        excel(["time [s]", "current [A]"], [0, "0,3"]),
        "wire.xlsx: row 2, column 'current [A]': '0,3' has a decimal comma: set",
    ),
]


@pytest.mark.parametrize(("name", "write", "sentence"), OTHERS, ids=[f"{i}_{row[0]}" for i, row in enumerate(OTHERS)])
def test_other_bad_files_are_refused(tmp_path, monkeypatch, name, write, sentence):
    monkeypatch.chdir(tmp_path)
    write(tmp_path / name)
    with pytest.raises(InputError) as refusal:
        read_recording(name)
    assert str(refusal.value).startswith(sentence)
    assert "\n" not in str(refusal.value)


@settings(max_examples=150, deadline=None)
@given(
    edits=st.lists(st.tuples(st.floats(0, 1), st.integers(0, 4), st.binary(max_size=4)), min_size=1, max_size=5),
    drop_bad_rows=st.booleans(),
)
def test_any_text_file_is_read_or_refused(tmp_path_factory, edits, drop_bad_rows):
    content = rows(*(f"{0.1 * i:.1f},0.{3 + i % 2},{i / 4}" for i in range(40))).encode()
    for place, removed, added in edits:
        at = int(place * len(content))
        content = content[:at] + added + content[at + removed :]
    path = tmp_path_factory.mktemp("edited") / "wire.csv"
    path.write_bytes(content)
    try:
        recording = read_recording(path, drop_bad_rows=drop_bad_rows)
    except InputError as refusal:
        assert str(refusal).startswith(f"{path}: ") and "\n" not in str(refusal)
    else:
        assert len(recording) >= 2 and (np.diff(recording.time) > 0).all()
        assert all(np.isfinite(values).all() for values in recording.channels.values())


NEARLY_BAD = {
    "sense current of 1 mA between pulses of 1 A": column("current [A]", [0.001] * 9 + [1.0] * 9 + [0.001] * 9),
    "a load that starts from noise about zero": column(
        "force [N]", [0.01, -0.02, 0.005, 0.01, -0.01, 10, 20, 21, 20, 19]
    ),
    "an idle second wire": "time [s],current_1 [A],current_2 [A]\n0,0.3,0.00001\n1,0.4,-0.00002\n2,0.5,0.00001\n",
    "a wire that is never heated": column("current [A]", [0, 0, 0]),
    "a high-temperature alloy": column("temperature [degC]", [25, 150, 300, 420]),
    "a warm start": column("temperature [degC]", [295, 250, 200, 340]),
    "a quench": column("temperature [degC]", [300, 301, 299, 40, 38, 36]),
    "full duty": column("duty [1]", [0, 1, 0.5]),
    "a stress that passes zero": column("stress [MPa]", [0, 1e-3, 1, 100, 400, 0, -20]),
    "a stroke of nothing and then much": column("displacement [mm]", [0, 0, 0, 0, 0, 9.8, 9.9, 9.8, 9.9, 9.7]),
    "a logger that pauses": "time [s],current [A]\n"
    + "".join(f"{t},0.3\n" for t in [0.1, 0.2, 0.3, 300, 300.1, 300.2, 300.3]),
}


@pytest.mark.parametrize("content", NEARLY_BAD.values(), ids=[name.replace(" ", "_") for name in NEARLY_BAD])
def test_unusual_recordings_are_read(tmp_path, content):
    (tmp_path / "wire.csv").write_text(content)
    assert len(read_recording(tmp_path / "wire.csv")) >= 3
