"""The text and the page of ``smajax compare``: models by their error on a recording none of them was fitted to."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from smajax.report import pages
from smajax.report.figures import Picture
from smajax.report.prediction import Series
from smajax.report.summary import table
from smajax.report.time_figures import comparison_picture

_PARAMETER_HEAD = ("parameter", "value", "95 % from", "to", "unit")
_MODEL_HEAD = ("model", "RMSE holdout", "train", "fit holdout [%]", "train [%]", "parameters", "BIC", "seconds")
# Numbers of an array that a table lists: more do not fit on a line.
_MAX_LISTED = 20


def summary(doc: Mapping[str, Any]) -> str:
    """Say which model predicts best, or that none does better than a constant."""
    fitted = [m for m in doc["models"] if not m["why"]]
    best = fitted[0]
    error, useless = f"{best['rmse_holdout']:.3g} {doc['unit']}", best["fit_percent_holdout"] <= 0.0
    said = f"{best['name']} predicts the holdout best: {error} with {best['parameters']} parameters."
    if useless:
        said = (
            "No model predicts the holdout better than the mean of the holdout does; the smallest error has "
            f"{best['name']}: {error}."
        )
    lowest = min(fitted, key=lambda m: m["bic"])
    if lowest is not best and not useless:
        said += f" By BIC, which uses the training recording only, it would be {lowest['name']}."
    if doc["not_compared"]:
        others = " and ".join(doc["not_compared"])
        said += (
            f" Compared is {doc['channel']} alone: the material laws are fitted to {others} as well, "
            "the input-output models are not."
        )
    return said


def text(doc: Mapping[str, Any], folder: str) -> str:
    """Format what the command prints; ``folder`` is the result folder."""
    lines = [
        f"{doc['channel']} in {doc['unit']}:",
        *table([_MODEL_HEAD, *model_rows(doc)], right=range(1, len(_MODEL_HEAD))),
        "",
        doc["summary"],
    ]
    lines += [f"Left out: {m['name']}: {m['why']}" for m in doc["models"] if m["why"]]
    return "\n".join([*lines, *notes(doc), f"All of it in {folder}"])


def model_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of the table of models, best first."""
    rows = []
    for m in doc["models"]:
        if m["why"]:
            rows.append((m["name"], "left out", *[""] * (len(_MODEL_HEAD) - 2)))
            continue
        errors = [f"{m[key]:.4g}" for key in ("rmse_holdout", "rmse_train")]
        percent = [f"{m[key]:.1f}" for key in ("fit_percent_holdout", "fit_percent_train")]
        rows.append((m["name"], *errors, *percent, str(m["parameters"]), f"{m['bic']:.0f}", f"{m['wall_s']:.1f}"))
    return rows


def notes(doc: Mapping[str, Any]) -> list[str]:
    """List remarks on single models: what was done to the recordings, parameters at a bound or undetermined."""
    remarks = [f"{m['name']}: {m['note']}" for m in doc["models"] if m["note"]]
    offset, fitted = f"sensor.{doc['channel']}_offset", [m for m in doc["models"] if not m["why"]]
    without_offset = [m["name"] for m in fitted if m["kind"] == "law" and offset not in m["fitted"]]
    if without_offset and any(m["kind"] != "law" for m in fitted):
        remarks.append(
            f"Input-output models have a constant, and {', '.join(without_offset)} none: free {offset} if the sensor "
            "may not "
            "begin at 0"
        )
    remarks += [f"{m['name']}: at its bound: {', '.join(m['at_bound'])}" for m in doc["models"] if m.get("at_bound")]
    undetermined = [(m["name"], ", ".join(m["undetermined"])) for m in doc["models"] if m.get("undetermined")]
    return remarks + [f"{name}: not determined by the training recording: {names}" for name, names in undetermined]


def parameter_rows(fitted: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return name, value, interval and unit of the parameters of a model; of long arrays their length only."""
    rows = []
    for name, entry in fitted.items():
        ends = ["" if isinstance(entry["value"], list) else _format_value(entry[key]) for key in ("lower95", "upper95")]
        rows.append((name, _format_value(entry["value"]), *ends, entry.get("unit", "")))
    return rows


def comparison_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a comparison.

    Args:
        doc: The document compare.json.
        series: The predictions, named "RECORDING (MODEL)".
        run: The document run.json.
        rig: The text of the rig file.
    """
    pictures: list[Picture] = []
    sections = [f'<div class="verdict"><p>{pages.escape(doc["summary"])}</p></div>', "<h2>Models, best first</h2>"]
    sections.append(pages.table(_MODEL_HEAD, model_rows(doc), numbers=tuple(range(1, len(_MODEL_HEAD)))))
    left_out = [f"{m['name']} was left out: {m['why']}" for m in doc["models"] if m["why"]]
    sections.append(pages.bullets(left_out + notes(doc)))
    unit = pages.escape(pages.pretty_unit(doc["unit"]))
    sections.append(f"<p>RMSE in {unit}. The fit is that of MATLAB: 100 (1 - |y - model| / |y - mean|).</p>")
    for role in ("holdout", "train"):
        by_model = {s.name.rpartition(" (")[2].removesuffix(")"): s for s in series if s.role == role}
        ordered = {m["name"]: by_model[m["name"]] for m in doc["models"] if m["name"] in by_model}
        sections.append(pages.add_picture(comparison_picture(ordered, doc["channel"], role), pictures))
    sections += _parameter_sections(doc)
    sections += [
        "<h2>Where this comes from</h2>",
        pages.recordings_table(doc["recordings"]),
        pages.provenance_section(run),
        pages.rig_section(rig),
    ]
    lead = f"Predictions of {doc['channel']} by several models."
    return pages.render_page(f"Comparison on {doc['rig']}", lead, sections, pictures)


def _parameter_sections(doc: Mapping[str, Any]) -> list[str]:
    sections = [
        "<h2>Fitted parameters</h2>",
        "<p>With 95 % intervals where there are any; inputs and outputs of input-output models in SI units and degC, "
        "times in s.</p>",
    ]
    for m in doc["models"]:
        if m.get("fitted"):
            rows = parameter_rows(m["fitted"])
            sections += [f"<h3>{pages.escape(m['name'])}</h3>", pages.table(_PARAMETER_HEAD, rows, numbers=(1, 2, 3))]
    return sections


def _format_value(value: Any) -> str:
    if isinstance(value, list):
        flat = np.ravel(np.asarray(value, object))
        if len(flat) > _MAX_LISTED:
            return f"{len(flat)} numbers, in compare.json"
        return ", ".join(_format_value(v) for v in flat)
    return "-" if value is None else f"{value:.5g}"
