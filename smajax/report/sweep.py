"""Summary and page of ``smajax sweep``: best designs, trade-offs, sensitivities and refined designs."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from smajax.report import pages, sweep_plots
from smajax.report.figures import Picture
from smajax.report.shown_values import format_in_unit, format_parameter, format_value, shown_unit
from smajax.report.summary import table
from smajax.report.topics import explained, sweep_topics
from smajax.sweeps.pareto import feasible_mask, objective_costs, pareto_front
from smajax.sweeps.sobol import is_resolved

# Number of designs of the front in the table of the best designs: as many columns as fit on a page.
_MAX_ROWS = 8
# A refined design is at the end of an axis if it is nearer than this share of the axis; searches end at their bounds.
_AT_END = 1e-3


def sweep_summary(doc: Mapping[str, Any]) -> str:
    """Summarise the result of a sweep in sentences; ``doc`` is sweep.json."""
    words = f"{doc['designs']:,} designs of {doc['rig']}"
    failed = {code: n for code, n in doc["codes"].items() if code != "done"}
    words += f", of which {sum(failed.values()):,} could not be simulated ({', '.join(failed)})" if failed else ""
    if doc["constraints"]:
        words += f"; {doc['feasible']:,} satisf{'ies' if doc['feasible'] == 1 else 'y'} all constraints"
    if doc["objectives"] and doc["front"]:
        name, goal = next(iter(doc["objectives"].items()))
        best = _best_in(doc["front"], name, goal)
        value = format_value(best["metrics"][name], doc["metrics"][name]["unit"])
        words += f". The {'largest' if goal == 'max' else 'smallest'} {name} of these is {value}"
        words += f", with design {best['design']}"
        count = f"{doc['on_front']:,} designs are" if doc["on_front"] > 1 else "1 design is"
        words += f"; {count} on the Pareto front" if len(doc["objectives"]) > 1 else ""
        words += _refinement_words(doc, name, goal, best)
    elif any(entry["better"] for entry in doc["refined"]):
        words += _restoration_words(doc)
    words += "." + _constant_objectives_words(doc) + _unsettled_words(doc.get("settling", {}))
    words += _end_words(doc) + _excluding_words(doc) + _limit_words(doc) + _margin_words(doc)
    words += " But " + "; ".join(doc["problems"]) + "." if doc["problems"] else ""
    return words + (f" To buy: {doc['purchase']}." if doc.get("purchase") else "")


def _excluding_words(doc: Mapping[str, Any]) -> str:
    """A sentence about the constraint that rules out most designs."""
    counts = {n: entry["excludes"] for n, entry in doc["constraints"].items() if entry.get("excludes")}
    if not counts:
        return ""
    name = max(counts, key=lambda n: counts[n])
    alone = doc["constraints"][name]["excludes_alone"]
    words = f" Of {doc['codes'].get('done', 0):,} simulated designs {name} rules out most, {counts[name]:,}"
    words += f" ({alone:,} of them satisfy all others)" if len(doc["constraints"]) > 1 else ""
    second = sorted(counts, key=lambda n: counts[n])[-2:-1]
    return words + (f"; {second[0]} rules out {counts[second[0]]:,}." if second else ".")


def _limit_words(doc: Mapping[str, Any]) -> str:
    """A sentence about the limits of the material that hold."""
    if not (limits := doc.get("limits")):
        return ""
    words = [
        f"{name} at most {_limit_value(name, entry['at_most'], doc['metrics'][name]['unit'])}"
        + (f" for {entry['cycles']:,.0f} cycles" if entry["cycles"] else "")
        for name, entry in limits.items()
    ]
    name = next(iter(limits.values()))["parameter_set"]
    return f' Limits of the material hold ({name}): {", ".join(words)}; limits = "none" turns them off.'


def _limit_value(name: str, value: float, unit: str) -> str:
    return format_in_unit(value, unit, "%") if name == "strain_range" else format_value(value, unit)


def _margin_words(doc: Mapping[str, Any]) -> str:
    """A sentence about the margins of the constraints."""
    if not (margins := doc.get("margins")):
        return ""
    units = margins.get("units", {})
    words = [f"{name} +- {format_value(width, units.get(name, '1'))}" for name, width in margins["vary"].items()]
    words += [f"the 95 % intervals of the fit {margins['fit']}"] if margins["fit"] else []
    return f" The constraints hold for {' and '.join(words)} (columns lowest_ and highest_)."


def _refinement_words(doc: Mapping[str, Any], name: str, goal: str, best: Mapping[str, Any]) -> str:
    """The best refined design compared with the best sampled one, in the first objective."""
    if not doc["refined"]:
        return ""
    spent = f"in {sum(entry['simulations'] for entry in doc['refined']):,} simulations"
    better = [entry for entry in doc["refined"] if entry["better"]]
    if not better:
        return f". Gradient-based refinement found no better design, {spent}"
    top = _best_in(better, name, goal)
    value = format_value(top["metrics"][name], doc["metrics"][name]["unit"])
    words = f". With gradient-based refinement it is {value}, {spent}"
    return words + ("" if _best_in([best, top], name, goal) is top else ", which is not better")


def _restoration_words(doc: Mapping[str, Any]) -> str:
    """The refined designs, if only these satisfy the constraints."""
    name, goal = next(iter(doc["objectives"].items()))
    better = [entry for entry in doc["refined"] if entry["better"]]
    value = format_value(_best_in(better, name, goal)["metrics"][name], doc["metrics"][name]["unit"])
    words = f", so the nearest ones were refined: {len(better)} of {len(doc['refined'])} now satisfy them"
    spent = f"in {sum(entry['simulations'] for entry in doc['refined']):,} simulations"
    return f"{words}, with {name} {value} at best, {spent}"


def _end_words(doc: Mapping[str, Any]) -> str:
    """A sentence about axes at whose ends the best refined design lies; listed values are all that there is to buy."""
    better = [entry for entry in doc["refined"] if entry["better"]]
    if not better or not doc["objectives"]:
        return ""
    best = _best_in(better, *next(iter(doc["objectives"].items())))["parameters"]
    ends = []
    for name, axis in doc["parameters"].items():
        if axis["values"] or axis["from"] == axis["to"]:
            continue
        shape = np.log if axis["scale"] == "log" else np.asarray
        share = float((shape(best[name]) - shape(axis["from"])) / (shape(axis["to"]) - shape(axis["from"])))
        if share < _AT_END or share > 1.0 - _AT_END:
            size = "smallest" if share < _AT_END else "largest"
            ends.append(f"the {size} {name} ({format_parameter(best[name], axis)})")
    if not ends:
        return ""
    return f" The best design has {' and '.join(ends)} of the space: a wider one may hold better designs."


def _constant_objectives_words(doc: Mapping[str, Any]) -> str:
    """A sentence about objectives that are the same in all designs."""
    spans = {n: (doc["metrics"][n].get("lowest"), doc["metrics"][n].get("highest")) for n in doc["objectives"]}
    same = [n for n, (low, high) in spans.items() if low is not None and low == high and doc["designs"] > 1]
    return (
        f" The parameters do not change {' and '.join(same)}, so no design is better than another in it."
        if same
        else ""
    )


def _unsettled_words(settling: Mapping[str, Any]) -> str:
    """A sentence about designs that have not settled."""
    sampled, refined = settling.get("unsettled", 0), settling.get("unsettled_refined", 0)
    if not sampled and not refined:
        return ""
    among = f" ({settling['unsettled_on_front']:,} of the best among them)" if settling["unsettled_on_front"] else ""
    counts = [f"{sampled:,} {'designs have' if sampled > 1 else 'design has'} not settled{among}"] if sampled else []
    counts += [f"{refined:,} refined {'ones have' if refined > 1 else 'one has'} not settled"] if refined else []
    limit = f"{100 * settling['limit']:g} %"
    reason = f"start and end of the last cycle differ by more than {limit} of its range (column settling)"
    return f" {', and '.join(counts)}: {reason}, so give the input more cycles."


def _best_in(rows: Sequence[Mapping[str, Any]], name: str, goal: str) -> Mapping[str, Any]:
    """The row of the document that is best in a metric."""
    return (max if goal == "max" else min)(rows, key=lambda row: float(row["metrics"][name]))


def _head(doc: Mapping[str, Any]) -> tuple[str, ...]:
    return ("", *doc["parameters"], *doc["metrics"])


def _rows(doc: Mapping[str, Any], entries: Sequence[tuple[str, Mapping[str, Any]]]) -> list[tuple[str, ...]]:
    return [
        (
            label,
            *(format_parameter(row["parameters"][n], p) for n, p in doc["parameters"].items()),
            *(format_value(row["metrics"][n], m["unit"]) for n, m in doc["metrics"].items()),
        )
        for label, row in entries
    ]


def best_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows of the best designs: some of the front, the best in each objective, and the refined ones."""
    front = sorted(doc["front"], key=lambda row: float(row["metrics"][next(iter(doc["objectives"]))]))
    best = [front.index(_best_in(front, name, goal)) for name, goal in doc["objectives"].items()] if front else []
    even = np.linspace(0, len(front) - 1, _MAX_ROWS).astype(int) if front else []
    picked = [front[k] for k in sorted({*best, *even})]
    entries = [(f"design {row['design']}", row) for row in picked]
    entries += [(f"refined {k}", entry) for k, entry in enumerate(doc["refined"], 1) if entry["better"]]
    return _rows(doc, entries)


def best_columns(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the table of the best designs, with a column for each: all their values do not fit on a line."""
    rows = best_rows(doc)
    return list(zip(_head(doc), *rows, strict=True)) if rows else []


def text(doc: Mapping[str, Any], folder: str = "") -> str:
    """Format the summary of a sweep for a terminal.

    Args:
        doc: The document sweep.json.
        folder: The result folder, which the last line names; empty for none.
    """
    lines = []
    if columns := best_columns(doc):
        lines += [*table(columns, right=tuple(range(1, len(columns[0])))), ""]
    place = [f"Table, report and refined rigs in {folder}"] if folder else []
    command = next((entry["command"] for entry in doc["refined"] if entry.get("command")), "")
    if folder and command:
        place.append(f"To see the figures of refined 1 again: cd {folder}, then {command}")
    return "\n".join([*lines, doc["summary"], *explained(sweep_topics(doc)), *place])


def sweep_page(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of a sweep.

    Args:
        doc: The document sweep.json.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        run: The document run.json.
        rig: Text of the rig file.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    sections = [pages.verdict_section([doc["summary"]], bad=bool(doc["problems"]))]
    if best := best_columns(doc):
        numbers = tuple(range(1, len(best[0])))
        sections += ["<h2>The best designs</h2>", pages.table(best[0], best[1:], numbers=numbers)]
        sections += [f"<p><code>{escape(e['command'])}</code></p>" for e in doc["refined"] if e.get("command")][:1]
    sections += _constraint_section(doc)
    sections += _design_pictures(doc, columns, pictures)
    sections += _sensitivity_section(doc, pictures)
    sections += ["<h2>Ranges</h2>", pages.table(("", "lowest", "highest"), _range_rows(doc), numbers=(1, 2))]
    sections.append(pages.topics_section(sweep_topics(doc)))
    sections += pages.provenance_sections(run, rig)
    lead = f"{doc['designs']:,} designs, sampled by {doc['sampling']}."
    return pages.render_page(f"Sweep of {doc['rig']}", lead, sections, pictures)


def _constraint_section(doc: Mapping[str, Any]) -> list[str]:
    """Table of the constraints, with the designs that they rule out and the sources of the material's limits."""
    if not doc["constraints"]:
        return []
    rows = []
    for name, entry in doc["constraints"].items():
        unit, limit = doc["metrics"][name]["unit"], _limit_of(doc, name, entry)
        ends = [format_value(entry[key], unit) for key in ("at_least", "at_most")]
        counts = ["-" if entry.get(key) is None else f"{entry[key]:,}" for key in ("excludes", "excludes_alone")]
        rows.append((name, *ends, *counts, limit))
    head = ("metric", "at least", "at most", "rules out", "it alone", "limit of the material")
    return ["<h2>Constraints</h2>", pages.table(head, rows, numbers=(1, 2, 3, 4))]


def _limit_of(doc: Mapping[str, Any], name: str, entry: Mapping[str, Any]) -> str:
    """Source of a constraint that is a limit of the material; empty for others, such as a stricter one of the file."""
    limit = (doc.get("limits") or {}).get(name.removeprefix("highest_"))
    return limit["source"] if limit and limit["at_most"] == entry["at_most"] else ""


def _design_pictures(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray], pictures: list[Picture]) -> list[str]:
    """Figures of all designs: over two metrics, and across all axes."""
    made = [_trade_off_picture(doc, columns), _parallel_picture(doc, columns)]
    return [pages.add_picture(picture, pictures) for picture in made if picture is not None]


def design_picture(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> Picture:
    """Show all designs over two metrics; across all axes if there is one metric only.

    Args:
        doc: The document sweep.json.
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
    """
    return _trade_off_picture(doc, columns) or _parallel_picture(doc, columns)


def _best_designs(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> tuple[np.ndarray, np.ndarray]:
    """Mask of the designs that satisfy the constraints, and rows of the Pareto front."""
    limits = {n: (_bound(e["at_least"], -np.inf), _bound(e["at_most"], np.inf)) for n, e in doc["constraints"].items()}
    feasible = feasible_mask(columns, limits)
    front = np.zeros(0, int)
    if doc["objectives"] and feasible.any():
        front = np.flatnonzero(feasible)[pareto_front(objective_costs(columns, doc["objectives"])[feasible])]
    return feasible, front


def _trade_off_picture(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> Picture | None:
    """All designs over two metrics, or ``None`` if there is one metric only."""
    pair = list(dict.fromkeys([*doc["objectives"], *doc["constraints"], *doc["metrics"]]))[:2]
    if len(pair) < 2:
        return None
    feasible, front = _best_designs(doc, columns)
    axes = [(n, doc["metrics"][n]["unit"], shown_unit(doc["metrics"][n]["unit"])) for n in pair]
    return sweep_plots.trade_off_picture(columns, feasible, axes, front, doc["refined"])


def _parallel_picture(doc: Mapping[str, Any], columns: Mapping[str, np.ndarray]) -> Picture:
    """All designs across all axes."""
    feasible, front = _best_designs(doc, columns)
    units = {n: e["unit"] for n, e in (doc["parameters"] | doc["metrics"]).items()}
    axes = [(n, units[n], shown_unit(units[n]), doc["parameters"].get(n, {}).get("scale") == "log") for n in units]
    return sweep_plots.parallel_picture(columns, feasible, axes, front)


def _sensitivity_section(doc: Mapping[str, Any], pictures: list[Picture]) -> list[str]:
    sections = []
    if any(doc["sensitivity"].values()):
        head = ("metric", "parameter", "first order", "95 %", "total", "95 %")
        sections.append("<h2>Sensitivity</h2>")
        sections.append(pages.add_picture(sweep_plots.sensitivity_picture(doc["sensitivity"]), pictures))
        sections.append(pages.table(head, index_rows(doc), numbers=(2, 3, 4, 5)))
    if notes := doc.get("sensitivity_notes"):
        sections.append(f"<p>{escape(' '.join(notes))}</p>")
    return sections


def _bound(value: float | None, otherwise: float) -> float:
    return otherwise if value is None else value


def index_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return the rows of the table of Sobol indices; an index outside of 0 to 1 is not shown.

    Args:
        doc: The document sweep.json.
    """
    rows = []
    for metric, indices in doc["sensitivity"].items():
        for name, index in indices.items():
            cells = [_format_index(index[key]) for key in ("first", "first95", "total", "total95")]
            rows.append((metric, name, *cells))
    return rows


def _format_index(value: Any) -> str:
    """Format an index, or its interval, of which the part from 0 to 1 is shown; ``-`` for what no index can be."""
    if isinstance(value, list):
        return " .. ".join("-" if v is None else f"{min(max(v, 0.0), 1.0):.2f}" for v in value)
    return f"{abs(value):.2f}" if is_resolved(value) else "-"


def _range_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    rows = [(n, format_parameter(e["from"], e), format_parameter(e["to"], e)) for n, e in doc["parameters"].items()]
    return rows + [
        (n, format_value(e["lowest"], e["unit"]), format_value(e["highest"], e["unit"]))
        for n, e in doc["metrics"].items()
    ]
