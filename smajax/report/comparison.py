"""Summary and page of ``smajax compare``: models ranked by their error on the holdout."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from smajax.report import pages
from smajax.report.figures import Picture
from smajax.report.prediction import Series, split_label
from smajax.report.summary import table
from smajax.report.time_figures import comparison_picture
from smajax.report.topics import comparison_topics, explained

_PARAMETER_HEAD = ("parameter", "value", "95 % from", "to", "unit")
MODEL_HEAD = ("model", "RMSE holdout", "train", "fit holdout [%]", "train [%]", "parameters", "BIC", "seconds")
# Largest number of array elements that a table lists: more do not fit on a line.
_MAX_LISTED = 20


def summary(doc: Mapping[str, Any]) -> str:
    """Say which model predicts the holdout best, or that none is better than a constant; ``doc`` is compare.json."""
    fitted = [m for m in doc["models"] if not m["why"]]
    best = fitted[0]
    error, useless = f"{best['rmse_holdout']:.3g} {doc['unit']}", best["fit_percent_holdout"] <= 0.0
    words = f"{best['name']} predicts the holdout best: {error} with {best['parameters']} parameters."
    if useless:
        words = (
            "No model predicts the holdout better than the mean of the holdout does; the smallest error is that of "
            f"{best['name']}: {error}."
        )
    lowest = min(fitted, key=lambda m: m["bic"])
    if lowest is not best and not useless:
        words += f" By BIC, which uses the training recording only, {lowest['name']} is the best model."
    if doc["not_compared"]:
        others = " and ".join(doc["not_compared"])
        words += (
            f" Only {doc['channel']} is compared: the material laws are fitted to {others} as well, "
            "the input-output models are not."
        )
    return words


def text(doc: Mapping[str, Any], folder: str = "") -> str:
    """Format the summary of a comparison for a terminal.

    Args:
        doc: The document compare.json.
        folder: The result folder, which the last line names; empty for none.
    """
    lines = [
        f"{doc['channel']} in {doc['unit']}:",
        *table([MODEL_HEAD, *model_rows(doc)], right=range(1, len(MODEL_HEAD))),
        "",
        doc["summary"],
    ]
    lines += [f"Left out: {m['name']}: {m['why']}" for m in doc["models"] if m["why"]]
    place = [f"Results: {folder}"] if folder else []
    return "\n".join([*lines, *notes(doc), *explained(comparison_topics(doc)), *place])


def model_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows of the models, best first."""
    rows = []
    for m in doc["models"]:
        if m["why"]:
            rows.append((m["name"], "left out", *[""] * (len(MODEL_HEAD) - 2)))
            continue
        errors = [f"{m[key]:.4g}" for key in ("rmse_holdout", "rmse_train")]
        percent = [f"{m[key]:.1f}" for key in ("fit_percent_holdout", "fit_percent_train")]
        rows.append((m["name"], *errors, *percent, str(m["parameters"]), f"{m['bic']:.0f}", f"{m['wall_s']:.1f}"))
    return rows


def notes(doc: Mapping[str, Any]) -> list[str]:
    """List remarks on recordings and single models.

    They are repairs, channels that are not used, parameters at a bound, and undetermined parameters.
    """
    remarks = [f"{r['name']}: {note}" for r in doc.get("recordings", ()) for note in r["notes"]]
    remarks += [f"{m['name']}: {m['note']}" for m in doc["models"] if m["note"]]
    offset, fitted = f"sensor.{doc['channel']}_offset", [m for m in doc["models"] if not m["why"]]
    without_offset = [m["name"] for m in fitted if m["kind"] == "law" and offset not in m["fitted"]]
    if without_offset and any(m["kind"] != "law" for m in fitted):
        remarks.append(
            f"Input-output models have a constant offset, and {', '.join(without_offset)} none: free {offset} if the "
            "sensor may not begin at 0"
        )
    remarks += [f"{m['name']}: at its bound: {', '.join(m['at_bound'])}" for m in doc["models"] if m.get("at_bound")]
    undetermined = [(m["name"], ", ".join(m["undetermined"])) for m in doc["models"] if m.get("undetermined")]
    return remarks + [f"{name}: not determined by the training recording: {names}" for name, names in undetermined]


def parameter_rows(fitted: Mapping[str, Mapping[str, Any]]) -> list[tuple[str, ...]]:
    """Return table rows of a model's parameters: name, value, ends of the interval, unit; for long arrays the length.

    Args:
        fitted: Entry by parameter, as ``fitted`` of a model in compare.json.
    """
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
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    sections = [pages.verdict_section([doc["summary"]]), "<h2>Models, best first</h2>"]
    sections.append(pages.table(MODEL_HEAD, model_rows(doc), numbers=tuple(range(1, len(MODEL_HEAD)))))
    left_out = [f"{m['name']} was left out: {m['why']}" for m in doc["models"] if m["why"]]
    sections.append(pages.bullets(left_out + notes(doc)))
    unit = pages.escape(pages.pretty_unit(doc["unit"]))
    sections.append(f"<p>RMSE in {unit}. The fit is defined as in MATLAB: 100 (1 - |y - model| / |y - mean|).</p>")
    for role in ("holdout", "train"):
        picture = comparison_picture(series_by_model(doc, series, role), doc["channel"], role)
        sections.append(pages.add_picture(picture, pictures))
    sections += _parameter_sections(doc)
    sections.append(pages.topics_section(comparison_topics(doc)))
    sections += pages.provenance_sections(run, rig, pages.recordings_table(doc["recordings"]))
    lead = f"Predictions of {doc['channel']} by several models."
    return pages.render_page(f"Comparison on {doc['rig']}", lead, sections, pictures)


def series_by_model(doc: Mapping[str, Any], series: Sequence[Series], role: str) -> dict[str, Series]:
    """Return the predictions of one recording by model, best first.

    Args:
        doc: The content of compare.json.
        series: The predictions, named "RECORDING (MODEL)".
        role: Role of the recording.
    """
    by_model = {split_label(s.name)[1]: s for s in series if s.role == role}
    return {m["name"]: by_model[m["name"]] for m in doc["models"] if m["name"] in by_model}


def _parameter_sections(doc: Mapping[str, Any]) -> list[str]:
    sections = [
        "<h2>Fitted parameters</h2>",
        "<p>With 95 % intervals where available; inputs and outputs of input-output models in SI units and degC, times "
        "in s.</p>",
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
