"""Errors with a cure that a front end replaces, and parts of sentences."""

import pytest

from smajax.errors import DerivativeError, InputError, first_line, shortened


@pytest.mark.parametrize("kind", [InputError, DerivativeError])
def test_the_cure_of_a_sentence_is_replaced(kind):
    error = kind("run.csv: correct it: correct it, now", code="bad-row", cure="correct it", row=7)
    other = error.with_cure("remove it")
    assert type(other) is kind and str(other) == "run.csv: correct it: remove it, now"
    assert (other.code, other.fields) == ("bad-row", {"cure": "remove it", "row": 7})
    assert str(other.with_cure("")) == "run.csv: correct it: , now"


@pytest.mark.parametrize("fields", [{}, {"cure": ""}, {"cure": "sort the rows"}])
def test_a_sentence_without_a_cure_stays(fields):
    error = InputError("run.csv: row 7 is bad", **fields)
    assert error.with_cure("remove it") is error


def test_parts_of_a_sentence_are_shortened():
    assert shortened("x" * 30) == "x" * 30 and shortened("x" * 31) == "x" * 27 + "..."
    assert shortened("abcdef", 5) == "ab..."
    assert first_line(ValueError("one\ntwo")) == "one" and first_line(OSError()) == "OSError"
    assert len(first_line(ValueError("x" * 500))) == 120
