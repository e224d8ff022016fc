"""Report pages of a fit and of a simulation."""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax.report import summary
from smajax.report.figures import Picture
from smajax.report.pages import (
    add_picture,
    bullets,
    folded,
    pretty_unit,
    provenance_sections,
    recordings_table,
    render_page,
    table,
    topics_section,
    verdict_section,
)
from smajax.report.parameter_figures import correlation_picture, profile_picture
from smajax.report.phase_figures import phase_picture
from smajax.report.prediction import Series
from smajax.report.shown_values import format_value
from smajax.report.time_figures import time_picture
from smajax.report.topics import fit_topics


def fit_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a fit.

    Args:
        doc: The document fit.json.
        series: The recordings with their predictions.
        run: The document run.json.
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    floor = {channel: entry["value"] for channel, entry in doc["noise_floor"].items()}
    pictures: list[Picture] = []
    notices = [*summary.bench_sentences(doc), *doc.get("notices", ())]
    sections = [bullets(notices)] if notices else []
    sections += [_verdict_section(doc), rmse_table(doc), "<h2>Parameters</h2>", parameter_table(doc)]
    sections.append(bullets(summary.remarks(doc)))
    sections.append("<h2>Measured against model</h2>")
    for recording in series:
        sections += _recording_pictures(recording, doc["observed"], doc["inputs"], floor, pictures)
    sections += _uncertainty_pictures(doc, pictures)
    is_bad = any(verdict.is_bad for verdict in summary.residual_verdicts(doc))
    sections.append(topics_section(fit_topics(doc, is_bad)))
    details = (recordings_table(doc["recordings"]), _fixed_section(doc), _solver_section(doc))
    sections += provenance_sections(run, rig, *details)
    return render_page(f"Fit of {doc['rig']}", summary.headline(doc), sections, pictures)


def simulation_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a simulation.

    Args:
        doc: The document run.json, which names the observed channels and the inputs.
        series: The recording with the simulated channels.
        run: The document run.json, as for other pages.
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    (recording,) = series
    observed = simulated_channels(doc, recording)
    others = [c for c in recording.model if c not in observed and c not in doc["inputs"]]
    sections = [verdict_section([doc["text"]], bad=True)] if doc["code"] != "done" else []
    sections.append(bullets(doc.get("warnings", ())))  # absent in documents of earlier versions
    if metrics := doc.get("metrics"):
        rows = [(n, format_value(e["value"], e["unit"])) for n, e in metrics.items()]
        sections += ["<h2>Last cycle</h2>", table(("metric", "value"), rows, numbers=(1,))]
    sections += _recording_pictures(recording, observed, doc["inputs"], {}, pictures)
    if others:
        sections.append("<h2>The other channels</h2>")
        sections.append(add_picture(time_picture(recording, others, [], {}), pictures))
    sections += provenance_sections(run, rig, recordings_table(doc["recordings"]))
    lead = f"{doc['rig']} driven by {recording.name}: {len(recording.time):,} rows."
    return render_page(f"Simulation of {doc['rig']}", lead, sections, pictures)


def simulated_channels(doc: Mapping[str, Any], recording: Series) -> list[str]:
    """List the channels that the page shows first: the observed ones, or all if none of these is simulated.

    Args:
        doc: The document run.json.
        recording: The recording with the simulated channels.
    """
    return [c for c in doc["observed"] if c in recording.model] or list(recording.model)


def _verdict_section(doc: Mapping[str, Any]) -> str:
    sentences = summary.verdicts(doc)
    failed = doc["solver"]["code"] == "failed"
    if failed:
        sentences = [
            "The simulation fails at the start values, so there is no fit: the numbers below are the values of the rig "
            "file."
        ]
    if doc.get("failure"):
        sentences = [summary.capitalised(doc["failure"]), *sentences]
    bad = failed or bool(doc.get("failure")) or any(verdict.is_bad for verdict in summary.residual_verdicts(doc))
    return verdict_section(sentences, bad=bad)


def rmse_table(doc: Mapping[str, Any]) -> str:
    """Return the table of the errors of a fit."""
    head = ("channel", "RMSE train", "holdout", "noise floor", "train / floor")
    return table(head, summary.rmse_rows(doc), numbers=(1, 2, 3, 4))


def parameter_table(doc: Mapping[str, Any]) -> str:
    """Return the table of the parameters of a fit."""
    rows = [
        (name, nominal, estimate, low, high, pretty_unit(unit), plausible_text(doc["parameters"][name]), note)
        for name, nominal, estimate, low, high, unit, note in summary.parameter_rows(doc)
    ]
    head = ("parameter", "nominal", "estimate", "95 % from", "to", "unit", "an alloy can have", "")
    return table(head, rows, numbers=(1, 2, 3, 4), remark=7) + bullets(summary.temperature_sentences(doc))


def plausible_text(entry: Mapping[str, Any]) -> str:
    """Return the plausible range of a parameter's entry; empty where there is none, as in earlier documents."""
    ends = entry.get("plausible") or ()
    texts = []
    for end in ends:
        value, _, _, unit = summary.readable(end, None, None, unit=entry["unit"], shown=entry.get("file_unit"))
        texts.append("" if end is None else f"{value} {unit}".rstrip())
    return " to ".join(texts)


def _recording_pictures(
    series: Series,
    observed: Sequence[str],
    inputs: Sequence[str],
    floor: Mapping[str, float | None],
    pictures: list[Picture],
) -> list[str]:
    """Figures of a recording over time, and of each observed channel over another one if possible."""
    loops = (phase_picture(series, channel) for channel in observed)
    return [
        add_picture(picture, pictures)
        for picture in (time_picture(series, observed, inputs, floor), *loops)
        if picture is not None
    ]


def _uncertainty_pictures(doc: Mapping[str, Any], pictures: list[Picture]) -> list[str]:
    """Profiles and correlations of the parameters."""
    figures = []
    for name, profile in doc.get("profiles", {}).items():
        unit = doc["parameters"][name]["unit"]
        figures.append(add_picture(profile_picture(name, unit, profile["values"], profile["rise"]), pictures))
    correlations = doc["correlations"]
    if len(correlations["parameters"]) > 1:
        picture = correlation_picture(correlations["parameters"], correlations["matrix"])
        figures.append(add_picture(picture, pictures))
    return ["<h2>Uncertainty of the parameters</h2>", *figures] if figures else []


def _fixed_section(doc: Mapping[str, Any]) -> str:
    rows = []
    for name, entry in doc["fixed"].items():
        value, _, _, unit = summary.readable(entry["value"], None, None, unit=entry["unit"])
        rows.append((name, value, pretty_unit(unit), entry["source"]))
    if not rows:
        return ""
    return folded("Fixed parameters", table(("parameter", "value", "unit", "from"), rows, numbers=(1,)))


def _solver_section(doc: Mapping[str, Any]) -> str:
    solver = doc["solver"]
    rows = [("result", f"{solver['code']}: {solver['text']}"), ("steps", str(solver["steps"]))]
    rows.append(("simulations", f"{solver['simulations']:,}"))
    if solver["wall_s"] is not None:
        rows.append(("time", f"{solver['wall_s']:.2f} s, with {solver['compile_s'] or 0:.2f} s of compilation"))
    rows += [
        ("starts at the best minimum", f"{solver['starts_at_best']} of {solver['starts']}"),
        ("seed", str(doc["seed"])),
    ]
    return folded("Solver", table(("", ""), rows))
