"""What ``smajax sweep`` prints and shows: the best designs, what they cost, what matters, and the refined ones."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from smajax.report import html, plots, sweep_plots
from smajax.report.document import number
from smajax.report.summary import table
from smajax.rig_schema import display_unit
from smajax.sweep.front import cheapest, feasible, pareto
from smajax.units import from_si

SCHEMA = "smajax.sweep/1"
_ROWS = 8
# Units that have no larger or smaller one which users would rather see.
_AS_THEY_ARE = ("1", "J", "Hz", "s", "degC", "K")


def shown_unit(unit: str) -> str:
    """The unit in which an axis or a metric is shown."""
    return unit if unit in _AS_THEY_ARE else "deg" if unit == "rad" else display_unit(unit)


def figure(value: float) -> float | str | None:
    """A metric for the JSON document, which knows no infinity: ``"inf"`` and ``"-inf"`` stand for it; ``None`` where there is none."""
    return str(float(value)) if np.isinf(value) else number(value)


def shown(value: float | str | None, unit: str) -> str:
    """A value of the document in its shown unit, with it; ``-`` where there is none."""
    if value is None:
        return "-"
    if np.isinf(float(value)):
        return "infinite" if float(value) > 0.0 else "minus infinite"
    size = float(from_si(float(value), shown_unit(unit), unit)) if shown_unit(unit) != unit else float(value)
    return f"{size:.4g}" + ("" if unit == "1" else f" {shown_unit(unit)}")


def in_unit(value: float, unit: str, written: str) -> str:
    """A value in an internal ``unit``, shown in the unit in which a file has it."""
    size = float(from_si(float(value), written, unit)) if np.isfinite(value) else float(value)
    return f"{size:.4g}" + ("" if written == "1" else f" {written}")


def sentences(doc: Mapping[str, Any]) -> str:
    """What came of it, in words."""
    told = f"{doc['designs']:,} designs of {doc['rig']}"
    failed = {code: n for code, n in doc["codes"].items() if code != "done"}
    told += f", of which {sum(failed.values()):,} could not be simulated ({', '.join(failed)})" if failed else ""
    if doc["constraints"]:
        told += f"; {doc['feasible']:,} keep{'s' if doc['feasible'] == 1 else ''} all constraints"
    if doc["objectives"] and doc["front"]:
        name, way = next(iter(doc["objectives"].items()))
        best = _top(doc["front"], name, way)
        unit = doc["metrics"][name]["unit"]
        told += f". The {'largest' if way == 'max' else 'smallest'} {name} of these is {shown(best['metrics'][name], unit)}"
        told += f", with design {best['design']}"
        many = f"{doc['on_front']:,} designs are" if doc["on_front"] > 1 else "1 design is"
        told += f"; {many} beaten by no other" if len(doc["objectives"]) > 1 else ""
        told += _gained(doc, name, way, best)
    elif any(one["better"] for one in doc["refined"]):
        told += _rescued(doc)
    told += "." + _idle(doc) + _unsettled(doc.get("settling", {}))
    return told + (" But " + "; ".join(doc["problems"]) + "." if doc["problems"] else "")


def _gained(doc: Mapping[str, Any], name: str, way: str, best: Mapping[str, Any]) -> str:
    """What to say of the refined designs, beside the best of the drawn ones in the first objective."""
    if not doc["refined"]:
        return ""
    spent = f"in {sum(one['simulations'] for one in doc['refined']):,} simulations"
    better = [one for one in doc["refined"] if one["better"]]
    if not better:
        return f". Refining along its gradients found none better than those it began from, {spent}"
    top = _top(better, name, way)
    told = f". Refined along its gradients it is {shown(top['metrics'][name], doc['metrics'][name]['unit'])}, {spent}"
    return told + ("" if _top([best, top], name, way) is top else ", which is not better")


def _rescued(doc: Mapping[str, Any]) -> str:
    """What to say if none of the drawn designs keeps the constraints, and refined ones do."""
    name, way = next(iter(doc["objectives"].items()))
    better = [one for one in doc["refined"] if one["better"]]
    top = _top(better, name, way)["metrics"][name]
    told = f", so the nearest ones were refined: {len(better)} of {len(doc['refined'])} came to keep them"
    spent = f"in {sum(one['simulations'] for one in doc['refined']):,} simulations"
    return f"{told}, with a {name} of {shown(top, doc['metrics'][name]['unit'])} at best, {spent}"


def _idle(doc: Mapping[str, Any]) -> str:
    """What to say of objectives that no design changes, among which none is the best."""
    spans = {n: (doc["metrics"][n].get("lowest"), doc["metrics"][n].get("highest")) for n in doc["objectives"]}
    same = [n for n, (low, high) in spans.items() if low is not None and low == high and doc["designs"] > 1]
    return f" What varies does not change {' and '.join(same)}, so that none is the best in that." if same else ""


def _unsettled(found: Mapping[str, Any]) -> str:
    """What to say of designs whose last cycle does not end where it began."""
    drawn, refined = found.get("unsettled", 0), found.get("unsettled_refined", 0)
    if not drawn and not refined:
        return ""
    among = f" ({found['unsettled_on_front']:,} of the best among them)" if found["unsettled_on_front"] else ""
    told = [f"{drawn:,} {'designs have' if drawn > 1 else 'design has'} not settled{among}"] if drawn else []
    told += [f"{refined:,} refined {'ones have' if refined > 1 else 'one has'} not settled"] if refined else []
    what = f"the last cycle ends more than {100 * found['limit']:g} % of its range from where it began (column settling)"
    return f" {', and '.join(told)}: {what}, so give the input more cycles."


def _top(rows: Sequence[Mapping[str, Any]], name: str, way: str) -> Mapping[str, Any]:
    """The best of rows of the document in a metric."""
    return (max if way == "max" else min)(rows, key=lambda row: float(row["metrics"][name]))


def _head(doc: Mapping[str, Any]) -> tuple[str, ...]:
    return ("", *doc["parameters"], *doc["metrics"])


def _rows(doc: Mapping[str, Any], entries: Sequence[tuple[str, Mapping[str, Any]]]) -> list[tuple[str, ...]]:
    return [
        (
            label,
            *(shown(row["parameters"][n], p["unit"]) for n, p in doc["parameters"].items()),
            *(shown(row["metrics"][n], m["unit"]) for n, m in doc["metrics"].items()),
        )
        for label, row in entries
    ]


def best_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Some of the best designs, evenly over the front and with the best in each objective, then the refined ones."""
    front = sorted(doc["front"], key=lambda row: float(row["metrics"][next(iter(doc["objectives"]))]))
    tops = [front.index(_top(front, name, way)) for name, way in doc["objectives"].items()] if front else []
    even = np.linspace(0, len(front) - 1, _ROWS).astype(int) if front else []
    picked = [front[k] for k in sorted({*tops, *even})]
    entries = [(f"design {row['design']}", row) for row in picked]
    return _rows(doc, entries + [(f"refined {k}", one) for k, one in enumerate(doc["refined"], 1) if one["better"]])


def _best(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """The best designs, a column for each, since there are more parameters and metrics than a line has room for."""
    rows = best_rows(doc)
    return list(zip(_head(doc), *rows, strict=True)) if rows else []


def text(doc: Mapping[str, Any], folder: str) -> str:
    """What the command prints."""
    lines = []
    if turned := _best(doc):
        lines += [*table(turned, right=tuple(range(1, len(turned[0])))), ""]
    return "\n".join([*lines, doc["summary"], f"Table, report and refined rigs in {folder}"])


def sweep_page(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray], run: Mapping[str, Any], rig: str) -> str:
    """The page: ``doc`` is sweep.json, ``columns`` the table's by name, ``run`` run.json, ``rig`` the rig's text."""
    pictures: list[plots.Picture] = []
    bad = ' bad"' if doc["problems"] else '"'
    sections = [f'<div class="verdict{bad}><p>{html.escape(doc["summary"])}</p></div>']
    limits = {n: (_end(e["at_least"], -np.inf), _end(e["at_most"], np.inf)) for n, e in doc["constraints"].items()}
    kept = feasible(columns, limits)
    front = np.zeros(0, int)
    if doc["objectives"] and kept.any():
        front = np.flatnonzero(kept)[pareto(cheapest(columns, doc["objectives"])[kept])]
    units = {n: e["unit"] for n, e in (doc["parameters"] | doc["metrics"]).items()}
    if turned := _best(doc):
        sections += ["<h2>The best designs</h2>", html.table(turned[0], turned[1:], numbers=tuple(range(1, len(turned[0]))))]
    pair = list(dict.fromkeys([*doc["objectives"], *doc["constraints"], *doc["metrics"]]))[:2]
    if len(pair) == 2:
        axes = [(n, units[n], shown_unit(units[n])) for n in pair]
        sections.append(html.draw(sweep_plots.trade_picture(columns, kept, axes, front, doc["refined"]), pictures))
    across = [(n, units[n], shown_unit(units[n]), doc["parameters"].get(n, {}).get("scale") == "log") for n in units]
    sections.append(html.draw(sweep_plots.parallel_picture(columns, kept, across, front), pictures))
    if any(doc["sensitivity"].values()):
        sections.append("<h2>What matters</h2>")
        sections.append(html.draw(sweep_plots.sensitivity_picture(doc["sensitivity"]), pictures))
        sections.append(html.table(("metric", "parameter", "alone", "95 %", "in all", "95 %"), _index_rows(doc), numbers=(2, 3, 4, 5)))
    if notes := doc.get("sensitivity_notes"):
        sections.append(f"<p>{html.escape(' '.join(notes))}</p>")
    sections += ["<h2>Ranges</h2>", html.table(("", "lowest", "highest"), _range_rows(doc), numbers=(1, 2))]
    sections += ["<h2>Where this comes from</h2>", html.provenance(run), html.rig_text(rig)]
    return html.page(f"Sweep of {doc['rig']}", f"{doc['designs']:,} designs, sampled by {doc['sampling']}.", sections, pictures)


def _end(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def _index_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    rows = []
    for metric, told in doc["sensitivity"].items():
        for name, one in told.items():
            cells = [_index(one[key]) for key in ("first", "first95", "total", "total95")]
            rows.append((metric, name, *cells))
    return rows


def _index(value: Any) -> str:
    if isinstance(value, list):
        return " .. ".join("-" if v is None else f"{v:.2f}" for v in value)
    return "-" if value is None else f"{value:.2f}"


def _range_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    rows = [(n, shown(e["from"], e["unit"]), shown(e["to"], e["unit"])) for n, e in doc["parameters"].items()]
    return rows + [(n, shown(e["lowest"], e["unit"]), shown(e["highest"], e["unit"])) for n, e in doc["metrics"].items()]
