"""The report: sentences, table, figures, and a page that runs only its own scripts and loads nothing."""

import base64
import copy
import json
from html.parser import HTMLParser
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go
import pytest

from smajax.errors import InputError
from smajax.report import pages, prediction, summary
from smajax.report.documents import FitDocument
from smajax.report.figures import MAX_POINTS, MAX_POINTS_OF_MANY, single_precision, thin_rows, time_title
from smajax.report.parameter_figures import correlation_picture, profile_picture
from smajax.report.phase_figures import phase_picture
from smajax.report.prediction import make_series
from smajax.report.run_pages import fit_page, simulation_page
from smajax.report.time_figures import comparison_picture, time_picture


def parameter(estimate: float | None, low: float | None, high: float | None, unit: str, **more: Any) -> dict:
    return {
        "estimate": estimate,
        "lower95": low,
        "upper95": high,
        "unit": unit,
        "free": True,
        "at_bound": False,
        "bounds": [None, None],
    } | more


DOCUMENT: dict[str, Any] = {
    "schema": "smajax.fit/2",
    "rig": "rig.toml",
    "model": "brinson",
    "kind": "dead-weight",
    "inputs": ["current"],
    "observed": ["displacement"],
    "parameters": {
        "heat.h0": parameter(103.2412, 101.9, 104.5, "W/m^2/K"),
        "heat.capacity": parameter(2.04612e6, 2.0445e6, 2.0477e6, "J/m^3/K"),
    },
    "fixed": {"wire.diameter": {"value": 1.5e-4, "unit": "m", "source": "rig.toml line 31"}},
    "rmse": {"displacement": {"train": 0.02, "holdout": 0.0203, "unit": "mm"}},
    "noise_floor": {"displacement": {"value": 0.0199, "unit": "mm", "from": "residual differences"}},
    "indistinct": [{"parameters": ["heat.h0", "heat.capacity"], "direction": [0.92, -0.39], "shrink": 0.004}],
    "correlations": {"parameters": ["heat.h0", "heat.capacity"], "matrix": [[1.0, None], [None, 1.0]]},
    "discretisation": {"displacement": {"value": 1e-4, "unit": "mm"}},
    "profiles": {
        "heat.h0": {"values": [101.0, 103.2, 105.0], "rise": [9.1, 0.0, None], "lower95": 101.9, "upper95": None}
    },
    "solver": {
        "code": "converged",
        "text": "the cost falls by less than its tolerance",
        "steps": 14,
        "simulations": 112,
        "wall_s": 1.9,
        "compile_s": 0.9,
        "starts": 4,
        "starts_at_best": 4,
    },
    "recordings": [
        {"name": "train.csv", "sha256": "ab" * 32, "rows": 6000, "role": "train", "notes": []},
        {
            "name": "holdout.csv",
            "sha256": "cd" * 32,
            "rows": 4000,
            "role": "holdout",
            "notes": ["2 of 4002 rows dropped on request"],
        },
    ],
    "warnings": [],
    "seed": 0,
    "smajax": "0.1.0",
}
RUN: dict[str, Any] = {
    "command": "fit",
    "argv": ["smajax", "fit", "rig.toml", "train.csv"],
    "rig": "rig.toml",
    "started": "2026-01-01T00:00:00+00:00",
    "versions": {"smajax": "0.1.0"},
    "machine": "a bench computer",
    "timings": {"fit": 1.9},
    "code": "done",
    "text": "done",
    "inputs": ["current"],
    "observed": ["displacement"],
    "recordings": DOCUMENT["recordings"][:1],
}


def changed(**values: Any) -> dict:
    """Return the document with other values at ``a__b`` paths."""
    document = copy.deepcopy(DOCUMENT)
    for path, value in values.items():
        *above, last = path.split("__")
        place = document
        for key in above:
            place = place[key]
        place[last] = value
    return document


def series(rows: int = 200, name: str = "train.csv", role: str = "train", **more: np.ndarray):
    time = np.arange(rows) * 0.02
    measured = {"current": np.round(np.sin(time), 3), "displacement": 1e-3 * np.cos(time)} | more
    model = {"displacement": 1e-3 * np.cos(time) + 1e-6, "temperature": 20 + 60 * np.sin(time) ** 2}
    return make_series(
        name, role, time, measured, model, {"time": "s", "current": "mA", "displacement": "mm"}, has_clock=True
    )


class Page(HTMLParser):
    """Elements, scripts and text of a page as a browser parses them."""

    def __init__(self, text: str):
        super().__init__()
        self.elements: list[tuple[str, dict[str, str | None]]] = []
        self.scripts: list[str] = []
        self.text = ""
        self.feed(text)
        self.close()

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.elements.append((tag, dict(attrs)))
        if tag == "script":
            self.scripts.append("")

    def handle_data(self, data: str) -> None:
        if self.elements and self.elements[-1][0] == "script" and self.cdata_elem == "script":
            self.scripts[-1] += data
        else:
            self.text += data


def drawn(picture: Any) -> Any:
    """Return data and layout of a figure as plotly.js draws them, with numbers in place of encoded bytes."""
    content = picture.figure.to_plotly_json()
    for trace in content["data"]:
        for axis in {"x", "y"} & trace.keys():
            if isinstance(trace[axis], dict):
                single = np.frombuffer(base64.b64decode(trace[axis]["bdata"]), trace[axis]["dtype"])
                trace[axis] = single.tolist()
    return content


def page_of(document: dict, recordings: list, rig: str = "[rig]") -> Page:
    return Page(fit_page(document, recordings, RUN, rig))


def figures_of(page: Page) -> list[dict]:
    return json.loads(page.scripts[0])


def test_the_page_loads_nothing():
    text = fit_page(DOCUMENT, [series(), series(name="holdout.csv", role="holdout")], RUN, "[rig]")
    page = Page(text)
    assert text.count("plotly.js v") == 1
    assert len(page.scripts) == 3
    assert not [tag for tag, _ in page.elements if tag in ("link", "img", "iframe", "object", "embed")]
    assert not [a for _, a in page.elements if a.get("src") or a.get("href")]
    policy = next(
        a["content"] for tag, a in page.elements if tag == "meta" and a.get("http-equiv") == "Content-Security-Policy"
    )
    assert policy and "default-src 'none'" in policy
    assert "http" not in policy
    places = [a["id"] for tag, a in page.elements if tag == "div" and (a.get("id") or "").startswith("picture-")]
    assert places == [f"picture-{k}" for k in range(len(figures_of(page)))]
    assert len(places) == 6  # two recordings, each over time and as a loop; one profile; the correlations
    for words in (
        "heat.h0",
        "104.5",
        "0.0203 mm",
        "wire.diameter",
        "0.15",
        "abab",
        "a bench computer",
        "2 of 4002 rows",
        "Hard to distinguish",
    ):
        assert words in page.text


HOSTILE = "</script><script>alert(1)</script><img src=x onerror=alert(2)>&lt;b&gt;'\"<!--"


def test_text_from_files_is_escaped():
    document = changed(rig=HOSTILE, warnings=[HOSTILE], model=HOSTILE)
    document["parameters"][f"heat.h0@{HOSTILE}"] = parameter(1.0, 0.9, 1.1, "W/m^2/K")
    document["correlations"]["parameters"] = ["heat.h0", f"heat.h0@{HOSTILE}"]
    document["profiles"] = {f"heat.h0@{HOSTILE}": DOCUMENT["profiles"]["heat.h0"]}
    document["recordings"] = [{**DOCUMENT["recordings"][0], "name": HOSTILE, "notes": [HOSTILE], "sha256": HOSTILE}]
    document["fixed"] = {HOSTILE: {"value": 1.0, "unit": "m", "source": HOSTILE}}
    run = RUN | {"argv": [HOSTILE], "machine": HOSTILE, "versions": {HOSTILE: HOSTILE}}
    plain = Page(fit_page(changed(), [series()], RUN, "[rig]"))
    page = Page(fit_page(document, [series(name=HOSTILE)], run, f"# {HOSTILE}"))
    assert len(page.scripts) == len(plain.scripts) == 3
    assert {tag for tag, _ in page.elements} == {tag for tag, _ in plain.elements}
    assert not [a for _, a in page.elements if "onerror" in a]
    assert page.text.count(HOSTILE) >= 9
    labels = json.dumps(figures_of(page))
    assert "<script" not in labels
    assert "&lt;/script&gt;" in labels
    failed = RUN | {"rig": HOSTILE, "text": HOSTILE, "code": "diverged"}
    simulated = Page(simulation_page(failed, [series(name=HOSTILE)], failed, HOSTILE))
    assert len(simulated.scripts) == 3
    assert not [a for _, a in simulated.elements if "onerror" in a]


def test_no_tag_can_begin_in_the_embedded_json():
    value = {"a": [HOSTILE, None, 1.5], "<b>": "\u2028&"}
    text = pages.safe_json(value)
    assert not set("<>&\u2028") & set(text)
    assert json.loads(text) == value
    with pytest.raises(ValueError, match="JSON compliant"):
        pages.safe_json([float("nan")])


def test_figures_are_those_of_plotly():
    loop = series(temperature=25 + np.linspace(0, 50, 200))
    wires = make_series(
        "two.csv",
        "train",
        np.arange(50.0),
        {"current_1": np.ones(50), "current_2": np.zeros(50), "angle": np.linspace(0, 1, 50)},
        {"angle": np.linspace(0, 1, 50), "temperature_1": np.full(50, 20.0), "temperature_2": np.linspace(20, 90, 50)},
        {"time": "s", "current_1": "A", "current_2": "A", "angle": "deg"},
        has_clock=True,
    )
    pictures = [
        time_picture(loop, ["displacement"], ["current"], {"displacement": 0.02}),
        time_picture(wires, ["angle", "temperature_1"], ["current_1", "current_2"], {}),
        phase_picture(loop, "displacement"),
        phase_picture(wires, "angle"),
        profile_picture("heat.h0", "W/m^2/K", [1.0, 2.0, None], [3.0, 0.0, None]),
        correlation_picture(["a", "b"], [[1.0, None], [None, 1.0]]),
    ]
    for picture in pictures:
        assert picture is not None
        assert isinstance(picture.figure, go.Figure) and len(drawn(picture)["data"]) > 0
        json.dumps(picture.figure.to_plotly_json(), allow_nan=False)
        alone: Any = picture.standalone()
        assert alone.layout.title.text == picture.title and alone.layout.height > picture.height
        assert "title" not in drawn(picture)["layout"]


def test_numbers_of_a_figure_are_single_and_leave_gaps_where_they_are_not_finite():
    single = single_precision(np.array([0.1, -2e9, np.inf, np.nan, 1e300, 1e-300]))
    assert single.dtype == np.float32
    np.testing.assert_allclose(single, [0.1, -2e9, np.nan, np.nan, np.nan, 0.0], rtol=1e-7)


def test_the_time_picture_shows_measured_model_residual_and_input():
    recording = series()
    figure = drawn(time_picture(recording, ["displacement"], ["current"], {"displacement": 0.02}))
    measured, model, residual, current = figure["data"]
    assert measured["y"] == pytest.approx(recording.measured["displacement"], rel=1e-6)
    assert model["y"] == pytest.approx(recording.model["displacement"], rel=1e-6)
    assert residual["y"] == pytest.approx([-1e-3] * 200, rel=1e-5)  # in mm, as the recording
    assert current["x"][-1] == pytest.approx(3.98, rel=1e-6)
    assert [trace["yaxis"] for trace in figure["data"]] == ["y", "y", "y2", "y3"]
    assert [figure["layout"][axis]["title"]["text"] for axis in ("yaxis", "yaxis2", "yaxis3")] == [
        "displacement [mm]",
        "residual<br>[mm]",
        "current<br>[mA]",
    ]
    assert figure["layout"]["xaxis"]["title"]["text"] == "time [s]"
    domains = [figure["layout"][axis]["domain"] for axis in ("yaxis", "yaxis2", "yaxis3")]
    assert all(above[0] > below[1] for above, below in pairwise(domains))


def test_a_phase_plot_uses_the_measured_temperature_if_there_is_one():
    with_sensor = phase_picture(series(temperature=np.full(200, 33.0)), "displacement")
    without = phase_picture(series(), "displacement")
    assert with_sensor and without
    assert list(drawn(with_sensor)["data"][0]["x"]) == [33.0] * 200
    assert drawn(with_sensor)["layout"]["xaxis"]["title"]["text"] == "temperature [degC]"
    assert drawn(without)["data"][0]["x"] == drawn(without)["data"][1]["x"]
    assert drawn(without)["layout"]["xaxis"]["title"]["text"] == "temperature [degC], of the model"


def test_only_long_recordings_are_thinned_and_no_peak_is_lost():
    few, many = np.random.default_rng(0).normal(size=(2, 200_000))
    few = few[:MAX_POINTS]
    assert np.array_equal(thin_rows(few), np.arange(len(few)))
    many[123_456], many[77_777] = 50.0, -50.0
    rows = thin_rows(many)
    assert len(rows) <= MAX_POINTS + 2
    assert {0, 77_777, 123_456, 199_999} <= set(rows.tolist())
    assert np.all(np.diff(rows) > 0)
    long = series(50_000)
    picture = time_picture(long, ["displacement"], ["current"], {})
    assert "Of 50,000 rows the picture draws the lowest and highest of every 5." in picture.caption
    assert "rows the picture" not in time_picture(series(), ["displacement"], ["current"], {}).caption


def test_lines_of_many_models_have_fewer_points():
    picture = comparison_picture({"brinson": series(6_001), "tanaka": series(6_001)}, "displacement", "holdout")
    points = [len(trace["x"]) for trace in drawn(picture)["data"]]
    assert len(points) == 5 and max(points) <= MAX_POINTS_OF_MANY + 2
    assert "Of 6,001 rows the picture draws the lowest and highest of every 7." in picture.caption


def test_predictions_round_trip(tmp_path):
    awkward = series(name='my, "best"\nrun.csv')
    other = make_series(
        "slow.csv",
        "holdout",
        np.array([0.0, 0.5, 1.0]),
        {
            "current": np.array([0.1, 0.2, 0.3]),
            "displacement": np.array([0.0, 1e-3, 2e-3]),
            "force": np.array([1.0, 2.0, 3.0]),
        },
        {"displacement": np.array([0.0, 1e-3, np.nan]), "temperature": np.array([20.0, np.inf, 30.0])},
        {"time": "s", "current": "A", "displacement": "um", "force": "N"},
        has_clock=True,
    )
    prediction.write_predictions(tmp_path / "prediction.csv", [awkward, other])
    header = "recording,role,time [s],current [mA],displacement [mm],displacement_model [mm],temperature_model [degC],force [N]"
    assert (tmp_path / "prediction.csv").read_text().splitlines()[0] == header
    first, second = prediction.read_predictions(tmp_path / "prediction.csv")
    assert (first.name, first.role, second.name, second.role) == (awkward.name, "train", "slow.csv", "holdout")
    assert np.array_equal(first.time, awkward.time)
    for channel, values in awkward.measured.items():
        assert np.array_equal(first.measured[channel], values)
    for channel, values in awkward.model.items():
        np.testing.assert_allclose(first.model[channel], values, rtol=1e-9)
    assert "force" not in first.measured
    assert second.measured["current"].tolist() == [100.0, 200.0, 300.0]
    assert second.measured["displacement"].tolist() == [0.0, 1.0, 2.0]
    assert np.isnan(second.model["temperature"][1])
    assert np.isnan(second.model["displacement"][2])


def test_long_predictions_are_written_in_blocks(tmp_path, monkeypatch):
    whole = series(25)
    prediction.write_predictions(tmp_path / "whole.csv", [whole])
    monkeypatch.setattr(prediction, "_BLOCK", 7)
    prediction.write_predictions(tmp_path / "blocks.csv", [whole])
    assert (tmp_path / "blocks.csv").read_bytes() == (tmp_path / "whole.csv").read_bytes()
    (tmp_path / "blocks.csv").write_text((tmp_path / "whole.csv").read_text() + "a,train,1.0\n")
    with pytest.raises(InputError, match="not a table of predictions"):
        prediction.read_predictions(tmp_path / "blocks.csv")


def test_a_path_has_rows_instead_of_time(tmp_path):
    path = make_series(
        "p.csv",
        "train",
        np.arange(3.0),
        {"strain": np.array([0.0, 0.01, 0.02])},
        {"strain": np.zeros(3)},
        {"strain": "%"},
        has_clock=False,
    )
    prediction.write_predictions(tmp_path / "prediction.csv", [path])
    assert (tmp_path / "prediction.csv").read_text().splitlines()[1:3] == ["p.csv,train,0,0.0,0", "p.csv,train,1,1.0,0"]
    back = prediction.read_predictions(tmp_path / "prediction.csv")[0]
    assert not back.has_clock
    assert time_title(back) == "row"


@pytest.mark.parametrize(
    "text", ["", "a,b\n1,2\n", "recording,role,time [s]\n", "recording,role,time [s],current [A]\nx,train,0,zero\n"]
)
def test_another_table_is_rejected(tmp_path, text):
    (tmp_path / "prediction.csv").write_text(text)
    with pytest.raises(InputError, match="not a table of predictions"):
        prediction.read_predictions(tmp_path / "prediction.csv")


def test_numbers_of_the_summary():
    text = summary.text(DOCUMENT, "out")
    assert (
        text.splitlines()[0]
        == "Fitted 2 parameters of rig.toml (brinson) to train.csv (6,000 rows): converged (14 steps, 1.9 s)."
    )
    cells = [line.split() for line in text.splitlines()]
    assert ["displacement", "0.0200", "mm", "0.0203", "mm", "0.0199", "mm", "1.01"] in cells
    assert ["heat.h0", "-", "103.2", "101.9", "..", "104.5", "W/m^2/K"] in cells
    assert ["heat.capacity", "-", "2.0461", "2.0445", "..", "2.0477", "MJ/m^3/K"] in cells
    assert "Profile likelihood of heat.h0: 101.9 .. - W/m^2/K" in text
    assert (
        "- Hard to distinguish: heat.h0 up and heat.capacity down, changed together, have 0.4 % of the effect" in text
    )
    assert "4 of 4 starts reached the best minimum." in text
    assert "holdout.csv: 2 of 4002 rows dropped on request." in text
    assert text.endswith("Results: out")


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (DOCUMENT, "at its noise floor"),
        (changed(rmse__displacement__train=0.03), "1.51 times its noise floor: the model leaves a small part"),
        (
            changed(rmse__displacement__train=0.39),
            "19.6 times its noise floor: the model lacks something, which smajax diagnose",
        ),
        (changed(rmse__displacement__train=0.39, solver__code="interrupted"), "the fit had not converged yet"),
        (changed(rmse__displacement__holdout=0.06), "the holdout is predicted 3 times worse"),
        (changed(rmse__displacement__holdout=2.8), "the holdout is predicted 140 times worse"),
    ],
)
def test_the_verdict_compares_with_noise_and_holdout(document, words):
    assert words in summary.verdicts(document)[0]
    (verdict,) = (v for v in summary.residual_verdicts(document) if v.channel == "displacement")
    assert verdict.is_bad == ("lacks something" in words or "holdout" in words)


@pytest.mark.parametrize(
    ("document", "words"),
    [
        (changed(solver__starts_at_best=1), "Only 1 of 4 starts reached the best minimum"),
        (changed(solver__starts=1), "Only one start was used"),
        (
            changed(parameters__heat_h0=parameter(0.02, None, None, "1", at_bound=True)),
            "heat_h0 is at its bound, 0.02, and has no interval",
        ),
        (changed(parameters__x=parameter(1.0, -9e9, 9e9, "K", bounds=[-200.0, 200.0])), "x is not determined"),
        (
            changed(indistinct=[{"parameters": ["x"], "direction": [1.0], "shrink": 0.0}]),
            "x has no effect on the observed channels",
        ),
        (changed(discretisation__displacement__value=0.004), "20 % of the noise floor"),
        (changed(warnings=["mind the gap"]), "mind the gap"),
    ],
)
def test_remarks(document, words):
    assert any(words in sentence for sentence in summary.remarks(document))
    assert not any(words in sentence for sentence in summary.remarks(DOCUMENT))


def test_summary_of_a_failed_fit():
    solver = {"code": "failed", "text": "diverged at the start values", "wall_s": None, "compile_s": None}
    document = changed(solver=DOCUMENT["solver"] | solver, profiles={}, indistinct=[])
    document["rmse"]["displacement"] = {"train": None, "holdout": None, "unit": "mm"}
    document["noise_floor"]["displacement"]["value"] = None
    FitDocument.check(document)
    text = summary.text(document)
    assert text.startswith(
        "Could not fit 2 parameters of rig.toml (brinson) to train.csv (6,000 rows): diverged at the start values."
    )
    assert "RMSE" not in text
    assert "the simulation fails at the start values" in page_of(document, [series()]).text.lower()


@pytest.mark.parametrize(
    ("values", "unit", "shown"),
    [
        ((1.5e-4, 1.49e-4, 1.51e-4), "m", ("0.1500", "0.1490", "0.1510", "mm")),
        ((0.0410023, 0.04100, 0.0410046), "1", ("0.0410023", "0.0410000", "0.0410046", "")),
        ((6.731e6, 6.6e6, 6.86e6), "Pa/K", ("6.73", "6.60", "6.86", "MPa/K")),
        ((48.44, 40.0, 57.0), "degC", ("48.4", "40.0", "57.0", "degC")),
        ((3e-9, 2.9e-9, 3.1e-9), "1", ("3.00e-09", "2.90e-09", "3.10e-09", "")),
        ((None, None, None), "K", ("-", "-", "-", "K")),
        ((0.0, None, None), "K", ("0", "-", "-", "K")),
    ],
)
def test_digits_of_estimates(values, unit, shown):
    assert summary.readable(*values, unit=unit) == shown


def test_pretty_units():
    assert pages.pretty_unit("W/m^2/K^3") == "W/m\N{SUPERSCRIPT TWO}/K\N{SUPERSCRIPT THREE}"
