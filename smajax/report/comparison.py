"""What ``smajax compare`` prints and shows: models by their error on a recording that none of them was fitted to."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from smajax.report import html, plots
from smajax.report import summary as texts
from smajax.report.prediction import Series

SCHEMA = "smajax.compare/1"
_FITTED = ("parameter", "value", "95 % from", "to", "unit")
_LISTED = 20
_HEAD = ("model", "RMSE holdout", "train", "fit holdout [%]", "train [%]", "parameters", "BIC", "seconds")


def summary(doc: Mapping[str, Any]) -> str:
    """Which model predicts best, in words, or that none does better than a constant."""
    good = [m for m in doc["models"] if not m["why"]]
    best = good[0]
    error, useless = f"{best['rmse_holdout']:.3g} {doc['unit']}", best["fit_percent_holdout"] <= 0.0
    told = f"{best['name']} predicts the holdout best: {error} with {best['parameters']} parameters."
    if useless:
        told = f"No model predicts the holdout better than the holdout's own mean does; the least error has {best['name']}: {error}."
    lowest = min(good, key=lambda m: m["bic"])
    if lowest is not best and not useless:
        told += f" By BIC, which knows the training recording only, it would be {lowest['name']}."
    if doc["not_compared"]:
        others = " and ".join(doc["not_compared"])
        told += f" Compared is {doc['channel']} alone: the laws are fitted to {others} as well, the input-output laws are not."
    return told


def rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The table's rows, best first."""
    shown = []
    for m in doc["models"]:
        if m["why"]:
            shown.append((m["name"], "left out", "", "", "", "", "", ""))
            continue
        numbers = [f"{m[k]:.4g}" for k in ("rmse_holdout", "rmse_train")] + [
            f"{m[k]:.1f}" for k in ("fit_percent_holdout", "fit_percent_train")
        ]
        shown.append((m["name"], *numbers, str(m["parameters"]), f"{m['bic']:.0f}", f"{m['wall_s']:.1f}"))
    return shown


def notes(doc: Mapping[str, Any]) -> list[str]:
    """What has to be known of single models: what was done to the recordings for them, which parameters ended at a bound or are open."""
    told = [f"{m['name']}: {m['note']}" for m in doc["models"] if m["note"]]
    offset, fitted = f"sensor.{doc['channel']}_offset", [m for m in doc["models"] if not m["why"]]
    held = [m["name"] for m in fitted if m["kind"] == "law" and offset not in m["fitted"]]
    if held and any(m["kind"] != "law" for m in fitted):
        told.append(f"Input-output laws have a constant, and {', '.join(held)} none: free {offset} if the sensor may not begin at 0")
    told += [f"{m['name']}: at its bound: {', '.join(m['at_bound'])}" for m in doc["models"] if m.get("at_bound")]
    open_ = [(m["name"], ", ".join(m["undetermined"])) for m in doc["models"] if m.get("undetermined")]
    return told + [f"{name}: not determined by the training recording: {names}" for name, names in open_]


def fitted_rows(fitted: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Name, value, ends of the interval and unit of a model's parameters; of arrays of more than twenty numbers their count."""

    def shown(value: Any) -> str:
        if isinstance(value, list):
            flat = np.ravel(np.asarray(value, object))
            return f"{len(flat)} numbers, in compare.json" if len(flat) > _LISTED else ", ".join(shown(v) for v in flat)
        return "-" if value is None else f"{value:.5g}"

    return [
        (name, shown(p["value"]), *("" if isinstance(p["value"], list) else shown(p[k]) for k in ("lower95", "upper95")), p.get("unit", ""))
        for name, p in fitted.items()
    ]


def text(doc: Mapping[str, Any], folder: str) -> str:
    """What the command prints."""
    lines = [f"{doc['channel']} in {doc['unit']}:", *texts.table([_HEAD, *rows(doc)], right=range(1, len(_HEAD))), "", doc["summary"]]
    lines += [f"Left out: {m['name']}: {m['why']}" for m in doc["models"] if m["why"]]
    return "\n".join([*lines, *notes(doc), f"All of it in {folder}"])


def comparison_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """The page: ``doc`` is compare.json, ``series`` the predictions, ``run`` run.json, ``rig`` the rig file's text."""
    pictures: list[plots.Picture] = []
    sections = [f'<div class="verdict"><p>{html.escape(doc["summary"])}</p></div>', "<h2>Models, best first</h2>"]
    sections.append(html.table(_HEAD, rows(doc), numbers=tuple(range(1, len(_HEAD)))))
    told = [f"{m['name']} was left out: {m['why']}" for m in doc["models"] if m["why"]]
    sections.append(html.bullets(told + notes(doc)))
    sections.append(
        f"<p>RMSE in {html.escape(html.pretty_unit(doc['unit']))}. The fit is MATLAB's: 100 (1 - |y - model| / |y - mean|).</p>"
    )
    for role in ("holdout", "train"):
        found = {s.name.rpartition(" (")[2].removesuffix(")"): s for s in series if s.role == role}
        ordered = {m["name"]: found[m["name"]] for m in doc["models"] if m["name"] in found}
        sections.append(html.draw(plots.comparison_picture(ordered, doc["channel"], role), pictures))
    sections.append("<h2>Fitted parameters</h2>")
    sections.append(
        "<p>With 95 % intervals where there are any; inputs and outputs of input-output laws in SI units and degC, times in s.</p>"
    )
    for m in doc["models"]:
        if m.get("fitted"):
            sections += [f"<h3>{html.escape(m['name'])}</h3>", html.table(_FITTED, fitted_rows(m["fitted"]), numbers=(1, 2, 3))]
    sections += ["<h2>Where this comes from</h2>", html.recordings(doc["recordings"]), html.provenance(run), html.rig_text(rig)]
    return html.page(f"Comparison on {doc['rig']}", f"What several models make of {doc['channel']}.", sections, pictures)
