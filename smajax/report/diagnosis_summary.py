"""Summary of ``diagnosis.json``, schema 1 or 2, in sentences that say what to do next."""

from collections.abc import Mapping
from typing import Any

from smajax.diagnosis.candidates import AT_NOISE
from smajax.parameters import declarations
from smajax.plant.effects import catalogue
from smajax.report.documents.diagnosis import STRUCTURE_KEYS
from smajax.report.shown_values import shown_unit
from smajax.report.summary import bench_sentences
from smajax.report.topics import diagnosis_topics, explained
from smajax.units import from_si

Document = Mapping[str, Any]

# Effects with a smaller error than the one named that are explained; chosen to keep the text short.
_RIVALS = 3


def sentences(doc: Document) -> list[str]:
    """List sentences about the effects, the remaining residual, the errors, unused channels, and the next experiment.

    Args:
        doc: The document diagnosis.json.
    """
    law, lines = _law_sentences(doc), _structure_sentences(doc)
    in_structure = {key for key in doc["effects"] if lines and key in STRUCTURE_KEYS}
    lines += [sentence for key in doc["effects"] if key not in in_structure for sentence in _effect_sentences(doc, key)]
    lines = [*bench_sentences(doc), *law, *lines, *_candidate_sentences(doc)]
    if unexplained := _verdict_sentence(doc):
        lines.append(unexplained)
    if not doc.get("base_fit_at_rest", True):
        lines.append("Without effects the fit did not converge, so the errors before are those where it stopped.")
    if bounded := doc.get("rising_convection"):
        lines.append(
            f"Convection was kept from falling with the temperature ({' and '.join(bounded)} of at least 0): with the "
            "values that fit the training recording best the wire overheats under the input of another recording."
        )
    lines += rival_sentences(doc)
    lines += [f"{entry['text'][:1].upper()}{entry['text'][1:]}" for entry in doc.get("implausible", ())]
    lines += [_failure_sentence(entry) for entry in doc.get("failures", ())]
    lines += [_error_sentence(doc, channel) for channel in doc["rmse"]]
    lines += _holdout_sentences(doc)
    if doc.get("interrupted"):
        lines.append(
            "The diagnosis was stopped before its end, so that it may lack effects, the stage of the residual, or the "
            "next experiment."
        )
    for entry in doc.get("left_out", ()):
        what = entry.get("channel") or f"{entry['effect']} of the rig file, which this rig cannot have"
        lines.append(f"Not used: {what}: {entry['why']}.")
    lines += [f"{entry['name']}: {note}." for entry in doc.get("recordings", ()) for note in entry["notes"]]
    if term := doc["free_form"]:
        lines.append(
            f"A nonparametric term in the {term['stage']} stage, {term['adds']} as a function of {term['against']}, "
            f"would explain {100 * term['explains']:.0f} % of the residual; it describes what is missing, not its "
            "cause."
        )
    experiment = doc["next_experiment"]
    if experiment and experiment["separates"]:
        what = f"Next, run {experiment['file']}" if experiment["file"] else "Next"
        lines.append(f"{what}: {experiment['advice']}.")
    return lines


def text(doc: Document, folder: str = "") -> str:
    """Format the summary of a diagnosis for a terminal.

    Args:
        doc: The document diagnosis.json.
        folder: The result folder, which the last line names; empty for none.
    """
    bench = bench_sentences(doc)
    lines = [*bench, *([""] if bench else []), f"Verdict: {doc['verdict']}", "", *sentences(doc)[len(bench) :], ""]
    lines += [f"Rejected: {entry['key']}: {entry['why']}" for entry in doc["rejected"]]
    lines += [*explained(diagnosis_topics(doc))[not lines[-1] :], ""]
    place = f"; all results in {folder}" if folder else ""
    lines.append(f"{doc['simulations']:,} simulations in {doc['wall_s']:.1f} s{place}")
    return "\n".join(lines)


def significant(value: float | None, digits: int = 3) -> str:
    """Format a value; a dash for ``None``.

    Args:
        value: The value.
        digits: Number of significant digits.
    """
    return "-" if value is None else f"{value:.{digits}g}"


def usual_unit(unit: str) -> str:
    """Return the unit in which values of an internal unit are shown: mm for m, MJ/m^3 for J/m^3, none for 1."""
    return "" if unit == "1" else shown_unit(unit)


def in_usual_unit(value: float | None, unit: str, digits: int = 3) -> str:
    """Format a value in its usual unit, without the unit; a dash for ``None``.

    Args:
        value: The value in its internal unit.
        unit: The internal unit.
        digits: Number of significant digits.
    """
    shown = usual_unit(unit)
    return significant(from_si(value, shown, unit) if shown and value is not None else value, digits)


def refit_error_unit(doc: Document) -> str:
    """Return the unit of the errors after refits: that of the first channel."""
    return next(iter(doc["rmse"].values()))["unit"]


def rival_sentences(doc: Document) -> list[str]:
    """List sentences on effects that are not named although their error after a refit is smaller.

    Args:
        doc: The document diagnosis.json.
    """
    entries = {entry["key"]: entry for entry in doc["ranking"]}
    errors = {key: entry.get("refit_rmse_select") for key, entry in entries.items()}
    named = [key for key in doc["effects"] if errors.get(key) is not None]
    if not named:
        return []
    best = min(named, key=lambda key: errors[key])
    rivals = [key for key, error in errors.items() if error is not None and key not in doc["effects"]]
    rivals = sorted((key for key in rivals if errors[key] < errors[best]), key=lambda key: errors[key])
    unit = refit_error_unit(doc)
    return [
        f"{key} alone has a smaller error on the selection recording than {best} alone ({significant(errors[key])} "
        f"against {significant(errors[best])} {unit}), and is not named: {_why_not_named(doc, key, best)}."
        for key in rivals[:_RIVALS]
    ]


def _why_not_named(doc: Document, rival: str, named: str) -> str:
    """Why an effect with a smaller error after its refit is not named."""
    if any(rival in doc["equivalent"].get(key, ()) for key in doc["effects"]):
        return "these recordings do not distinguish it from an effect that is"
    rejected = next((entry["why"] for entry in doc["rejected"] if entry["key"] == rival), "")
    if rejected:
        return f"it {rejected}"
    together = f", which the named effects reduce more together than with {rival}" if len(doc["effects"]) > 1 else ""
    return f"the choice is by the error on training and selection recording together, in all channels{together}"


def _structure_sentences(doc: Document) -> list[str]:
    """Sentences about the structure of the wire; none if it needs neither cells nor grains."""
    entry = doc.get("structure")  # absent in documents of earlier versions
    if entry is None or entry["variant"] == "neither":
        return []
    parts = {
        "cells": f"cold ends (end-conduction: {entry['cells']} cells along it)",
        "grains": f"grains that transform one after the other (gradual-transformation: {entry['grains']} grains)",
    }
    found = [text for part, text in parts.items() if entry["variant"] in (part, "both")]
    errors = entry["select_error_over_noise"]
    before, after = (significant(errors[variant]) for variant in ("neither", entry["variant"]))
    fits = " in fits to training and selection recording together" if entry.get("jointly") else ""
    return [
        f"The wire has {' and '.join(found)}: the error on the selection recording falls from {before} to {after} "
        f"times the noise{fits}."
    ]


def _law_sentences(doc: Document) -> list[str]:
    """Sentences about other material laws; none where they were not compared."""
    entry = doc.get("law")  # absent in documents of earlier versions
    if entry is None:
        return []
    errors, own = entry["select_error_over_noise"], entry["own"] or "the rig's law"
    if entry["better"] is None:
        others = ", ".join(name for name in errors if name != entry["own"])
        return [f"No other material law ({others}) predicts the selection recording clearly better than {own}."]
    better, with_effects = entry["better"], significant(entry["error_with_effects_over_noise"])
    low, high = map(significant, entry["cut_95_over_noise"])
    fall = (
        f"without further effects {better} has an error of {significant(errors[better])} times the noise on the "
        f"selection recording, {own} {significant(errors[entry['own']])} (95 % interval of the fall: {low} to {high})"
    )
    return [
        {
            "law": f"The material law is wrong: {fall}. rig-law.toml has {better}: diagnose with it again.",
            "effect": f"An effect is missing, and the law is not wrong: {fall}, and with the effects below "
            f"{with_effects}.",
            "either": "The law is wrong or an effect is missing, and these recordings do not show which of the two: "
            f"{fall}, and with the effects below {with_effects}. rig-law.toml has {better}.",
            "part": f"Another law explains a small part only: {fall}.",
        }[entry["cause"]]
    ]


def _candidate_sentences(doc: Document) -> list[str]:
    """Sentences that say how much each effect explains, and which effects are candidates only."""
    lines = [
        f"{entry['key']} explains {100.0 * entry['explains']:.0f} % of the excess over the noise without it."
        for entry in doc.get("support", ())
    ]
    if candidates := doc.get("candidates", ()):
        shares = (f"{entry['key']} ({100.0 * max(entry['explains'], 0.0):.0f} %)" for entry in candidates)
        lines.append(
            f"Candidates, which explain a part of the excess and may only absorb it: {', '.join(shares)}. The "
            "diagnosed rig file does not have them."
        )
    return lines


def _effect_sentences(doc: Document, key: str) -> list[str]:
    """Sentences about an accepted effect: its size, and the effects from which it cannot be distinguished.

    Where the recordings are in doubt themselves, an effect may only absorb what is wrong with them.
    """
    entry = next(r for r in doc["ranking"] if r["key"] == key)
    size, meaning = _with_interval(entry["strength"], entry), _meaning(doc, key)
    stage = f"an effect of the {entry['stage']} stage{f': {meaning}' * bool(meaning)}"
    lines = [f"The rig has {key} of {size}, {stage}."]
    if bench_sentences(doc):
        lines = [
            f"With the recordings as they are, {key} of {size} explains the residual best, {stage}.",
            "It may be an artefact of what they show about their bench: correct that first, and diagnose again.",
        ]
    shapes = [p for p in _parameters(doc, key) if p["name"] != f"effects.{key}.strength" and p["lower95"] is not None]
    lines += [f"Its {p['name'].split('.')[2]} is {_with_interval(p['value'], p, 4)}: {p['meaning']}." for p in shapes]
    undetermined = [p["name"] for p in _parameters(doc, key) if p["lower95"] is None]
    if undetermined:
        lines.append(f"These recordings do not determine {' and '.join(undetermined)}.")
    if equivalent := doc["equivalent"].get(key):
        lines.append(f"These recordings cannot distinguish it from {', '.join(equivalent)}.")
    return lines


def _with_interval(value: float, entry: Document, digits: int = 3) -> str:
    """A value in the usual unit of an entry, and the 95 % interval of the entry if it has one."""
    shown = usual_unit(entry["unit"])
    unit = f" {shown}" * bool(shown)
    ends = (in_usual_unit(entry[end], entry["unit"], digits) for end in ("lower95", "upper95"))
    interval = f" (95 %: {' to '.join(ends)}{unit})" if entry["lower95"] is not None else ""
    return f"{in_usual_unit(value, entry['unit'], digits)}{unit}{interval}"


def _parameters(doc: Document, key: str) -> list[Document]:
    """Entries of the fitted parameters of an effect; none in documents of earlier versions."""
    return [p for p in doc.get("effect_parameters", ()) if p["name"].split(".")[1] == key]


def _meaning(doc: Document, key: str) -> str:
    """What the strength of an effect is; empty for an own effect in a document of an earlier version."""
    strengths = [p["meaning"] for p in _parameters(doc, key) if p["name"] == f"effects.{key}.strength"]
    kind = catalogue().get(key)
    return strengths[0] if strengths else declarations(kind)["strength"].meaning if kind else ""


def _holdout_sentences(doc: Document) -> list[str]:
    """Sentences about the part of the holdout in the choice of the effects; none if it had none."""
    entry = doc.get("holdout")  # absent in documents of earlier versions
    if entry is None or not entry["decided"]:
        return []
    decision = (
        f"rejected {' and '.join(entry['removed'])}, which did not reduce its error"
        if entry["removed"]
        else "decided that the effects stay, since they reduce its error"
    )
    by_half = entry.get("interval_of") == "second half"  # absent in documents of earlier versions
    part = "first half of the holdout" if by_half else "holdout"
    interval = "; the interval of their fall is of the second half, which had no part in the choice" if by_half else ""
    return [
        f"The {part} {decision}, so the errors on the holdout are after selection and may be too favourable{interval}: "
        "check them on a recording that was not used."
    ]


def _verdict_sentence(doc: Document) -> str:
    """A sentence about the remaining residual; empty if effects explain it."""
    stage, fit = doc["unresolved_stage"], doc["goodness_of_fit"]
    if doc["verdict"] == "nothing-missing":
        small = "; ".join(f"{entry['key']} {entry['why']}" for entry in doc["rejected"])
        rest = f"a small effect may be present ({small})" if small else "nothing is missing that they could show"
        return f"The model explains the recordings down to their noise: {rest}."
    if doc["verdict"] == "partial" and fit["after"] < max(fit["critical"], AT_NOISE):
        where = f"another effect in the {stage} stage" if stage else "another effect"
        return f"It does not predict another input down to the noise: the cause may be {where}."
    if doc["verdict"] == "partial" and stage is None:
        return "More than noise remains."
    if doc["verdict"] == "partial":
        return f"More than noise remains; the residual looks most like another effect in the {stage} stage."
    if doc["verdict"] == "unresolved" and (doc.get("law") or {}).get("cause") == "law":
        return ""  # the first sentence is about the law
    if doc["verdict"] == "unresolved" and stage is None and doc.get("interrupted"):
        return "Something is missing that no effect explains so far."
    if doc["verdict"] == "unresolved" and stage is None:
        return (
            "Something is missing that only the other recordings show: "
            "their inputs excite it, and the training recording's does not."
        )
    if doc["verdict"] == "unresolved":
        return (
            "Something is missing that no effect of the catalogue explains; "
            f"the residual looks most like the {stage} stage."
        )
    return ""


def _failure_sentence(entry: Document) -> str:
    """A sentence about a prediction that failed."""
    fit = "With the effects" if entry["when"] == "after" else "Without effects"
    return f"{fit} the prediction of {entry['recording']} failed: {entry['code']}: {entry['text']}."


def _error_sentence(doc: Document, channel: str) -> str:
    """A sentence about the error of a channel on the holdout."""
    rmse, floor = doc["rmse"][channel], doc["noise_floor"][channel]["value"]
    auxiliary = ", recorded and not observed," if channel in doc.get("evidence", ()) else ""
    unit = rmse["unit"]
    errors = (rmse[f"holdout_{when}"] for when in ("before", "after"))
    before, after = ("unknown" if error is None else f"{significant(error)} {unit}" for error in errors)
    return (
        f"On the holdout the error of {channel}{auxiliary} is {before} before and {after} after, "
        f"with a noise of {floor:.3g} {unit}."
    )
