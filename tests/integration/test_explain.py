"""``smajax explain``: texts on words of messages and on effects, and the summaries that name them."""

import inspect
import re
import tomllib
from typing import get_args

import pytest
from typer.testing import CliRunner

from smajax.app.cli import app
from smajax.app.commands.explain import explain_text
from smajax.errors import InputError
from smajax.files.parameter_sets import find_set
from smajax.files.rig_file import read_rig
from smajax.plant.effects import catalogue
from smajax.report import diagnosis_page, pages
from smajax.report import topics as named
from smajax.report.documents.diagnosis import DiagnosisDocument
from tests.conftest import ROOT


def smajax(*arguments: str):
    """Run a command in this process."""
    return CliRunner().invoke(app, arguments)


@pytest.mark.parametrize("name", [*named.read_topics(), *catalogue()])
def test_each_topic_and_effect_has_a_text_that_fits_a_terminal(name):
    text = explain_text(name)
    assert "`" not in text and "](" not in text and len(text) > 200
    assert name in catalogue() or max(map(len, text.splitlines())) <= 100
    page = re.search(r"^More: (docs/\S+\.md)$", text, re.MULTILINE)
    assert page and (ROOT / page[1]).is_file()


def test_the_list_has_all_of_them():
    result = smajax("explain")
    assert result.exit_code == 0
    assert not [name for name in [*named.read_topics(), *catalogue()] if name not in result.stdout]


def test_words_may_be_written_as_in_the_message():
    assert smajax("explain", "at", "bound").stdout == smajax("explain", "at-bound").stdout != ""
    assert "half of the play" in smajax("explain", "Backlash").stdout


def test_words_that_a_topic_explains_are_found():
    topics = named.read_topics()
    words = [word for topic in topics.values() for word in topic.words]
    assert len(words) == len(set(words)) and not set(words) & {*topics, *catalogue()}
    for verdict in get_args(DiagnosisDocument.model_fields["verdict"].annotation):
        text = explain_text(verdict)
        assert text == explain_text("verdict") and f"- {verdict}: " in text
    assert explain_text("at its bound") == explain_text("at-bound")
    assert "Words:" not in "".join(topic.text for topic in topics.values())


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
    assert len(names) > 6 and not set(names) - set(named.read_topics())


def test_a_fit_at_a_bound_names_its_topics():
    entry = {"free": True, "at_bound": True, "lower95": None, "upper95": None, "bounds": [0.0, 1.0]}
    document = {"solver": {"code": "steps"}, "parameters": {"heat.h0": entry}, "indistinct": []}
    assert named.fit_topics(document, is_bad=True) == ["at-bound", "not-converged", "noise-floor"]
    assert named.explained(["at-bound"])[1] == "Explained by smajax explain TOPIC: at-bound"
    assert named.explained([]) == []


def test_a_diagnosis_names_its_effects():
    document = {"equivalent": {"backlash": ["slack"]}, "candidates": [], "effects": ["backlash"]}
    assert named.diagnosis_topics(document) == ["verdict", "equivalent", "backlash"]
    partial = named.diagnosis_topics(document | {"verdict": "partial"})
    assert partial == ["verdict", "equivalent", "free-parameters", "backlash"]


def test_messages_name_topics_that_exist():
    """A topic that is not named by a summary is named by an error, a finding or a command."""
    texts = [path.read_text("utf-8") for path in (ROOT / "smajax").rglob("*.py")]
    written = {name for text in texts for name in re.findall(r"smajax explain ([a-z]+(?:-[a-z]+)*)", text)}
    assert {"three-recordings", "effects", "parameter-sets"} <= written
    assert not written - set(named.read_topics()) - {"backlash"}
    summaries = set(re.findall(r'"([a-z-]+)"', inspect.getsource(named) + inspect.getsource(diagnosis_page)))
    assert not set(named.read_topics()) - written - summaries


def test_errors_name_their_topics():
    with pytest.raises(InputError, match=r"\(smajax explain parameter-sets\)"):
        find_set("flexinoll")
    rig = tomllib.loads((ROOT / "data" / "recordings" / "dead-weight" / "rig.toml").read_text("utf-8"))
    for effects in ({"backlsh": {"strength": "1 mm"}}, "backlash"):
        with pytest.raises(InputError, match=r"\(smajax explain effects\)"):
            read_rig(rig | {"effects": effects})


def test_the_summaries_of_other_studies_name_their_topics():
    models = [{"at_bound": ["delay"], "undetermined": []}, {"undetermined": ["h"]}]
    assert named.comparison_topics({"models": models}) == ["at-bound", "not-determined"]
    assert named.comparison_topics({"models": [{}]}) == []
    assert named.tuning_topics({"problems": []}) == ["margins"]
    assert named.tuning_topics({"problems": ["overshoot is 4 %"]}) == ["margins", "limits"]
    assert named.sweep_topics({"problems": [], "constraints": {}}) == []
    assert named.sweep_topics({"problems": [], "constraints": {"stroke": {}}}) == ["feasible"]
    bench = [{"code": "sign"}, {"code": "clock"}]
    document = {"solver": {"code": "converged"}, "parameters": {}, "indistinct": [], "bench": bench}
    assert named.fit_topics(document | {"input_noise": [{"kind": "meter"}]}, False) == ["input-noise", "displacement"]


def test_a_page_has_the_texts_of_its_topics():
    section = pages.topics_section(["at-bound", "backlash"])
    assert section.count("<details>") == 1 and "At its bound (smajax explain at-bound)" in section
    assert "widen it" in section and "http" not in section
    assert pages.topics_section(["backlash"]) == ""
