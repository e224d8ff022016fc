"""What ``smajax tune`` prints and shows: gains, what they do, and what they did before."""

import math
from collections.abc import Mapping, Sequence
from typing import Any

from smajax.report import html, plots
from smajax.report.prediction import Series, usual_unit
from smajax.report.summary import table
from smajax.units import CHANNELS, from_si

SCHEMA = "smajax.tune/1"
_AT = 1e-3  # of the way from one bound to the other
_GAIN, _PHASE = 1.5, 20.0  # margins (degrees) below which a warning is due
_METRICS = {
    "rmse": "RMSE", "max_error": "largest error", "itae": "ITAE", "rise": "rise 10 to 90 %", "settling": "settling",
    "overshoot": "overshoot", "energy": "energy", "mean_command": "mean command",
    "peak_temperature": "hottest", "peak_stress": "largest stress",
    "peak_current": "largest current",
}  # fmt: skip


def shown(value: float | None, name: str, channel: str) -> str:
    """A metric in a usual unit; ``-`` where it has none, as the settling of what never settles."""
    if value is None or not math.isfinite(value):
        return "-"
    if name in ("rmse", "max_error", "itae", channel):
        unit = usual_unit(channel)
        number = from_si(value, unit, CHANNELS[channel].unit) if unit != "degC" else value
        unit = "K" if unit == "degC" and name != channel else unit  # a difference
        return f"{number:.4g} {unit}" + (" s\N{SUPERSCRIPT TWO}" if name == "itae" else "")
    if name == "overshoot":
        return f"{100 * value:.2f} %"
    if name == "peak_stress":
        return f"{value / 1e6:.4g} MPa"
    unit = {"rise": "s", "settling": "s", "energy": "J", "peak_temperature": "degC", "peak_current": "A"}.get(name, "")
    return f"{value:.4g} {unit}".strip()


def sentences(doc: Mapping[str, Any]) -> str:
    """What came of it, in words."""
    channel, before, after = doc["channel"], doc["metrics"]["start"], doc["metrics"]["tuned"]
    key = "settling" if doc["objective"]["settle"] else "rmse"
    told = f"{_METRICS[key]} of {channel}: {shown(before[key], key, channel)} with the start gains, {shown(after[key], key, channel)} with "
    told += f"the tuned ones, found in {doc['rollouts']:,} rollouts."
    if "feedforward" in doc:
        fed = doc["feedforward"]
        ends = " to ".join(f"{end:.3g}" for end in fed["command"])
        misfit, share = shown(fed["misfit"], "rmse", channel), 100.0 * fed["misfit"] / fed["stroke"]
        told += f" The feedforward's operator of {fed['operators']} plays was fitted to a slow loop of {ends} {fed['command_unit']}"
        told += f" ({fed['loop']}, {fed['seconds']:.0f} s) with a misfit of {misfit} RMSE,"
        told += f" {share:.1f} % of its stroke."
    if "pulses" in doc:
        pulses = doc["pulses"]
        told += f" The command is pulsed at {pulses['carrier']:g} Hz: with the mean of its pulses the same gains would leave an error of"
        told += f" {shown(pulses['rmse_of_mean'], 'rmse', channel)}. Where the two differ, the law transforms some of the wire with every"
        told += " pulse, however short, and nothing back after it, which real wires do not: then tune without controller.carrier."
    if "asked" in doc["objective"]:
        weight = doc["objective"]["weights"]["effort"]
        told += f" With the weights as they were given the gains would not let the loop come to rest: effort counts {weight:g} here."
    if doc["problems"]:
        told += " But " + "; ".join(doc["problems"]) + "."
    gain, phase = (doc["margins"]["tuned"][k] for k in ("gain", "phase"))
    none = (gain is not None and gain < 1.0) or (phase is not None and phase < 0.0)  # which is a problem, and told as one
    if not none and ((gain is not None and gain < _GAIN) or (phase is not None and phase < _PHASE)):
        told += f" Linearised along its rollout, the loop has {margin_words(gain, phase)}: a rig that is a little different may swing, so "
        told += calmer(doc["objective"]["settle"]) + "."
    told += _at_bounds(doc.get("gains", {}))
    if "believes" in doc:
        told += f" The controller goes by a filter that hears {' and '.join(doc['believes'])}: the margins are those of a loop that hears"
        told += f" {channel} as it is."
        if not doc["robust"]:
            told += " The filter's plant is that of the rig file, and so is this rollout's: [robust] tries it on others."
    if doc.get("start_kept"):
        told += " Of the gains found none does better on the draws than the start gains, which are kept: try more starts, or more draws."
    if doc["robust"]:
        one = doc["robust"]["tuned"]
        told += f" Of {one['draws']} draws of what is not known, {one['unstable']} are unstable and {one['beyond_a_limit']} beyond a limit."
        margin = one["worst_margins"]
        have = margin_words(margin["gain"], margin["phase"])
        told += f" Linearised, the worst of the {one['draws']} draws has {have}." if have else ""
    return told


def margin_words(gain: float | None, phase: float | None) -> str:
    """Margins (a factor; degrees) in words; ``None`` and infinity: there is none."""
    words = {"a gain margin of {:.2g}": gain, "a phase margin of {:.2g} degrees": phase}
    return " and ".join(told.format(value) for told, value in words.items() if value is not None and math.isfinite(value))


def calmer(settle: bool) -> str:
    """What to do about gains that are near swinging."""
    return "ask for tracking, with a weight of effort, instead of settling" if settle else "give effort more weight"


def _at_bounds(gains: Mapping[str, Any]) -> str:
    """Which gains ended where they may go no further."""
    free = {name: entry for name, entry in gains.items() if entry["free"] and entry["bounds"][0] < entry["bounds"][1]}
    place = {n: math.log(e["tuned"] / e["bounds"][0]) / math.log(e["bounds"][1] / e["bounds"][0]) for n, e in free.items()}
    ends = {"smallest": [n for n, at in place.items() if at < _AT], "largest": [n for n, at in place.items() if at > 1.0 - _AT]}
    return "".join(
        f" The search ended with the {end} {' and '.join(names)} that tune.bounds allows." for end, names in ends.items() if names
    )


def gain_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Name, start, tuned, and the unit of both, which goes with the channel's usual one."""
    rows = []
    for name, entry in doc["gains"].items():
        unit = entry.get("usual_unit", entry["unit"])
        start, tuned = (f"{from_si(entry[when], unit, entry['unit']):.5g}" for when in ("start", "tuned"))
        rows.append((name, start, tuned if entry["free"] else f"{tuned} (held)", unit))
    return rows


def metric_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Metric, start, tuned, and where there are draws, 5 to 95 % of the tuned ones."""
    rows, channel = [], doc["channel"]
    for name, label in _METRICS.items():
        if name not in doc["metrics"]["tuned"]:
            continue
        row = [label, *(shown(doc["metrics"][when][name], name, channel) for when in ("start", "tuned"))]
        if doc["robust"]:
            low, _, high = doc["robust"]["tuned"]["spread"][name]
            row.append(f"{shown(low, name, channel)} .. {shown(high, name, channel)}")
        rows.append(tuple(row))
    for name, label in (("gain", "gain margin"), ("phase", "phase margin [deg]"), ("sensitivity", "largest sensitivity")):
        cells = [doc["margins"][when][name] for when in ("start", "tuned")]
        row = [label, *("-" if v is None else f"{v:.3g}" for v in cells)]
        if doc["robust"]:
            least = doc["robust"]["tuned"]["worst_margins"][name]
            row.append("-" if least is None else f"{least:.3g} at worst")
        rows.append(tuple(row))
    return rows


def _head(doc: Mapping[str, Any]) -> tuple[str, ...]:
    return ("", "start", "tuned", "5 to 95 % of draws") if doc["robust"] else ("", "start", "tuned")


def left_out(doc: Mapping[str, Any]) -> list[str]:
    """The files that could not be written, and why."""
    reasons: dict[str, list[str]] = {}
    for name, why in doc.get("left_out", {}).items():
        reasons.setdefault(why, []).append(name)
    return [f"Left out: {' and '.join(names)}: {why}" for why, names in reasons.items()]


def text(doc: Mapping[str, Any], folder: str) -> str:
    """What the command prints."""
    lines = [*table([("gain", "start", "tuned", "unit"), *gain_rows(doc)], right=(1, 2)), ""]
    lines += [*table([_head(doc), *metric_rows(doc)], right=(1, 2, 3)), "", doc["summary"]]
    every = ("controller.h", "controller.json", "plant.fmu", "controller.fmu")
    files = [name for name in every if name not in doc.get("left_out", {})]
    lines += left_out(doc)
    return "\n".join([*lines, f"Report, {', '.join(files[:-1])} and {files[-1]} in {folder}"])


def tuning_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """The page: ``doc`` is tune.json, ``series`` the rollouts with start and tuned gains, ``run`` run.json, ``rig`` the rig's text."""
    pictures: list[plots.Picture] = []
    bad = ' bad"' if doc["problems"] else '"'
    sections = [f'<div class="verdict{bad}><p>{html.escape(doc["summary"])}</p></div>', "<h2>Gains</h2>"]
    sections.append(html.table(("gain", "start", "tuned", "unit"), gain_rows(doc), numbers=(1, 2)))
    sections += ["<h2>What they do</h2>", html.table(_head(doc), metric_rows(doc), numbers=(1, 2, 3))]
    sections.append(
        "<p>Margins are those of the loop linearised along the rollout, medians over its samples where the plant is not linear.</p>"
    )
    sections.append(html.draw(plots.response_picture(series, doc["channel"]), pictures))
    sections += [f"<p>{html.escape(line)}.</p>" for line in left_out(doc)]
    sections += ["<h2>Where this comes from</h2>", html.provenance(run), html.rig_text(rig)]
    return html.page(f"Tuning on {doc['rig']}", f"A controller of {doc['channel']}, tuned through its closed loop.", sections, pictures)
