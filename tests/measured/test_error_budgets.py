"""Error budgets of recordings by others: their rows, their files and their picture; fits are not tested."""

import dataclasses
import json
import math

from experiments.common.base import Row
from experiments.common.budgets import CELLS, GRAINS, Budget, Entry, with_grains
from experiments.common.charts import draw_bars
from experiments.measured.error_budgets import bars, guarneros_text, read_budgets

import pytest

from smajax.diagnosis.structure import SPREADS
from smajax.files.rig_file import parse_rig, read_rig
from smajax.recordings.datasets import data_path

ENTRIES = (Entry("naive", math.nan, 0.4), Entry("base model", 0.1, 0.2), Entry("with grains", 0.05, 0.1))
BUDGET = Budget("cycles", "strain", "%", ENTRIES, "with grains", target=0.15)


def test_rows_say_the_target_of_the_last_model_and_that_the_noise_is_not_known():
    rows = BUDGET.rows()
    assert [(r.measured, r.target, r.met) for r in rows] == [
        ("- / 0.4 %", "-", None),
        ("0.1 / 0.2 %", "-", None),
        ("0.05 / 0.1 %", "<= 0.15 %", True),
        ("not known", "-", None),
    ]
    missed = dataclasses.replace(BUDGET, target=0.05, noise=0.01).rows()
    assert missed[2].met is False and missed[3].measured == "0.01 %"


def document(budget: Budget, words: str, more: list[Row]) -> dict:
    rows = [dataclasses.asdict(row) for row in (*budget.rows(), *more)]
    return {
        "experiment": "measured/error_budgets",
        "quick": False,
        "words": words,
        "rows": rows,
        "budgets": [dataclasses.asdict(budget)],
        "details": len(more),
    }


def test_files_of_earlier_runs_become_one_table(tmp_path):
    """They stand in the order of the recordings, with all rows, in any order of the files."""
    first, second = dataclasses.replace(BUDGET, recording="loops"), BUDGET
    detail = Row("selected", "-", "backlash", None)
    paths = [tmp_path / "a.json", tmp_path / "b.json"]
    for path, made in zip(
        paths, (document(first, " superelastic", []), document(second, " flexinol", [detail])), strict=True
    ):
        path.write_text(json.dumps(made), "utf-8")
    budgets, details = read_budgets(paths)
    assert [budget.recording for budget in budgets] == ["cycles", "loops"]
    assert budgets[0].entries[1:] == ENTRIES[1:] and details == [detail]


def test_a_file_of_another_experiment_is_refused(tmp_path, capsys):
    path = tmp_path / "other.json"
    path.write_text(json.dumps({"words": "", "rows": []}), "utf-8")
    with pytest.raises(SystemExit):
        read_budgets([path])
    assert "other.json has no budgets: name files that this experiment wrote by --json" in capsys.readouterr().err


def test_the_picture_has_the_errors_over_the_naive_one(tmp_path):
    group = bars(BUDGET)
    assert group.values == pytest.approx([1.0, 0.5, 0.25])
    text = draw_bars([group, group], tmp_path, "budgets", "held-out error").read_text("utf-8")
    for word in ("cycles: strain", "base model", "held-out error", "0.25"):
        assert word in text


def test_rigs_have_cells_and_grains_where_they_are_asked_for():
    for cells, grains in ((False, False), (True, False), (False, True), (True, True)):
        rig = parse_rig(guarneros_text(cells, grains))
        assert (rig.plant.cells.count if rig.plant.cells else 1) == (CELLS if cells else 1)
        assert (rig.plant.grains.count if rig.plant.grains else 1) == (GRAINS if grains else 1)
        assert set(SPREADS) <= set(rig.fit.free) or not grains
    rig = with_grains(read_rig(data_path("recordings", "isobaric") / "rig.toml"))
    assert rig.plant.cells is None and rig.plant.grains is not None and rig.fit.free[-2:] == SPREADS
