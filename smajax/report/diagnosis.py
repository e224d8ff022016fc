"""``diagnosis.json`` (schema ``smajax.diagnosis/1``), its summary in words, and its page.

RMSEs and noise stand in the unit of the recording's column, strengths in the unit of the effect; what does not exist is ``null``.
"""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax import __version__
from smajax.diagnose.effects import catalogue
from smajax.diagnose.trace import Diagnosis
from smajax.recording import Recording
from smajax.report import html, plots
from smajax.report.document import difference_unit, number
from smajax.report.plots import Picture
from smajax.report.prediction import Series

SCHEMA = "smajax.diagnosis/1"
PARTS = ("train", "select", "holdout")


def diagnosis_document(found: Diagnosis, recording: Recording, *, simulations: int, wall: float, seed: int) -> dict[str, Any]:
    """The document of a diagnosis; ``recording`` is the training one, whose units it takes."""
    rmse, floor = {}, {}
    for channel, values in found.rmse.items():
        unit, factor = difference_unit(recording, channel)
        rmse[channel] = {"unit": unit} | {key: number(value, factor) for key, value in values.items()}
        rmse[channel]["holdout_cut_95"] = [number(end, factor) for end in found.cut95[channel]]
        floor[channel] = {"value": number(found.noise[channel], factor), "unit": unit, "from": "residual differences"}
    values = found.after.values
    scale = difference_unit(recording, next(iter(found.rmse)))[1]
    ranking = []
    for one in found.ranking:
        strength, low, high = one.strength, one.lower95, one.upper95
        name = f"effects.{one.key}.strength"
        if one.key in found.effects:
            strength = values[name]
            low, high = found.intervals.get(name, (None, None))
        ranking.append(
            {
                "key": one.key, "stage": one.stage, "status": one.status, "strength": number(strength), "lower95": number(low),
                "upper95": number(high), "unit": one.unit, "statistic": number(one.gain), "p_value": number(one.p_value),
                "refit_rmse_select": number(one.refit_rmse_select, scale),
                "smallest_detectable": number(one.smallest), "absorbed_by": list(one.absorbed_by) if one.status == "absorbed" else [],
                "why": one.absorbed_by[0] if one.status == "blind" and one.absorbed_by else "",
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
        "noise_floor": floor,
        "goodness_of_fit": {"before": number(before), "after": number(after), "critical": number(limit)},
        "stages": {stage: number(share) for stage, share in found.stages.items()},
        "ranking": ranking,
        "rejected": [{"key": key, "why": why} for key, why in found.rejected],
        "excluded": [
            {"key": r["key"], "above": r["smallest_detectable"], "unit": r["unit"]}
            for r in ranking
            if found.verdict == "nothing-missing" and r["status"] == "testable" and r["smallest_detectable"] is not None
        ],
        "next_experiment": None,
        "simulations": simulations,
        "wall_s": round(wall, 2),
        "seed": seed,
        "smajax": __version__,
    }
    document["summary"] = " ".join(sentences(document))
    return document


def sentences(doc: Mapping[str, Any]) -> list[str]:
    """What was found, in words that one can act on."""
    told = []
    for key in doc["effects"]:
        entry = next(r for r in doc["ranking"] if r["key"] == key)
        span = f" (95 %: {entry['lower95']:.3g} to {entry['upper95']:.3g})" if entry["lower95"] is not None else ""
        told.append(f"The rig has {key} of {entry['strength']:.3g} {entry['unit']}{span}, an effect of the {entry['stage']} stage.")
        if doc["equivalent"].get(key):
            told.append(f"These recordings cannot tell it from {', '.join(doc['equivalent'][key])}.")
    stage = doc["unresolved_stage"]
    if doc["verdict"] == "nothing-missing":
        told.append("The model explains the recordings down to their noise: nothing is missing that they could show.")
    elif doc["verdict"] == "partial":
        told.append(f"That is not all: more than noise is left, and it looks most like something in the {stage} stage.")
    elif doc["verdict"] == "unresolved":
        told.append(f"Something is missing that no effect of the catalogue explains; the residual looks most like the {stage} stage.")
    for channel, rmse in doc["rmse"].items():
        floor = doc["noise_floor"][channel]["value"]
        told.append(
            f"On the holdout the error of {channel} is {rmse['holdout_before']:.3g} {rmse['unit']} before and "
            f"{rmse['holdout_after']:.3g} {rmse['unit']} after, with noise of {floor:.3g} {rmse['unit']}."
        )
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
        (channel, part, _four(rmse[f"{part}_before"]), _four(rmse[f"{part}_after"]), _four(floor[channel]), rmse["unit"])
        for channel, rmse in doc["rmse"].items()
        for part in PARTS
    ]  # fmt: skip
    sections.append(html.table(("channel", "recording", "before", "after", "noise", "unit"), rows, numbers=(2, 3, 4)))
    sections.append("<h2>Share of the residual that each stage could explain</h2>")
    sections.append(html.table(("stage", "share"), [(s, f"{100 * v:.0f} %") for s, v in doc["stages"].items()], numbers=(1,)))
    sections += ["<h2>Effects</h2>", html.table(_HEAD, [_row(r) for r in doc["ranking"]], numbers=(3, 4, 5, 6))]
    sections.append("<h2>Measured against model</h2>")
    for one in series:
        sections.append(html.draw(plots.time_picture(one, list(doc["rmse"]), inputs, floor), pictures))
    sections += ["<h2>Where this comes from</h2>", html.provenance(run), html.rig_text(rig)]
    return html.page(f"Diagnosis: {doc['verdict']}", doc["summary"], sections, pictures)


def _four(value: float | None) -> str:
    return "-" if value is None else f"{value:.4g}"


_HEAD = ("effect", "stage", "status", "strength", "95 % from", "to", "detectable from", "unit", "")


def _row(entry: Mapping[str, Any]) -> tuple[str, ...]:
    shown = [f"{entry[k]:.3g}" if entry[k] is not None else "-" for k in ("strength", "lower95", "upper95", "smallest_detectable")]
    absorbed = f"absorbed by {', '.join(entry['absorbed_by'])}" if entry["absorbed_by"] else entry["why"]
    return (
        entry["key"],
        entry["stage"],
        entry["status"],
        *shown,
        html.pretty_unit(entry["unit"]),
        absorbed or catalogue()[entry["key"]].source,
    )
