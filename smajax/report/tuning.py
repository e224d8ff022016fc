"""Summary and page of ``smajax tune``: gains, metrics and margins, before and after tuning."""

import math
from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

from smajax.report import pages
from smajax.report.figures import Picture
from smajax.report.prediction import Series
from smajax.report.summary import table
from smajax.report.time_figures import response_picture
from smajax.report.topics import explained, tuning_topics
from smajax.report.tuning_checks import (
    check_words,
    further_jumps,
    jump_head,
    jump_rows,
    low_margin_rows,
    padded,
    unsettled_words,
    usual_margin_words,
    worse_words,
    worst_cell,
)
from smajax.report.tuning_metrics import LABELS, format_entry
from smajax.units import from_si

# A gain is at a bound if it is nearer than this share of its logarithmic range.
_AT_BOUND = 1e-3
# Gain margin (a factor) and phase margin (degrees) below which the summary warns; chosen by trial.
_MIN_GAIN_MARGIN = 1.5
_MIN_PHASE_MARGIN = 20.0
_MARGIN_LABELS = {"gain": "gain margin", "phase": "phase margin [deg]", "sensitivity": "largest sensitivity"}
_EXPORTS = ("controller.h", "controller.json", "plant.fmu", "controller.fmu")


def tuning_summary(doc: Mapping[str, Any]) -> str:
    """Summarise the result of a tuning in sentences; ``doc`` is tune.json."""
    before, after = doc["metrics"]["start"], doc["metrics"]["tuned"]
    key = "settling" if doc["objective"]["settle"] else "rmse"
    start, tuned = (format_entry(doc, metrics[key], key) for metrics in (before, after))
    words = f"{LABELS[key]} of {doc['channel']}: {start} with the start gains, {tuned} with the tuned ones, "
    words += f"found in {doc['rollouts']:,} rollouts."
    words += _feedforward_words(doc) + _pulse_words(doc)
    if "asked" in doc["objective"]:
        weight = doc["objective"]["weights"]["effort"]
        words += f" With the weights of the file the loop is not stable, so the effort weight was raised to {weight:g}."
    if doc["problems"]:
        words += " But " + "; ".join(doc["problems"]) + "."
    words += check_words(doc) + unsettled_words(doc) + worse_words(doc)
    words += _margin_warning(doc) or usual_margin_words(doc)
    words += _bound_words(doc.get("gains", {})) + _filter_words(doc) + _draw_words(doc)
    return words + "".join(f" {note}." for note in doc.get("recording_notes") or ())


def _feedforward_words(doc: Mapping[str, Any]) -> str:
    if "feedforward" not in doc:
        return ""
    entry = doc["feedforward"]
    ends = " to ".join(f"{end:.3g}" for end in entry["command"])
    misfit = format_entry(doc, entry["misfit"], "rmse")
    share = 100.0 * entry["misfit"] / entry["stroke"]
    return (
        f" The feedforward's operator of {entry['operators']} plays was fitted to a slow loop of {ends} "
        f"{entry['command_unit']} ({entry['loop']}, {entry['seconds']:.0f} s) with a misfit of {misfit} RMSE, "
        f"{share:.1f} % of its stroke."
    )


def _pulse_words(doc: Mapping[str, Any]) -> str:
    if "pulses" not in doc:
        return ""
    pulses = doc["pulses"]
    error = format_entry(doc, pulses["rmse_of_mean"], "rmse")
    return (
        f" The command is pulsed at {pulses['carrier']:g} Hz; driven by the mean of its pulses, the same gains leave "
        f"an error of {error}. If the two errors differ, each pulse of the model, however short, transforms a part of "
        "the wire, and nothing transforms back after it. A real wire does not do that: in this case tune without "
        "controller.carrier."
    )


def _margin_warning(doc: Mapping[str, Any]) -> str:
    """A sentence about small margins; those of an unstable loop are among the problems."""
    gain, phase = (doc["margins"]["tuned"][k] for k in ("gain", "phase"))
    is_unstable = (gain is not None and gain < 1.0) or (phase is not None and phase < 0.0)
    is_small = (gain is not None and gain < _MIN_GAIN_MARGIN) or (phase is not None and phase < _MIN_PHASE_MARGIN)
    if is_unstable or not is_small:
        return ""
    return (
        f" Linearised along its rollout, the loop has {margin_words(gain, phase)}: a rig that differs slightly "
        f"may oscillate, so {stabilising_advice(doc['objective']['settle'])}."
    )


def _filter_words(doc: Mapping[str, Any]) -> str:
    words = ""
    if "believes" in doc:
        words += f" The controller uses the estimate of a filter that measures {' and '.join(doc['believes'])}: "
        words += f"the margins are those of a loop that measures {doc['channel']} exactly."
        if not doc["robust"]:
            words += " The filter and this rollout use the same plant, that of the rig file: [robust] varies the plant."
    if doc.get("start_kept"):
        words += " The search found no gains that are better on the draws than the start gains, which are kept: "
        words += "try more starts, or more draws."
    return words


def _draw_words(doc: Mapping[str, Any]) -> str:
    if not doc["robust"]:
        return ""
    checks = doc["robust"]["tuned"]
    words = f" Of {checks['draws']} draws of the uncertain parameters, {checks['unstable']} are unstable and "
    words += f"{checks['beyond_a_limit']} beyond a limit."
    margins = margin_words(checks["worst_margins"]["gain"], checks["worst_margins"]["phase"])
    return words + (f" Linearised, the worst of the {checks['draws']} draws has {margins}." if margins else "")


def margin_words(gain: float | None, phase: float | None) -> str:
    """Format margins in words; ``None`` and infinity are left out.

    Args:
        gain: Gain margin, a factor.
        phase: Phase margin, degrees.
    """
    words = {"a gain margin of {:.2g}": gain, "a phase margin of {:.2g} degrees": phase}
    return " and ".join(
        text.format(value) for text, value in words.items() if value is not None and math.isfinite(value)
    )


def stabilising_advice(settle: bool) -> str:
    """Return the advice for an unstable or nearly unstable loop; ``settle`` is whether it was tuned for settling."""
    return "tune for tracking, with an effort weight, instead of settling" if settle else "raise the effort weight"


def _bound_words(gains: Mapping[str, Any]) -> str:
    """Sentences about gains at a bound."""
    free = {name: entry for name, entry in gains.items() if entry["free"] and entry["bounds"][0] < entry["bounds"][1]}
    share = {
        n: math.log(e["tuned"] / e["bounds"][0]) / math.log(e["bounds"][1] / e["bounds"][0]) for n, e in free.items()
    }
    ends = {
        "smallest": [n for n, s in share.items() if s < _AT_BOUND],
        "largest": [n for n, s in share.items() if s > 1.0 - _AT_BOUND],
    }
    return "".join(
        f" The search ended with the {end} {' and '.join(names)} that tune.bounds allows."
        for end, names in ends.items()
        if names
    )


def gain_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows of gains: name, start, tuned, and their unit, which follows the usual unit of the channel."""
    rows = []
    for name, entry in doc["gains"].items():
        unit = entry.get("usual_unit", entry["unit"])
        start, tuned = (f"{from_si(entry[when], unit, entry['unit']):.5g}" for when in ("start", "tuned"))
        rows.append((name, start, tuned if entry["free"] else f"{tuned} (fixed)", unit))
    return rows


def metric_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows of metrics and margins: name, start, tuned, range of the draws, and the worst case."""
    rows = []
    for name, label in LABELS.items():
        if name not in doc["metrics"]["tuned"]:
            continue
        row = [label, *(format_entry(doc, doc["metrics"][when][name], name) for when in ("start", "tuned"))]
        if doc["robust"]:
            low, _, high = doc["robust"]["tuned"]["spread"][name]
            row.append(f"{format_entry(doc, low, name)} .. {format_entry(doc, high, name)}")
        if doc.get("case_check"):
            row.append(worst_cell(doc, name))
        rows.append(tuple(row))
    for name, label in _MARGIN_LABELS.items():
        cells = [doc["margins"][when][name] for when in ("start", "tuned")]
        row = [label, *("-" if v is None else f"{v:.3g}" for v in cells)]
        if doc["robust"]:
            worst = doc["robust"]["tuned"]["worst_margins"][name]
            row.append("-" if worst is None else f"{worst:.3g} at worst")
        rows.append(tuple(row))
    return padded([*rows, *low_margin_rows(doc, _MARGIN_LABELS)], len(stage_head(doc)))


def stage_head(doc: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the head of the table of metrics."""
    head = ("", "start", "tuned", "5 to 95 % of draws") if doc["robust"] else ("", "start", "tuned")
    return (*head, f"worst of {doc['case_check']['cases']}") if doc.get("case_check") else head


def left_out_lines(doc: Mapping[str, Any]) -> list[str]:
    """Return lines about files that were not written, with the reason."""
    reasons: dict[str, list[str]] = {}
    for name, reason in doc.get("left_out", {}).items():
        reasons.setdefault(reason, []).append(name)
    return [f"Left out: {' and '.join(names)}: {reason}" for reason, names in reasons.items()]


def text(doc: Mapping[str, Any], folder: str = "") -> str:
    """Format the summary of a tuning for a terminal.

    Args:
        doc: The document tune.json.
        folder: The result folder, which the last line names; empty for none.
    """
    lines = [*table([("gain", "start", "tuned", "unit"), *gain_rows(doc)], right=(1, 2)), ""]
    lines += [*table([stage_head(doc), *metric_rows(doc)], right=(1, 2, 3, 4)), ""]
    if jumps := jump_rows(doc):
        lines += [*table([jump_head(doc), *jumps], right=(2, 3, 4)), further_jumps(doc)]
    lines += [doc["summary"]]
    files = [name for name in _EXPORTS if name not in doc.get("left_out", {})]
    lines += left_out_lines(doc)
    place = [f"Report, {', '.join(files[:-1])} and {files[-1]} in {folder}"] if folder else []
    return "\n".join([*lines, *explained(tuning_topics(doc)), *place])


def tuning_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a tuning.

    Args:
        doc: The document tune.json.
        series: Rollouts with start and tuned gains.
        run: The document run.json.
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    sections = [pages.verdict_section([doc["summary"]], bad=bool(doc["problems"])), "<h2>Gains</h2>"]
    sections.append(pages.table(("gain", "start", "tuned", "unit"), gain_rows(doc), numbers=(1, 2)))
    sections += ["<h2>Metrics and margins</h2>", pages.table(stage_head(doc), metric_rows(doc), numbers=(1, 2, 3, 4))]
    sections.append(
        "<p>Margins are those of the loop linearised along the rollout without noise; for a nonlinear plant, medians "
        "over it, and the values that a twentieth of its operating points exceeds or falls short of.</p>"
    )
    if jumps := jump_rows(doc):
        sections += ["<h2>Jumps of the reference</h2>", pages.table(jump_head(doc), jumps, numbers=(2, 3, 4))]
        sections.append(f"<p>{further_jumps(doc)}</p>" if further_jumps(doc) else "")
    sections.append(pages.add_picture(response_picture(series, doc["channel"]), pictures))
    sections += [f"<p>{escape(line)}.</p>" for line in left_out_lines(doc)]
    sections.append(pages.topics_section(tuning_topics(doc)))
    sections += pages.provenance_sections(run, rig)
    lead = f"Controller of {doc['channel']}, tuned on simulations of its closed loop."
    return pages.render_page(f"Tuning on {doc['rig']}", lead, sections, pictures)
