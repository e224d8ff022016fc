"""``diagnosis.json`` (schema ``smajax.diagnosis/1``), its summary in words, and its page.

RMSEs and noise stand in the unit of the recording's column, strengths in the unit of the effect; what does not exist is ``null``.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax import __version__
from smajax.diagnose.effects import catalogue
from smajax.diagnose.preflight import Sight
from smajax.diagnose.residual import Look
from smajax.diagnose.tracer import AT_NOISE
from smajax.diagnose.verdict import PARTS, Diagnosis
from smajax.parameters import declarations
from smajax.recording import Recording
from smajax.report import html, plots
from smajax.report.document import difference_unit, number, recording_entry
from smajax.report.plots import Picture
from smajax.report.prediction import Series

SCHEMA = "smajax.diagnosis/1"
NEXT_INPUT = "next_input.csv"


def diagnosis_document(
    found: Diagnosis,
    recordings: Sequence[Recording],
    *,
    evidence: Sequence[str],
    left_out: Mapping[str, str],
    misplaced: Mapping[str, str],
    simulations: int,
    wall: float,
    seed: int,
) -> dict[str, Any]:
    """The document of a diagnosis of three recordings, for training, selection and holdout; it takes the first one's units.

    ``evidence`` are channels not observed; ``left_out`` says of channels that were done without, why, and ``misplaced`` of effects in the
    rig file.
    """
    recording = recordings[0]
    rmse, floor = {}, {}
    for channel, values in found.rmse.items():
        unit, factor = difference_unit(recording, channel)
        rmse[channel] = {"unit": unit} | {key: number(value, factor) for key, value in values.items()}
        rmse[channel]["holdout_cut_95"] = [number(end, factor) for end in found.cut95[channel]]
        value, source = found.noise[channel]
        floor[channel] = {"value": number(value, factor), "unit": unit, "from": source}
    values = found.after.values
    scale = difference_unit(recording, next(iter(found.rmse)))[1]
    ranking = []
    for one in found.ranking:
        seen, strength, low, high = one.sight, one.strength, one.lower95, one.upper95
        name = f"effects.{seen.key}.strength"
        if seen.key in found.effects:
            strength = values[name]
            low, high = found.intervals.get(name, (None, None))
        ranking.append(
            _sight(seen)
            | {
                "strength": number(strength), "lower95": number(low), "upper95": number(high), "statistic": number(one.gain),
                "p_value": number(one.p_value), "refit_rmse_select": number(one.refit_rmse_select, scale),
            }
        )  # fmt: skip
    ranking.sort(key=lambda r: (r["key"] not in found.effects, -(r["statistic"] or -1.0)))
    before, after, limit = found.fitness
    document = {
        "schema": SCHEMA,
        "verdict": found.verdict,
        "effects": list(found.effects),
        "equivalent": {key: list(keys) for key, keys in found.equivalent.items()},
        "unresolved_stage": found.unresolved_stage,
        "summary": "",
        "rmse": rmse,
        "evidence": list(evidence),
        "recordings": [recording_entry(one, part) for one, part in zip(recordings, PARTS, strict=True)],
        "left_out": [
            *({"channel": channel, "why": why} for channel, why in left_out.items()),
            *({"effect": key, "why": why} for key, why in misplaced.items()),
        ],
        "noise_floor": floor,
        "base_fit_at_rest": found.rests,
        "goodness_of_fit": {"before": number(before), "after": number(after), "critical": number(limit)},
        "stages": {stage: number(share) for stage, share in found.stages.items()},
        "ranking": ranking,
        "rejected": [{"key": key, "why": why} for key, why in found.rejected],
        "excluded": [{"key": one.key, "above": number(one.smallest), "unit": one.unit} for one in found.excluded],
        "preflight": [_sight(one) for one in found.preflight],
        "residual": {
            channel: {when: _look(looks[channel], difference_unit(recording, channel)[1]) for when, looks in found.looks.items()}
            for channel in found.rmse
        },
        "free_form": _free_form(found),
        "next_experiment": _next(found),
        "simulations": simulations,
        "wall_s": round(wall, 2),
        "seed": seed,
        "smajax": __version__,
    }
    document["summary"] = " ".join(sentences(document))
    return document


def _sight(one: Sight) -> dict[str, Any]:
    return {
        "key": one.key, "stage": one.stage, "status": one.status, "smallest_detectable": number(one.smallest), "unit": one.unit,
        "absorbed_by": list(one.absorbed_by), "why": one.why,
    }  # fmt: skip


def _look(one: Look, factor: float) -> dict[str, Any]:
    cross = {name: [number(float(v)) for v in values] for name, values in one.cross.items()}
    return {
        "rms": number(one.rms, factor), "band_99": number(one.band), "autocorrelation": [number(float(v)) for v in one.autocorrelation],
        "cross_correlation": cross, "outside": {name: number(share) for name, share in one.outside.items()},
    }  # fmt: skip


def _free_form(found: Diagnosis) -> dict[str, Any] | None:
    if found.shape is None:
        return None
    shape = found.shape
    explained = 1.0 - max(shape.train - 1.0, 0.0) / max(shape.before - 1.0, 1e-9)
    return {
        "stage": shape.stage, "adds": shape.kind.removeprefix("free-"), "unit": shape.unit, "against": shape.against,
        "at": [number(float(v)) for v in shape.at], "term": [number(float(v)) for v in shape.term],
        "explains": number(max(0.0, explained)), "select_error_over_noise": number(shape.select**0.5),
        "note": "a description of what is missing, not its cause",
    }  # fmt: skip


def _next(found: Diagnosis) -> dict[str, Any] | None:
    if found.next is None:
        return None
    file = NEXT_INPUT if found.next.recording else None
    return {"file": file, "separates": list(found.next.separates), "sigma": number(found.next.sigma), "advice": found.next.advice}


def sentences(doc: Mapping[str, Any]) -> list[str]:
    """What was found, in words that one can act on."""
    told = []
    for key in doc["effects"]:
        entry = next(r for r in doc["ranking"] if r["key"] == key)
        span = f" (95 %: {entry['lower95']:.3g} to {entry['upper95']:.3g})" if entry["lower95"] is not None else ""
        unit = "" if entry["unit"] == "1" else f" {entry['unit']}"
        meaning = declarations(catalogue()[key])["strength"].meaning
        told.append(f"The rig has {key} of {entry['strength']:.3g}{unit}{span}, an effect of the {entry['stage']} stage: {meaning}.")
        if doc["equivalent"].get(key):
            told.append(f"These recordings cannot tell it from {', '.join(doc['equivalent'][key])}.")
    stage = doc["unresolved_stage"]
    if doc["verdict"] == "nothing-missing":
        little = "; ".join(f"{entry['key']} {entry['why']}" for entry in doc["rejected"])
        beside = f"a little of something may be ({little})" if little else "nothing is missing that they could show"
        told.append(f"The model explains the recordings down to their noise: {beside}.")
    elif doc["verdict"] == "partial" and doc["goodness_of_fit"]["after"] < max(doc["goodness_of_fit"]["critical"], AT_NOISE):
        told.append(f"It does not predict another input down to the noise: it may stand in for something else in the {stage} stage.")
    elif doc["verdict"] == "partial":
        told.append(f"That is not all: more than noise is left, and it looks most like something in the {stage} stage.")
    elif doc["verdict"] == "unresolved" and stage is None:
        told.append("Something is missing that only the other recordings show: their inputs do what the training recording's does not.")
    elif doc["verdict"] == "unresolved":
        told.append(f"Something is missing that no effect of the catalogue explains; the residual looks most like the {stage} stage.")
    if not doc.get("base_fit_at_rest", True):
        told.append("Without effects the fit does not come to rest, so that the errors before are only where it stopped.")
    for channel, rmse in doc["rmse"].items():
        floor = doc["noise_floor"][channel]["value"]
        beside = ", recorded and not observed," if channel in doc.get("evidence", ()) else ""
        told.append(
            f"On the holdout the error of {channel}{beside} is {_shown(rmse['holdout_before'], 3)} {rmse['unit']} before and "
            f"{_shown(rmse['holdout_after'], 3)} {rmse['unit']} after, with noise of {floor:.3g} {rmse['unit']}."
        )
    for entry in doc.get("left_out", ()):
        what = entry.get("channel") or f"{entry['effect']} of the rig file, which this rig cannot have"
        told.append(f"Done without {what}: {entry['why']}.")
    told += [f"{entry['name']}: {note}." for entry in doc.get("recordings", ()) for note in entry["notes"]]
    if doc["free_form"]:
        form = doc["free_form"]
        told.append(
            f"A free term in the {form['stage']} stage, {form['adds']} as a function of {form['against']}, would explain "
            f"{100 * form['explains']:.0f} % of what is left; it describes, and names no cause."
        )
    if doc["next_experiment"] and doc["next_experiment"]["separates"]:
        planned = doc["next_experiment"]
        told.append(f"Next, run {planned['file']}: {planned['advice']}." if planned["file"] else f"Next: {planned['advice']}.")
    return told


def text(doc: Mapping[str, Any], folder: str) -> str:
    """The summary for a terminal."""
    lines = [f"Verdict: {doc['verdict']}", "", *sentences(doc), ""]
    lines += [f"Left out: {entry['key']}: {entry['why']}" for entry in doc["rejected"]]
    lines.append(f"{doc['simulations']:,} simulations in {doc['wall_s']:.1f} s; all of it in {folder}")
    return "\n".join(lines)


def diagnosis_page(doc: Mapping[str, Any], series: Sequence[Series], inputs: Sequence[str], run: Mapping[str, Any], rig: str) -> str:
    """The page: ``series`` are the predictions before and after, ``inputs`` the driving channels."""
    pictures: list[Picture] = []
    floor = {channel: entry["value"] for channel, entry in doc["noise_floor"].items()}
    bad = doc["verdict"] in ("partial", "unresolved")
    said = "".join(f"<p>{html.escape(s)}</p>" for s in sentences(doc))
    sections = [f'<div class="verdict{" bad" if bad else ""}">{said}</div>', "<h2>Error before and after</h2>"]
    rows = [
        (channel, part, _shown(rmse[f"{part}_before"], 4), _shown(rmse[f"{part}_after"], 4), _shown(floor[channel], 4), rmse["unit"])
        for channel, rmse in doc["rmse"].items()
        for part in PARTS
    ]  # fmt: skip
    sections.append(html.table(("channel", "recording", "before", "after", "noise", "unit"), rows, numbers=(2, 3, 4)))
    sections.append("<h2>What is left on the training recording</h2>")
    heard = [
        (channel, when, name, _shown(look["rms"], 4), f"{100 * share:.0f} %")
        for channel, looks in doc["residual"].items()
        for when, look in looks.items()
        for name, share in look["outside"].items()
    ]
    sections.append(html.table(("channel", "fit", "correlated with", "RMS", "lags beyond 99 %"), heard, numbers=(3, 4)))
    for channel, looks in doc["residual"].items():
        sections.append(html.draw(plots.whiteness_picture(channel, looks), pictures))
    sections.append("<h2>Share of the residual that can live in each stage</h2>")
    sections.append(html.table(("stage", "share"), [(s, f"{100 * v:.0f} %") for s, v in doc["stages"].items()], numbers=(1,)))
    if doc["free_form"]:
        sections.append(html.draw(plots.free_form_picture(doc["free_form"]), pictures))
    sections += ["<h2>Effects</h2>", html.table(_HEAD, [_row(r) for r in doc["ranking"]], numbers=(3, 5, 6))]
    if doc["rejected"]:
        sections.append(html.table(("left out", "because"), [(r["key"], r["why"]) for r in doc["rejected"]]))
    if doc["excluded"]:
        limits = [(e["key"], f"{e['above']:.3g}", html.pretty_unit(e["unit"])) for e in doc["excluded"]]
        sections += ["<h2>Excluded down to this size</h2>", html.table(("effect", "above", "unit"), limits, numbers=(1,))]
    before = [
        (s["key"], s["status"], _shown(s["smallest_detectable"]), html.pretty_unit(s["unit"]), ", ".join(s["absorbed_by"]) or s["why"])
        for s in doc["preflight"]
    ]
    sections += ["<h2>What this input can show, before any fit</h2>"]
    sections.append(html.table(("effect", "status", "detectable from", "unit", "absorbed by, or why not"), before, numbers=(2,)))
    sections.append("<h2>Measured against model</h2>")
    for one in series:
        sections.append(html.draw(plots.time_picture(one, list(doc["rmse"]), inputs, floor), pictures))
    sections += ["<h2>Where this comes from</h2>", html.provenance(run), html.rig_text(rig)]
    lead = f"What {', '.join(dict.fromkeys(s.name.removesuffix(' (before)').removesuffix(' (after)') for s in series))} say of the rig."
    return html.page(f"Diagnosis: {doc['verdict']}", lead, sections, pictures)


def _shown(value: float | None, digits: int = 3) -> str:
    return "-" if value is None else f"{value:.{digits}g}"


_HEAD = ("effect", "stage", "status", "strength ± 95 %", "unit", "error after refit", "detectable from", "absorbed by, or why not")


def _row(entry: Mapping[str, Any]) -> tuple[str, ...]:
    strength = _shown(entry["strength"])
    if entry["lower95"] is not None:
        strength += f" ± {0.5 * (entry['upper95'] - entry['lower95']):.2g}"
    shown = [_shown(entry[k]) for k in ("refit_rmse_select", "smallest_detectable")]
    reason = ", ".join(entry["absorbed_by"]) or entry["why"]
    return (entry["key"], entry["stage"], entry["status"], strength, html.pretty_unit(entry["unit"]), *shown, reason)
