"""Quantities as text and columns with units, against values known by hand and round trips that lose nothing."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st

import smajax
from docs.generate import unit_table
from smajax.channels import CHANNELS, channel_of
from smajax.errors import InputError
from smajax.unit_parser import parse_unit, unit_of_pint
from smajax.units import format_quantity, from_si, parse_quantity, to_si

ROOT = Path(__file__).parents[2]

QUANTITIES = [
    ("0.15 mm", "m", 0.00015),
    ("0.15mm", "m", 0.00015),
    ("4.1 %", "1", 0.041),
    ("80 uohm cm", "ohm m", 8e-7),
    ("80 µΩ cm", "ohm m", 8e-7),
    ("6.73 MPa/K", "Pa/K", 6.73e6),
    ("6.73 MPa/degC", "Pa/K", 6.73e6),
    ("10e-6 1/K", "1/K", 1e-5),
    ("100.6 W/m^2/K", "W/m^2/K", 100.6),
    ("100.6 W/(m^2 K)", "W/m^2/K", 100.6),
    ("100.6 W·m⁻²·K⁻¹", "W/m^2/K", 100.6),
    ("0.001 W/m^2/K^3", "W/m^2/K^3", 0.001),
    ("2.046 MJ/m^3/K", "J/m^3/K", 2.046e6),
    ("2.046 MJ/m**3/K", "J/m^3/K", 2.046e6),
    ("0 kg m^2", "kg m^2", 0.0),
    ("0.2 kg", "kg", 0.2),
    ("9.81 N", "N", 9.81),
    ("5 A", "A", 5.0),
    ("-.5e1 mm", "m", -0.005),
    ("\N{MINUS SIGN}3 mm", "m", -0.003),
    ("1", "1", 1.0),
    (0.041, "1", 0.041),
    (2, "1", 2.0),
    ("50 ppm", "1", 5e-5),
    ("20 degC", "degC", 20.0),
    ("20 °C", "degC", 20.0),
    ("20 deg C", "degC", 20.0),
    ("293.15 K", "degC", 20.0),
    ("68 degF", "degC", 20.0),
    ("5 degC", "K", 5.0),
    ("9 degF", "K", 5.0),
    ("180 deg", "rad", np.pi),
    ("1 N m/deg", "N m/rad", 180 / np.pi),
    ("3 N m", "N m/rad", 3.0),
    ("20 mNm", "N m", 0.02),
    ("20 mm²", "m^2", 2e-5),
    ("1000 psi", "Pa", 1000 * 0.45359237 * 9.80665 / 0.0254**2),
    ("5 %/s", "1/s", 0.05),
]


@pytest.mark.parametrize(("text", "canonical", "value"), QUANTITIES)
def test_a_quantity_is_the_nearest_float(text, canonical, value):
    assert parse_quantity(text, canonical) == pytest.approx(value, rel=2e-16, abs=0)


REFUSED = [
    ("0.15", "m", "'0.15' has no unit, and m is expected: write it like '0.15 mm'"),
    (0.15, "m", "'0.15' has no unit, and m is expected: write it like '0.15 mm'"),
    ("0.15 kg", "m", "'0.15 kg': the unit 'kg' does not fit: a unit that converts to m is expected, as in '0.15 mm'"),
    ("0.15 mmm", "m", "the unit 'mmm' is not known (did you mean 'mm'?)"),
    ("3 milimeter", "m", "the unit 'milimeter' is not known (did you mean 'millimeter'?)"),
    ("3 Amp", "A", "the unit 'Amp' is not known (did you mean 'A'?)"),
    (
        "5 C",
        "degC",
        "the unit 'C' does not fit (did you mean 'degC'?): a unit that converts to degC is expected, as in '20 degC'",
    ),
    ("5 rad", "1", "the unit 'rad' does not fit: a fraction or '%' is expected, as in '4.1 %'"),
    ("5 %", "rad", "the unit '%' does not fit: a unit that converts to rad is expected, as in '20 deg'"),
    ("3 dB", "1", "the unit 'dB' is not known"),
    ("0,15 mm", "m", "'0,15 mm' has a decimal comma: write it like '0.15 mm', with a point"),
    ("mm", "m", "'mm' does not begin with a number: write it like '0.15 mm'"),
    ("", "m", "'' does not begin with a number"),
    ("nan m", "m", "'nan m' does not begin with a number"),
    (float("nan"), "1", "'nan' does not begin with a number"),
    (True, "1", "True is not a quantity: write it like '4.1 %'"),
    (None, "kg", "None is not a quantity: write it like '0.2 kg'"),
    ("1 2 mm", "m", "'1 2 mm' is not one number with one unit"),
    ("1e999 m", "m", "'1e999 m' is too large for a number"),
    ("9**9**9**9", "m", "the unit '**9**9**9' is incomplete"),
    ("9**9**9**9", "1", "the unit '**9**9**9' is incomplete"),
    ("5 m^99", "m", "the unit 'm^99' is not understood at '9'"),
    ("5 mm2", "m^2", "the unit 'mm2' is not understood at '2': write it like 'mm', 'N m' or 'W/m^2/K'"),
    ("5 (mm", "m", "the unit '(mm' has a bracket that is never closed"),
    ("5 mm)", "m", "the unit 'mm)' has a bracket that was never opened"),
    ("5 m//s", "m", "the unit 'm//s' is incomplete"),
    ("5 m/", "m", "the unit 'm/' is incomplete"),
    ("5 __import__('os')", "m", "is not understood at"),
    ("5 " + "m" * 5000, "m", "a quantity of 5002 characters ('5 mmmmmmmmmm...') is too long"),
]


@pytest.mark.parametrize(("text", "canonical", "sentence"), REFUSED)
def test_what_is_no_quantity_is_refused_with_the_cure(text, canonical, sentence):
    with pytest.raises(InputError) as refusal:
        parse_quantity(text, canonical)
    assert sentence in str(refusal.value)
    assert "\n" not in str(refusal.value)


@settings(max_examples=150, deadline=None)
@given(st.text(alphabet=st.sampled_from("0123456789.eE+-*/^() mkMNAKPadeg°%µ_'\"[]{},;:\\\n"), max_size=80))
def test_any_text_is_a_number_or_refused(text):
    try:
        assert np.isfinite(parse_quantity(text, "m"))
    except InputError as refusal:
        assert str(refusal)


UNITS = [
    ("mm", "m"),
    ("um", "m"),
    ("degC", "degC"),
    ("K", "degC"),
    ("degF", "degC"),
    ("deg", "rad"),
    ("%", "1"),
    ("MPa", "Pa"),
]
UNITS += [
    ("psi", "Pa"),
    ("uohm cm", "ohm m"),
    ("W/m^2/K", "W/m^2/K"),
    ("1", "1"),
    ("min", "s"),
    ("MJ/m^3/K", "J/m^3/K"),
]
FLOATS = st.floats(allow_nan=False, allow_infinity=False, min_value=-1e250, max_value=1e250)


@settings(max_examples=300, deadline=None)
@given(value=FLOATS, unit=st.sampled_from(UNITS))
def test_formatted_quantities_parse_back_to_the_same_float(value, unit):
    assume(unit[0] not in ("K", "degF") or value == 0 or abs(value) > 1e-15)
    text = format_quantity(value, *unit)
    assert parse_quantity(text, unit[1]) == value, text


@pytest.mark.parametrize(
    ("value", "unit", "text"),
    [
        (0.00015, "mm", "0.15 mm"),
        (-0.003, "mm", "-3 mm"),
        (0.0, "mm", "0 mm"),
        (0.041, "%", "4.1 %"),
        (0.041, "1", "0.041"),
        (20.0, "degC", "20 degC"),
        (20.0, "degF", "68 degF"),
        (5.0, "K", "5 K"),
        (8e-7, "uohm cm", "80 uohm cm"),
        (1e-5, "1/K", "0.00001 1/K"),
        (1e-6, "kg m^2", "1e-6 kg m^2"),
        (2.5e9, "Pa", "2.5e9 Pa"),
    ],
)
def test_formatted_quantities_are_as_short_as_can_be(value, unit, text):
    assert format_quantity(value, unit) == text


@settings(max_examples=200, deadline=None)
@given(values=st.lists(st.floats(-1e6, 1e6), min_size=1, max_size=20), unit=st.sampled_from(UNITS))
def test_a_column_survives_the_way_to_si_and_back(values, unit):
    # The float in the file may differ by rounding (20.000000000000004 degF is 20 degF in degC), the one inside may not.
    inside = to_si(np.array(values), *unit)
    in_file = from_si(inside, *unit)
    np.testing.assert_array_equal(to_si(in_file, *unit), inside)
    np.testing.assert_allclose(in_file, values, rtol=1e-12, atol=1e-9)


@settings(max_examples=100, deadline=None)
@given(value=st.floats(-1e6, 1e6), unit=st.sampled_from(UNITS))
def test_scaling_is_the_same_for_texts_floats_and_arrays(value, unit):
    inside = to_si(value, *unit)
    assert isinstance(inside, float)
    assert to_si(np.array([[value]]), *unit)[0, 0] == inside
    assert parse_quantity(f"{value!r} {unit[0]}", unit[1]) == pytest.approx(inside, rel=1e-15, abs=1e-12)


def test_from_si_keeps_the_kind_of_what_it_is_given():
    assert from_si(0.00015, "mm", "m") == 0.15
    assert isinstance(from_si(0.00015, "mm", "m"), float)
    assert from_si(np.ones((2, 3)), "mm", "m").shape == (2, 3)
    assert from_si(np.ones(0), "mm", "m").shape == (0,)
    given_array = np.array([1.0, 2.0])
    from_si(given_array, "m", "m")[0] = 7.0
    assert given_array[0] == 1.0


def test_channels_are_known_with_and_without_a_number():
    assert channel_of("current") == channel_of("current_2") == channel_of("current_12") == "current"
    for other in (
        "Current",
        "current_",
        "current_0",
        "current_02",
        "current2",
        "speed",
        "current_2_1",
        "current_٢",
        "",
    ):
        assert channel_of(other) is None
    expected = {
        "time": "s",
        "current": "A",
        "voltage": "V",
        "power": "W",
        "duty": "1",
        "temperature": "degC",
        "ambient": "degC",
        "fan": "1",
    }
    expected |= {
        "displacement": "m",
        "angle": "rad",
        "force": "N",
        "torque": "N m",
        "stress": "Pa",
        "strain": "1",
        "resistance": "ohm",
        "rate": "rad/s",
    }
    assert {name: channel.unit for name, channel in CHANNELS.items()} == expected
    for channel in CHANNELS.values():
        assert all(np.isfinite(to_si(1.0, unit, channel.unit)) for unit in channel.units)


def test_pint_is_loaded_at_the_first_rare_unit_only():
    quantities = [("0.15 mm", "m"), ("100.6 W/m^2/K", "W/m^2/K"), ("20 °C", "degC"), ("1 furlong", "m")]
    code = f"""
import sys
from smajax.units import parse_quantity
for text, unit in {quantities!r}:
    parse_quantity(text, unit)
    print('pint' in sys.modules)
"""
    result = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert result.stdout.split() == ["False", "False", "False", "True"]


@pytest.mark.parametrize(
    ("unit", "canonical", "suggested"),
    [
        ("g", "N", "gf"),
        ("kg", "N", "kgf"),
        ("kg/mm^2", "Pa", "kgf/mm^2"),
        ("g cm", "N m", "gf cm"),
        ("gf", "kg", "g"),
        ("mm", "N", None),
        ("g", "m", None),
    ],
)
def test_a_mass_in_place_of_a_weight_is_suggested(unit, canonical, suggested):
    with pytest.raises(InputError) as raised:
        to_si(1.0, unit, canonical)
    assert "does not fit" in str(raised.value)
    assert (
        (f"(did you mean '{suggested}'?)" in str(raised.value))
        if suggested
        else "did you mean" not in str(raised.value)
    )


def test_frequent_units_are_those_of_pint():
    shipped = Path(smajax.__file__).with_name("common_units.json").read_text("utf-8")
    assert shipped == unit_table.text(), "run python -m docs.generate.unit_table"
    for name in json.loads(shipped):
        assert parse_unit(name) == unit_of_pint(name)
    assert parse_quantity("8 Mohm", "ohm") == 8e6 and parse_quantity("8 Volt", "V") == 8.0
