"""``smajax explain``: texts on words of messages and on effects, and the summaries that name them."""

import inspect
import re

import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.app.commands.explain import explain_text, topics
from smajax.plant.effects import catalogue
from smajax.report import topics as named
from tests.conftest import ROOT


def smajax(*arguments: str):
    """Run a command in this process."""
    return CliRunner().invoke(app, arguments)


@pytest.mark.parametrize("name", [*topics(), *catalogue()])
def test_each_topic_and_effect_has_a_text_that_fits_a_terminal(name):
    text = explain_text(name)
    assert "`" not in text and "](" not in text and len(text) > 200
    assert name in catalogue() or max(map(len, text.splitlines())) <= 100
    page = re.search(r"^More: (docs/\S+\.md)$", text, re.MULTILINE)
    assert page and (ROOT / page[1]).is_file()


def test_the_list_has_all_of_them():
    result = smajax("explain")
    assert result.exit_code == 0
    assert not [name for name in [*topics(), *catalogue()] if name not in result.stdout]


def test_words_may_be_written_as_in_the_message():
    assert smajax("explain", "at", "bound").stdout == smajax("explain", "at-bound").stdout != ""
    assert "half of the play" in smajax("explain", "Backlash").stdout


@pytest.mark.parametrize(
    ("name", "near"),
    [("bakclash", "backlash"), ("lag", "sensor-lag, specimen-lag, thermocouple-lag"), ("bound", "at-bound")],
)
def test_an_unknown_topic_is_one_sentence_with_near_matches(name, near):
    result = smajax("explain", name)
    assert result.exit_code == 2 and result.stdout == ""
    assert result.stderr.count("\n") == 1 and f"near it: {near}" in result.stderr
    assert "near it" not in smajax("explain", "zzzz").stderr


def test_the_summaries_name_topics_that_exist():
    names = re.findall(r'^ +"([a-z-]+)":', inspect.getsource(named), re.MULTILINE)
    assert len(names) > 6 and not set(names) - set(topics())


def test_a_fit_at_a_bound_names_its_topics():
    entry = {"free": True, "at_bound": True, "lower95": None, "upper95": None, "bounds": [0.0, 1.0]}
    document = {"solver": {"code": "steps"}, "parameters": {"heat.h0": entry}, "indistinct": []}
    assert named.fit_topics(document, is_bad=True) == ["at-bound", "not-converged", "noise-floor"]
    assert named.explained(["at-bound"])[1] == "Explained by smajax explain TOPIC: at-bound"
    assert named.explained([]) == []


def test_a_diagnosis_names_its_effects():
    document = {"equivalent": {"backlash": ["slack"]}, "candidates": [], "effects": ["backlash"]}
    assert named.diagnosis_topics(document) == ["verdict", "equivalent", "backlash"]
