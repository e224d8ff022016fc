"""Recorded results of experiments, and the pages and texts that take their numbers from them."""

import argparse
import datetime
import json
import re
import sys

from experiments.common import base, results

import pytest

from docs.generate import experiment_list
from docs.generate import results as pages
from tests.conftest import ROOT

NAMES = sorted(pages.results())
PAGES = sorted((ROOT / "docs").rglob("*.md"))
LARGEST_FILE = 50_000  # bytes
# Rows of the README's table, by a part of their first cell, and the rows of results that they are taken from.
README_ROWS = {
    "fit of six parameters": [
        (
            "speed-gradient_vs_population-quick",
            "gradient, 4 starts against SciPy DE, to within 1 % of the best RMSE",
        )
    ],
    "95 % intervals": [("fitting-interval_coverage", "all parameters"), ("fitting-interval_coverage", "heat.h0")],
    "hidden effect": [("diagnosis-hidden_effects", "one effect: exactly and first")],
    "false alarms": [("diagnosis-hidden_effects", "nothing hidden: an effect named")],
    "isobaric cycles": [
        ("measured-isobaric", "150 MPa held out: RMSE train / held out"),
        ("measured-isobaric", "150 MPa held out, with gradual-transformation: RMSE train / held out"),
    ],
    "two wires on a pulley": [
        ("speed-sweep_throughput", "throughput against a compiled loop at least as exact, the same cores"),
        ("speed-sweep_throughput", "designs simulated, ten seconds of motion each"),
    ],
}


@pytest.mark.parametrize("name", NAMES)
def test_each_result_says_how_it_was_made(name):
    document = pages.result(name)
    assert tuple(document) == results.KEYS and results.result_name(document) == name
    assert (ROOT / "experiments" / f"{document['experiment']}.py").is_file()
    assert document["command"].startswith(f"python experiments/{document['experiment']}.py{document['words']}")
    assert document["date"] is None or datetime.date.fromisoformat(document["date"])
    assert {"processor", "cores", "accelerator"} == set(document["machine"])
    assert {"smajax", "python", "jax", "numpy", "scipy"} <= set(document["versions"])
    assert (pages.RESULTS / f"{name}.json").stat().st_size < LARGEST_FILE


def test_each_result_is_on_one_page():
    markers = [name for page in PAGES for name in pages.RUN.findall(page.read_text("utf-8"))]
    assert sorted(markers) == NAMES


def test_numbers_of_pages_are_in_the_results():
    texts = {page: page.read_text("utf-8") for page in PAGES}
    assert sum(len(pages.NUMBER.findall(text)) for text in texts.values()) > 10
    for text in texts.values():
        assert not re.search(r"\{\{ \w", pages.insert_results(text))


def test_each_theme_says_what_was_asked_came_out_and_was_missed():
    for page in (ROOT / "docs" / "benchmarks").glob("*.md"):
        if page.stem != "index":
            words = ["**Asked.**", "<!-- results: asked -->", "**Came out.**", "<!-- results: missed -->", "\n## "]
            places = [page.read_text("utf-8").index(word) for word in words]
            assert places == sorted(places)


def test_the_numbers_of_the_readme_are_those_of_the_results():
    table = (ROOT / "README.md").read_text("utf-8").partition("| what | result | page |")[2].partition("\n\n")[0]
    rows = [line.strip("|").split("|") for line in table.splitlines()[2:]]
    assert len(rows) == len(README_ROWS)
    for what, shown, _ in rows:
        sources = next(value for key, value in README_ROWS.items() if key in what)
        known = {figure for name, row in sources for figure in pages.FIGURE.findall(pages.measured(name, row))}
        figures = pages.FIGURE.findall(shown)
        assert figures and not set(figures) - known


def test_the_list_of_experiments_is_that_of_the_results():
    assert (ROOT / "experiments" / "README.md").read_text("utf-8") == experiment_list.readme()


def test_a_number_that_is_not_there_is_refused():
    name = "fitting-interval_coverage"
    assert pages.measured(name, "all parameters", "1") == "92.8"
    assert pages.insert_results(f"{{{{ {name} | all parameters | 1 }}}} %") == "92.8 %"
    for bad in ((name, "no such row"), (name, "all parameters", "2"), ("no-such-run", "all parameters")):
        with pytest.raises(pages.ResultError):
            pages.measured(*bad)


def test_a_page_shows_targets_and_leaves_estimates_out(monkeypatch):
    rows = [base.Row("error", "<= 1 %", "2 %", False), base.Row("heat.h0", "-", "100 W/m^2/K (99 .. 101)", None)]
    rows += [base.Row(f"detail {k}", "-", "1", None) for k in range(pages.SHOWN_ROWS + 1)]
    document = pages.result(NAMES[0]) | {"rows": [vars(row) for row in rows]}
    monkeypatch.setattr(pages, "results", lambda: {"run": document})
    text = pages.insert_results("<!-- result of: run -->\n\n<!-- results: missed -->\n")
    assert "| error | <= 1 % | 2 % | no |" in text and "heat.h0" not in text
    assert '??? note "9 rows without a target"' in text and "    | detail 0 |" in text
    assert "[error](#run-run): 2 %; the target is <= 1 %." in text


def test_a_run_is_recorded_with_its_circumstances(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(results, "RESULTS", tmp_path / "results")
    monkeypatch.setattr(sys, "argv", [str(results.EXPERIMENTS / "docs" / "held_out.py")])
    args = argparse.Namespace(quick=True, json=tmp_path / "all.json", record=True)
    base.finish([base.Row("error", "-", "1", None, {"error": 1.0})], args, words=" --seeds 1", cases=[1, 2])
    recorded = json.loads((tmp_path / "results" / "docs-held_out-seeds-1-quick.json").read_text("utf-8"))
    assert recorded["command"] == "python experiments/docs/held_out.py --seeds 1 --quick"
    assert recorded["seconds"] > 0 and recorded["rows"][0]["numbers"] == {"error": 1.0} and "cases" not in recorded
    assert recorded["versions"]["jax"] and recorded["machine"]["processor"] and recorded["date"]
    assert json.loads(args.json.read_text("utf-8"))["cases"] == [1, 2]
    assert "| error |" in capsys.readouterr().out
