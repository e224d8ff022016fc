"""A fit in words: what a person reads in ten seconds, in a terminal and at the head of the report.

Everything here is made from the document ``fit.json`` alone, so an old result folder can be summed up without its model.
"""

import math
from collections.abc import Mapping, Sequence
from textwrap import wrap
from typing import Any

from smajax.units import example_of, from_si

Document = Mapping[str, Any]

_WIDTH = 110
_AT_NOISE = 1.15
_NEAR_NOISE = 2.0
_WORSE = 1.2
_COARSE = 0.1
_UNSETTLED = ("interrupted", "steps")


def headline(doc: Document) -> str:
    """What was fitted to what, and how it ended, in one sentence."""
    solver = doc["solver"]
    trained = [r for r in doc["recordings"] if r["role"] == "train"]
    free = sum(p["free"] for p in doc["parameters"].values())
    what = f"{free} parameter{'s' * (free != 1)} of {doc['rig']} ({doc['model']})"
    data = f"{_names([r['name'] for r in trained])} ({sum(r['rows'] for r in trained):,} rows)"
    if solver["code"] == "failed":
        return f"Could not fit {what} to {data}: {solver['text']}."
    took = f"{solver['steps']} step{'s' * (solver['steps'] != 1)}, {solver['wall_s']:.1f} s"
    ended = "converged" if solver["code"] == "converged" else solver["text"]
    return f"Fitted {what} to {data}: {ended} ({took})."


def verdicts(doc: Document) -> list[str]:
    """One sentence for each observed channel: what is left over, against the noise floor and on recordings not fitted."""
    sentences = []
    for channel, rmse in doc["rmse"].items():
        floor, train, holdout = doc["noise_floor"][channel]["value"], rmse["train"], rmse["holdout"]
        if train is None or not floor:
            continue
        ratio = train / floor
        settled = doc["solver"]["code"] not in _UNSETTLED
        if ratio <= _AT_NOISE:
            text = f"The residual of {channel} is at its noise floor: the model leaves nothing of it unexplained"
        elif ratio <= _NEAR_NOISE:
            text = f"The residual of {channel} is {ratio:.2f} times its noise floor: a little is left unexplained"
        elif not settled:
            text = f"The residual of {channel} is {ratio:.3g} times its noise floor, and the fit had not settled yet"
        else:
            text = (
                f"The residual of {channel} is {ratio:.3g} times its noise floor: the model lacks something, or the minimum is a wrong one"
            )
        if holdout is not None and holdout > _WORSE * train:
            text += f"; the holdout is predicted {holdout / train:.2g} times worse than the fitted recordings"
        sentences.append(text + ".")
    return sentences


def rmse_rows(doc: Document) -> list[tuple[str, ...]]:
    """Rows ``channel, train, holdout, noise floor, train over floor`` as text; a dash where there is no number."""
    rows = []
    for channel, rmse in doc["rmse"].items():
        floor = doc["noise_floor"][channel]["value"]
        ratio = _three(rmse["train"] / floor) if floor and rmse["train"] is not None else "-"
        cells = [f"{_three(v)} {rmse['unit']}" if v is not None else "-" for v in (rmse["train"], rmse["holdout"], floor)]
        rows.append((channel, *cells, ratio))
    return rows


def parameter_rows(doc: Document) -> list[tuple[str, ...]]:
    """Rows ``name, estimate, lower95, upper95, unit, remark`` of the free parameters as text, in units that people use."""
    rows = []
    for name, entry in doc["parameters"].items():
        if entry["free"]:
            if undetermined(entry):
                estimate, _, _, unit = readable(entry["estimate"], None, None, unit=entry["unit"])
                rows.append((name, estimate, "-", "-", unit, "not determined"))
                continue
            shown = readable(entry["estimate"], entry["lower95"], entry["upper95"], unit=entry["unit"])
            rows.append((name, *shown, "at its bound" if entry["at_bound"] else ""))
    return rows


def readable(estimate: float | None, lower: float | None, upper: float | None, *, unit: str) -> tuple[str, str, str, str]:
    """An estimate and the ends of its interval as text, to two digits of the interval's half width, and the unit they are in."""
    shown = "" if unit == "1" else example_of(unit).split(maxsplit=1)[1]
    value, low, high = (None if v is None else (from_si(v, shown, unit) if shown else v) for v in (estimate, lower, upper))
    half = (high - low) / 2 if low is not None and high is not None else 0.0
    return _rounded(value, half), _rounded(low, half), _rounded(high, half), shown


def remarks(doc: Document) -> list[str]:
    """What a reader has to know beyond the numbers: what cannot be told apart, bounds, starts, steps, repairs, warnings."""
    return [
        *_unknown(doc),
        *indistinct(doc),
        *_bounds(doc),
        *_starts(doc),
        *_discretisation(doc),
        *_recordings(doc),
        *doc["warnings"],
    ]


def indistinct(doc: Document) -> list[str]:
    """In words, which parameters these recordings hardly tell apart."""
    sentences = []
    for group in doc["indistinct"]:
        names, directions, shrink = group["parameters"], group["direction"], group["shrink"] or 0.0
        if len(names) == 1:
            sentences.append(f"{names[0]} has no effect on what was observed.")
            continue
        moved = _names([f"{name} {'up' if d > 0 else 'down'}" for name, d in zip(names, directions, strict=True)])
        left = f"{100 * shrink:.2g} %" if shrink > 5e-5 else "almost nothing"
        sentences.append(f"Hard to tell apart: {moved}, moved together, leave {left} of the effect that each has alone.")
    return sentences


def text(doc: Document, folder: str = "") -> str:
    """The summary for a terminal, with no colours and no more than 120 columns where the names allow it."""
    lines = [*wrap(headline(doc), _WIDTH), ""]
    if doc["solver"]["code"] != "failed":
        lines += table([("channel", "RMSE train", "holdout", "noise floor", "train / floor"), *rmse_rows(doc)])
        lines += [*(line for s in verdicts(doc) for line in wrap(s, _WIDTH)), ""]
        rows = [(n, e, f"{low} .. {high}" if low != "-" else "none", unit, note) for n, e, low, high, unit, note in parameter_rows(doc)]
        lines += table([("parameter", "estimate", "95 % interval", "unit", ""), *rows], right=(1, 2))
    for name, profile in doc.get("profiles", {}).items():
        shown = readable(doc["parameters"][name]["estimate"], profile["lower95"], profile["upper95"], unit=doc["parameters"][name]["unit"])
        lines.append(f"Profile likelihood of {name}: {shown[1]} .. {shown[2]} {shown[3]} (95 %).")
    further = remarks(doc)
    if further:
        lines += ["", *(line for s in further for line in wrap(s, _WIDTH, initial_indent="- ", subsequent_indent="  "))]
    if folder:
        lines += ["", f"Results: {folder}"]
    return "\n".join(line.rstrip() for line in lines)


def simulation_text(run: Document, folder: str = "") -> str:
    """The summary of a simulation for a terminal; ``run`` is its run.json."""
    recording = run["recordings"][0]
    lines = [f"Simulated {recording['rows']:,} rows of {recording['name']} with {run['rig']}.", ""]
    rows = [(c, _plain(r["lowest"]), _plain(r["highest"]), r["unit"]) for c, r in run["channels"].items()]
    lines += table([("channel", "lowest", "highest", "unit"), *rows], right=(1, 2))
    lines += ["", *(f"- {recording['name']}: {note}." for note in recording["notes"]), *(f"- {one}" for one in run["warnings"])]
    lines.append(f"Results: {folder}")
    return "\n".join(line.rstrip() for line in lines)


def table(rows: Sequence[Sequence[str]], right: Sequence[int] = ()) -> list[str]:
    """Rows of cells as lines with aligned columns."""
    widths = [max(len(row[k]) for row in rows) for k in range(len(rows[0]))]

    def cell(text: str, k: int) -> str:
        return text.rjust(widths[k]) if k in right else text.ljust(widths[k])

    return ["   ".join(cell(text, k) for k, text in enumerate(row)) for row in rows]


def _three(value: float) -> str:
    """Three digits, with the zeros at the end that they have."""
    return f"{value:#.3g}".removesuffix(".")


def undetermined(entry: Mapping[str, Any]) -> bool:
    """Whether a parameter's interval is missing without a bound to blame, or wider than all that its bounds allow."""
    low, high = entry["lower95"], entry["upper95"]
    if low is None or high is None:
        return entry["free"] and not entry["at_bound"]
    lower, upper = entry.get("bounds") or (None, None)
    return lower is not None and upper is not None and high - low > upper - lower


def _plain(value: float | None) -> str:
    return "-" if value is None else f"{value:.5g}"


def _rounded(value: float | None, half: float) -> str:
    if value is None:
        return "-"
    if half <= 0:
        return f"{value:.4g}"
    place = math.floor(math.log10(half)) - 1
    size = math.floor(math.log10(abs(value))) if value else place
    if size >= 7 or (size < -4 and place < -4):
        return f"{value:.{max(size - place, 0)}e}"
    return f"{round(value, -place):.{max(-place, 0)}f}"


def _unknown(doc: Document) -> list[str]:
    if doc["solver"]["code"] == "failed":
        return []
    names = [name for name, entry in doc["parameters"].items() if undetermined(entry)]
    return [f"{name} is not determined: these recordings fit about as well with any value of it." for name in names]


def _bounds(doc: Document) -> list[str]:
    sentences = []
    for name, entry in doc["parameters"].items():
        if entry["at_bound"]:
            estimate, _, _, unit = readable(entry["estimate"], None, None, unit=entry["unit"])
            sentences.append(
                f"{name} sits on its bound, {estimate} {unit}".rstrip()
                + ", and has no interval: widen the bound under [fit] bounds if it may go further, else doubt the model."
            )
    return sentences


def _starts(doc: Document) -> list[str]:
    solver = doc["solver"]
    starts, best = solver["starts"], solver["starts_at_best"]
    if solver["code"] == "failed" or solver["code"] in _UNSETTLED:
        return []
    if starts == 1:
        return ["A single start was tried: --starts 4 would show whether there are other minima."]
    if best == 1:
        return [f"Only 1 of {starts} starts reached the best minimum: more of them (--starts {4 * starts}) may find a better one."]
    return [f"{best} of {starts} starts reached the best minimum."]


def _discretisation(doc: Document) -> list[str]:
    sentences = []
    for channel, error in doc["discretisation"].items():
        floor = doc["noise_floor"][channel]["value"]
        if error["value"] is not None and floor and error["value"] > _COARSE * floor:
            sentences.append(
                f"The time steps are coarse for {channel}: halving them moves the model by {error['value']:.2g} {error['unit']}, "
                f"{100 * error['value'] / floor:.0f} % of the noise floor; sample the recording more densely."
            )
    return sentences


def _recordings(doc: Document) -> list[str]:
    return [f"{recording['name']}: {note}." for recording in doc["recordings"] for note in recording["notes"]]


def _names(names: Sequence[str]) -> str:
    names = list(names)
    return names[0] if len(names) == 1 else f"{', '.join(names[:-1])} and {names[-1]}"
