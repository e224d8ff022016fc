"""Writing of TOML files: values are unchanged when read again, floats to the last bit, and the layout is readable."""

import math
import struct
import time

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from smajax.errors import InputError
from smajax.files.parameter_sets import Entry, read_header, read_parameters, write_parameters
from smajax.files.templates import write_example
from smajax.files.toml import parse_toml, render_toml

# Seconds of processor time in which a text is read or refused.
AT_ONCE = 5.0
# Surrogates are not text in UTF-8.
TEXTS = st.text(st.characters(exclude_categories=["Cs"]), max_size=30)
KEYS = st.one_of(TEXTS, st.sampled_from(["heat.h0", "heat.h0@my run.csv", "", "a b", '"', "\\", "é", "1", "[x]", "#"]))
VALUES = st.one_of(
    TEXTS,
    st.sampled_from(['"', '"""', "'''", "\\", "\\u0041", "# no comment", "a\r\nb", "\x00\x1f\x7f", "\u2028", "true"]),
    st.floats(),
    st.integers(-(2**63), 2**63 - 1),
    st.booleans(),
    st.lists(st.one_of(TEXTS, st.floats(), st.integers(-(2**63), 2**63 - 1), st.booleans()), max_size=4),
    st.lists(st.lists(st.floats(), max_size=3), max_size=3),
)
TABLES = st.recursive(
    st.dictionaries(KEYS, VALUES, max_size=5), lambda inner: st.dictionaries(KEYS, st.one_of(VALUES, inner), max_size=4)
)


def bits(value):
    """Return a value with its floats as bytes, so that NaN equals itself and 0.0 is not -0.0."""
    if isinstance(value, dict):
        return {key: bits(item) for key, item in value.items()}
    if isinstance(value, list):
        return [bits(item) for item in value]
    if isinstance(value, float):
        return "nan" if math.isnan(value) else struct.pack("d", value)
    return (type(value), value)


@settings(max_examples=300, deadline=None)
@given(TABLES)
def test_tables_round_trip(table):
    assert bits(parse_toml(render_toml(table), "a.toml")) == bits(table)


def test_absent_values_are_omitted_and_numbers_of_numpy_are_written():
    table = {"x": None, "y": np.float64(0.1) + 0.2, "fit": {"bounds": None, "seed": 3, "free": ("a", "b")}, "empty": {}}
    assert render_toml(table) == 'y = 0.30000000000000004\n\n[fit]\nseed = 3\nfree = ["a", "b"]\n\n[empty]\n'


def test_the_layout_is_that_of_a_hand_written_file():
    table = {
        "schema": 1,
        "effects": {"latent-heat": {"strength": "80 MJ/m^3"}},
        "fit": {"observe": ["displacement"], "bounds": {"heat.h0": ["1 W/m^2/K", "2 W/m^2/K"]}},
    }
    assert render_toml(table) == (
        'schema = 1\n\n[effects.latent-heat]\nstrength = "80 MJ/m^3"\n\n[fit]\nobserve = ["displacement"]\n\n'
        '[fit.bounds]\n"heat.h0" = ["1 W/m^2/K", "2 W/m^2/K"]\n'
    )


@settings(max_examples=60, deadline=None)
@given(
    value=st.floats(0.0, 1e4),
    source=TEXTS.filter(bool),
    recording=st.text(st.characters(exclude_categories=["Cs"]), min_size=1, max_size=20),
)
def test_parameter_sets_round_trip(tmp_path_factory, value, source, recording):
    path = tmp_path_factory.mktemp("sets") / "fit.toml"
    name = f"load.mass@{recording}"
    entries = {name: Entry(value, "kg", source=source, free=True, at_bound=False)}
    write_parameters(path, entries, {"title": source, "fit": {"recordings": [recording]}})
    assert read_parameters(path) == entries
    assert read_header(path) == {"title": source, "fit": {"recordings": [recording]}}


@pytest.mark.parametrize("kind", ["dead-weight", "antagonistic-rotary"])
def test_comments_of_a_template_stay_in_their_column(tmp_path, kind):
    rig = write_example(kind, tmp_path)[0].read_text("utf-8")
    lines = [line for line in rig.splitlines() if line.startswith(("kind", "control", "interpolation"))]
    assert len(lines) == 3 and len({line.index("#") for line in lines}) == 1
    assert parse_toml(rig, "rig.toml")["rig"]["control"] == "current"


@pytest.mark.parametrize(
    "key", ["a" + ".a" * 50_000 + " = 1", "[" + " . ".join(["'a'"] * 50_000) + "]", "x = {" + "a." * 9000 + "a = 1}"]
)
def test_a_key_of_many_parts_is_refused_at_once(key):
    begin = time.process_time()
    with pytest.raises(InputError, match="row 2: a key has more than 64 parts"):
        parse_toml(f"schema = 1\n{key}\n", "a.toml")
    assert time.process_time() - begin < AT_ONCE


@pytest.mark.parametrize("text", ["'" + "." * 900 + "'", "'" + "a.b " * 900 + "'", f"1 # {'.' * 900}"])
def test_texts_and_comments_may_have_many_dots(text):
    assert "note" in parse_toml(f"note = {text}\n", "a.toml")


def test_a_long_text_without_dots_takes_no_time():
    begin = time.process_time()
    assert parse_toml(f"note = '{'a' * 900_000}'\n", "a.toml")
    assert time.process_time() - begin < AT_ONCE
