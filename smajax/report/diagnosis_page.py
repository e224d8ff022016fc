"""Report page of a diagnosis, built from ``diagnosis.json`` (schema 1 or 2) and ``prediction.csv``."""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax.diagnosis.data_split import SPLIT_NAMES
from smajax.report import pages
from smajax.report.diagnosis_figures import autocorrelation_picture, budget_picture, nonparametric_picture
from smajax.report.diagnosis_summary import (
    Document,
    in_usual_unit,
    refit_error_unit,
    sentences,
    significant,
    usual_unit,
)
from smajax.report.figures import Picture
from smajax.report.prediction import Series, split_label
from smajax.report.time_figures import time_picture
from smajax.report.topics import diagnosis_topics

# Words of the table of effects.
_STATUS_TOPICS = ("detectable-from", "absorbed", "blind")
_REFIT_ERROR = "error after refit"
_EFFECT_HEAD = (
    "effect",
    "stage",
    "status",
    "strength ± 95 %",
    "unit",
    _REFIT_ERROR,
    "detectable from",
    "absorbed by, or why not",
)
_PARAMETER_HEAD = ("parameter of the accepted effects", "estimate", "95 % from", "to", "unit", "plausible", "meaning")


def diagnosis_page(doc: Document, series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a diagnosis.

    Args:
        doc: The document diagnosis.json.
        series: The predictions before and after, named "RECORDING (before)" and "RECORDING (after)".
        run: The document run.json, which names the input channels.
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    unexplained = doc["verdict"] in ("partial", "unresolved")
    sections = [pages.verdict_section(sentences(doc), bad=unexplained)]
    sections += error_section(doc)
    sections += budget_section(doc, pictures)
    sections += _residual_section(doc, pictures)
    sections += effects_section(doc)
    sections += _detectability_section(doc)
    sections.append("<h2>Measured against model</h2>")
    floor = {channel: entry["value"] for channel, entry in doc["noise_floor"].items()}
    sections += [pages.add_picture(time_picture(s, list(doc["rmse"]), run["inputs"], floor), pictures) for s in series]
    sections.append(pages.topics_section([*diagnosis_topics(doc), *_STATUS_TOPICS]))
    sections += pages.provenance_sections(run, rig)
    names = dict.fromkeys(split_label(s.name)[0] for s in series)
    lead = f"Diagnosis of the rig from {', '.join(names)}."
    return pages.render_page(f"Diagnosis: {doc['verdict']}", lead, sections, pictures)


def error_section(doc: Document) -> list[str]:
    """Return the errors before and after, with the interval of their fall on the holdout."""
    rows = []
    for channel, rmse in doc["rmse"].items():
        noise = significant(doc["noise_floor"][channel]["value"], 4)
        for name in SPLIT_NAMES:
            before, after = (significant(rmse[f"{name}_{when}"], 4) for when in ("before", "after"))
            rows.append((channel, name, before, after, noise, rmse["unit"]))
    head = ("channel", "recording", "before", "after", "noise", "unit")
    sections = ["<h2>Error before and after</h2>", pages.table(head, rows, numbers=(2, 3, 4))]
    if doc["effects"]:
        sections.append(pages.bullets([_cut_sentence(doc, channel) for channel in doc["rmse"]]))
    return sections


def budget_section(doc: Document, pictures: list[Picture]) -> list[str]:
    """Return the error budget as a table and a figure of each channel; empty in documents without one.

    Args:
        doc: The document diagnosis.json.
        pictures: The figures of the page, to which those of the budget are appended.
    """
    entries = doc.get("error_budget")  # absent in documents of earlier versions
    if not entries:
        return []
    rows = []
    for channel, floor in doc["noise_floor"].items():
        for entry in entries:
            errors = entry["channels"][channel]
            cut, last = errors["holdout_cut_95"], errors["cut_if_last"]
            rows.append(
                (
                    channel,
                    entry["added"],
                    *(significant(errors[name], 4) for name in SPLIT_NAMES),
                    "-" if cut is None else f"{significant(cut[0])} to {significant(cut[1])}",
                    "-" if last is None else significant(last["holdout"]),
                    errors["unit"],
                )
            )
        noise = significant(floor["value"], 4)
        rows.append((channel, "noise", noise, noise, noise, "-", "-", floor["unit"]))
    head = ("channel", "model with", *SPLIT_NAMES, "fall on the holdout, 95 %", "fall if added last", "unit")
    sections = ["<h2>Error budget</h2>", pages.table(head, rows, numbers=(2, 3, 4))]
    pictured = ((channel, floor["value"]) for channel, floor in doc["noise_floor"].items())
    return sections + [pages.add_picture(budget_picture(c, noise, entries), pictures) for c, noise in pictured]


def _cut_sentence(doc: Document, channel: str) -> str:
    """A sentence about the interval of the fall of a channel's error on the holdout."""
    rmse, holdout = doc["rmse"][channel], doc.get("holdout")
    low, high = (significant(end) for end in rmse["holdout_cut_95"])
    note = "" if holdout is None else ", before any choice by the holdout"
    part = "the holdout"
    if holdout and holdout.get("interval_of") == "second half":
        part, note = "the second half of the holdout, which had no part in the choice,", ""
    elif holdout and holdout["decided"]:  # an earlier version
        note = ", after selection: the holdout decided that the effects stay"
    return f"The error of {channel} on {part} falls by {low} to {high} {rmse['unit']} (95 %{note})."


def _residual_section(doc: Document, pictures: list[Picture]) -> list[str]:
    """The training recording's residual: its correlations, and the stages that can explain it."""
    rows = [
        (channel, when, name, significant(statistics["rms"], 4), _percent(share))
        for channel, by_fit in doc["residual"].items()
        for when, statistics in by_fit.items()
        for name, share in statistics["outside"].items()
    ]
    head = ("channel", "fit", "correlated with", "RMS", "lags beyond 99 %")
    sections = ["<h2>Residual of the training recording</h2>", pages.table(head, rows, numbers=(3, 4))]
    for channel, by_fit in doc["residual"].items():
        sections.append(pages.add_picture(autocorrelation_picture(channel, by_fit), pictures))
    sections.append("<h2>Share of the residual that each stage can explain</h2>")
    shares = [(stage, _percent(share)) for stage, share in doc["stages"].items()]
    sections.append(pages.table(("stage", "share"), shares, numbers=(1,)))
    if doc["free_form"]:
        sections.append(pages.add_picture(nonparametric_picture(doc["free_form"]), pictures))
    return sections


def _percent(share: float | None) -> str:
    return "-" if share is None else f"{100 * share:.0f} %"


def effects_section(doc: Document) -> list[str]:
    """Return the tables of all effects, of their parameters, and of the rejected and the excluded ones."""
    sections = ["<h2>Effects</h2>"]
    unit, channel = refit_error_unit(doc), next(iter(doc["rmse"]))
    head = [f"error after refit, {unit}" if cell == _REFIT_ERROR else cell for cell in _EFFECT_HEAD]
    sections.append(pages.table(head, [_effect_row(entry) for entry in doc["ranking"]], numbers=(3, 5, 6)))
    sections.append(
        f"<p>Error after refit: RMSE of {pages.escape(channel)} on the selection recording, in {pages.escape(unit)}, "
        "when the rig is fitted again to the training recording with this effect alone. The choice is by the errors on "
        "both recordings together, in all channels.</p>"
    )
    if parameters := doc.get("effect_parameters"):  # absent in documents of earlier versions
        sections.append(pages.table(_PARAMETER_HEAD, [_parameter_row(p) for p in parameters], numbers=(1, 2, 3)))
    if doc["rejected"]:
        rows = [(entry["key"], entry["why"]) for entry in doc["rejected"]]
        sections.append(pages.table(("rejected", "because it"), rows))
    if doc["excluded"]:
        limits = [
            (e["key"], in_usual_unit(e["above"], e["unit"]), pages.pretty_unit(usual_unit(e["unit"])))
            for e in doc["excluded"]
        ]
        sections.append("<h2>Excluded effects</h2>")
        sections.append(pages.table(("effect", "excluded above", "unit"), limits, numbers=(1,)))
    return sections


def _parameter_row(entry: Mapping[str, Any]) -> tuple[str, ...]:
    unit = entry["unit"]
    cells = (in_usual_unit(entry[key], unit, 4) for key in ("value", "lower95", "upper95"))
    note = entry["meaning"] if entry["lower95"] is not None else f"{entry['meaning']}; not determined"
    plausible = " to ".join(in_usual_unit(end, unit) for end in entry.get("plausible") or ())
    return (entry["name"], *cells, pages.pretty_unit(usual_unit(unit)), plausible, note)


def _effect_row(entry: Mapping[str, Any]) -> tuple[str, ...]:
    internal = entry["unit"]
    strength = in_usual_unit(entry["strength"], internal)
    if entry["lower95"] is not None:
        # A difference: no unit of a strength has an offset.
        strength += f" ± {in_usual_unit(0.5 * (entry['upper95'] - entry['lower95']), internal, 2)}"
    error, detectable = significant(entry["refit_rmse_select"]), in_usual_unit(entry["smallest_detectable"], internal)
    reason = ", ".join(entry["absorbed_by"]) or entry["why"]
    unit = pages.pretty_unit(usual_unit(internal))
    return (entry["key"], entry["stage"], entry["status"], strength, unit, error, detectable, reason)


def _detectability_section(doc: Document) -> list[str]:
    rows = [
        (
            entry["key"],
            entry["status"],
            in_usual_unit(entry["smallest_detectable"], entry["unit"]),
            pages.pretty_unit(usual_unit(entry["unit"])),
            ", ".join(entry["absorbed_by"]) or entry["why"],
        )
        for entry in doc["preflight"]
    ]
    head = ("effect", "status", "detectable from", "unit", "absorbed by, or why not")
    return ["<h2>Effects that this input can show, before any fit</h2>", pages.table(head, rows, numbers=(2,))]
