"""The report: one HTML file that opens offline, with its pictures zoomable and everything that made it.

plotly.js stands in the file once. Text from files goes through ``html.escape``; the figures stand as JSON in which no ``<`` is left, so
that nothing in a file's name, header or comment can end the script or become one.
"""

import json
from collections.abc import Iterable, Mapping, Sequence
from html import escape
from pathlib import Path
from typing import Any

from smajax.report import plots, summary
from smajax.report.plots import Picture
from smajax.report.prediction import Series

_HERE = Path(__file__).parent
# The page may run what stands in it, and fetch nothing.
_POLICY = "default-src 'none'; script-src 'unsafe-inline'; style-src 'unsafe-inline'; img-src data: blob:"


def fit_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """The page of a fit: ``doc`` is fit.json, ``series`` the table of predictions, ``run`` run.json, ``rig`` the rig file's text."""
    floor = {channel: entry["value"] for channel, entry in doc["noise_floor"].items()}
    pictures: list[Picture] = []
    sections = [_verdict(doc), _rmse(doc), "<h2>Parameters</h2>", _parameters(doc)]
    sections.append(bullets(summary.remarks(doc)))
    sections.append("<h2>Measured against model</h2>")
    for one in series:
        sections += _recording(one, doc["observed"], doc["inputs"], floor, pictures)
    sections += _certainty(doc, pictures)
    sections += [
        "<h2>Where this comes from</h2>",
        recordings(doc["recordings"]),
        _fixed(doc),
        _solver(doc),
        provenance(run),
        rig_text(rig),
    ]
    return page(f"Fit of {doc['rig']}", summary.headline(doc), sections, pictures)


def simulation_page(series: Series, run: Mapping[str, Any], rig: str) -> str:
    """The page of a simulation: ``run`` is run.json, which names the observed channels and the inputs."""
    pictures: list[Picture] = []
    observed = [c for c in run["observed"] if c in series.model] or list(series.model)
    rest = [c for c in series.model if c not in observed and c not in run["inputs"]]
    sections = [f'<div class="verdict bad"><p>{escape(run["text"])}</p></div>'] if run["code"] != "done" else []
    sections.append(bullets(run.get("warnings", ())))  # which earlier versions did not write
    sections += _recording(series, observed, run["inputs"], {}, pictures)
    if rest:
        sections.append("<h2>The other channels</h2>")
        sections.append(draw(plots.time_picture(series, rest, [], {}), pictures))
    sections += ["<h2>Where this comes from</h2>", recordings(run["recordings"]), provenance(run), rig_text(rig)]
    return page(f"Simulation of {run['rig']}", f"{run['rig']} driven by {series.name}: {len(series.time):,} rows.", sections, pictures)


def page(title: str, lead: str, sections: Iterable[str], pictures: Sequence[Picture]) -> str:
    """A whole page: its title, a sentence below it, sections of HTML, and the pictures that stand in them."""
    from plotly.offline import get_plotlyjs  # here, since it takes time to load

    style, script = ((_HERE / name).read_text("utf-8") for name in ("style.css", "page.js"))
    figures = safe_json([picture.figure for picture in pictures])
    return "\n".join(
        [
            '<!DOCTYPE html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f'<meta http-equiv="Content-Security-Policy" content="{_POLICY}">',
            f"<title>{escape(title)}</title>\n<style>\n{style}</style>\n</head>\n<body>\n<main>",
            f'<h1>{escape(title)}</h1>\n<p class="lead">{escape(lead)}</p>',
            *sections,
            '<footer class="small">Drag in a picture to zoom, double-click to return. Includes plotly.js (MIT licence).</footer>',
            f'</main>\n<script type="application/json" id="figures">{figures}</script>',
            f"<script>{get_plotlyjs()}</script>\n<script>\n{script}</script>\n</body>\n</html>\n",
        ]
    )


def safe_json(value: Any) -> str:
    """JSON that can stand inside a script element: no tag and no comment can begin in it, and every engine reads it."""
    text = json.dumps(value, allow_nan=False, separators=(",", ":"))
    return text.translate({ord(c): f"\\u{ord(c):04x}" for c in "<>&"})


def _certainty(doc: Mapping[str, Any], pictures: list[Picture]) -> list[str]:
    """How well the parameters are known: profiles, and correlations."""
    drawn = []
    for name, profile in doc.get("profiles", {}).items():
        drawn.append(draw(plots.profile_picture(name, doc["parameters"][name]["unit"], profile["values"], profile["rise"]), pictures))
    correlations = doc["correlations"]
    if len(correlations["parameters"]) > 1:
        drawn.append(draw(plots.correlation_picture(correlations["parameters"], correlations["matrix"]), pictures))
    return ["<h2>How certain the parameters are</h2>", *drawn] if drawn else []


def _recording(
    series: Series, observed: Sequence[str], inputs: Sequence[str], floor: Mapping[str, float | None], pictures: list[Picture]
) -> list[str]:
    drawn = [draw(plots.time_picture(series, observed, inputs, floor), pictures)]
    drawn += [draw(picture, pictures) for picture in (plots.phase_picture(series, channel) for channel in observed) if picture]
    return drawn


def draw(picture: Picture, pictures: list[Picture]) -> str:
    """The place where a picture goes; its figure is added to the page's."""
    pictures.append(picture)
    kind = "picture" if picture.wide else "picture square"
    return (
        f'<h3>{escape(picture.title)}</h3>\n<p class="caption">{escape(picture.caption)}</p>\n'
        f'<div class="{kind}" id="picture-{len(pictures) - 1}" style="height:{picture.height}px">'
        "<noscript>This picture needs JavaScript; prediction.csv has its numbers.</noscript></div>"
    )


def _verdict(doc: Mapping[str, Any]) -> str:
    sentences = summary.verdicts(doc)
    failed = doc["solver"]["code"] == "failed"
    if failed:
        sentences = ["The simulation fails at the start values, so there is nothing to compare: the numbers below are the rig's own."]
    bad = failed or any("lacks something" in s or "worse" in s for s in sentences)
    return f'<div class="verdict{" bad" if bad else ""}">' + "".join(f"<p>{escape(s)}</p>" for s in sentences) + "</div>"


def _rmse(doc: Mapping[str, Any]) -> str:
    return table(("channel", "RMSE train", "holdout", "noise floor", "train / floor"), summary.rmse_rows(doc), numbers=(1, 2, 3, 4))


def _parameters(doc: Mapping[str, Any]) -> str:
    rows = [(name, e, low, high, pretty_unit(unit), note) for name, e, low, high, unit, note in summary.parameter_rows(doc)]
    return table(("parameter", "estimate", "95 % from", "to", "unit", ""), rows, numbers=(1, 2, 3), remark=5)


def recordings(entries: Sequence[Mapping[str, Any]]) -> str:
    """A table of files with their roles."""
    rows = [(r["name"], r["role"], f"{r['rows']:,}", r["sha256"] or "-") for r in entries]
    return "<h3>Recordings</h3>" + table(("file", "role", "rows", "SHA-256"), rows, numbers=(2,), hash_column=3)


def _fixed(doc: Mapping[str, Any]) -> str:
    rows = []
    for name, entry in doc["fixed"].items():
        value, _, _, unit = summary.readable(entry["value"], None, None, unit=entry["unit"])
        rows.append((name, value, pretty_unit(unit), entry["source"]))
    return _folded("Parameters that were held", table(("parameter", "value", "unit", "from"), rows, numbers=(1,))) if rows else ""


def _solver(doc: Mapping[str, Any]) -> str:
    solver = doc["solver"]
    rows = [("result", f"{solver['code']}: {solver['text']}"), ("steps", str(solver["steps"]))]
    rows.append(("simulations", f"{solver['simulations']:,}"))
    if solver["wall_s"] is not None:
        rows.append(("time", f"{solver['wall_s']:.2f} s, of it {solver['compile_s'] or 0:.2f} s to compile"))
    rows += [("starts at the best minimum", f"{solver['starts_at_best']} of {solver['starts']}"), ("seed", str(doc["seed"]))]
    return _folded("How it was solved", table(("", ""), rows))


def provenance(run: Mapping[str, Any]) -> str:
    """Command, versions and timings of a run."""
    rows = [("command", " ".join(run["argv"])), ("started", run["started"]), ("machine", run["machine"])]
    rows += [("versions", ", ".join(f"{name} {version}" for name, version in run["versions"].items()))]
    rows += [("seconds", ", ".join(f"{name} {value:.2f}" for name, value in run["timings"].items()))]
    return _folded("Command, versions and timings", table(("", ""), rows))


def rig_text(text: str) -> str:
    """The rig file, folded."""
    return _folded("The rig file", f"<pre>{escape(text)}</pre>")


def _folded(title: str, inside: str) -> str:
    return f"<details><summary>{escape(title)}</summary>{inside}</details>"


def bullets(sentences: Sequence[str]) -> str:
    """Sentences as a list; nothing if there is none."""
    return "<ul>" + "".join(f"<li>{escape(s)}</li>" for s in sentences) + "</ul>" if sentences else ""


def table(
    head: Sequence[str], rows: Iterable[Sequence[str]], *, numbers: Sequence[int] = (), remark: int = -1, hash_column: int = -1
) -> str:
    """A table; the columns ``numbers`` are set flush right. All text is escaped."""

    def kind(k: int) -> str:
        found = "number" if k in numbers else "remark" if k == remark else "hash" if k == hash_column else ""
        return f' class="{found}"' if found else ""

    top = "".join(f"<th{kind(k)}>{escape(cell)}</th>" for k, cell in enumerate(head)) if any(head) else ""
    body = "".join("<tr>" + "".join(f"<td{kind(k)}>{escape(cell)}</td>" for k, cell in enumerate(row)) + "</tr>" for row in rows)
    return f'<div class="scroll"><table>{f"<thead><tr>{top}</tr></thead>" if top else ""}<tbody>{body}</tbody></table></div>'


def pretty_unit(unit: str) -> str:
    """A unit with raised exponents and a degree sign."""
    return unit.replace("^2", "\N{SUPERSCRIPT TWO}").replace("^3", "\N{SUPERSCRIPT THREE}").replace("degC", "\N{DEGREE SIGN}C")
