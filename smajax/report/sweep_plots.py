"""Pictures of a sweep: what it costs to have more of one thing, the best designs across all axes, and what matters."""

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np

from smajax.report.plots import MEASURED, MODEL, RESIDUAL, Picture, axis_style, base, rounded
from smajax.units import from_si

_CLOUD, _LINES = 4000, 150


def trade_picture(
    columns: Mapping[str, np.ndarray], kept: np.ndarray, axes: Sequence[tuple[str, str, str]], front: np.ndarray, refined: Sequence[Mapping]
) -> Picture:
    """Designs over two metrics, each ``(name, unit, shown unit)``: those that keep the constraints or not, the front, the refined ones."""
    layout = base()
    data: list[dict[str, Any]] = []
    x, y = (_shown(columns[name], unit, shown) for name, unit, shown in axes)
    groups = [("beyond a constraint", ~kept, MEASURED, 0.5), ("keeps all constraints", kept, RESIDUAL, 0.9)]
    for name, chosen, colour, opacity in groups:
        rows = _some(np.flatnonzero(chosen & np.isfinite(x) & np.isfinite(y)), _CLOUD)
        if len(rows):
            data.append(_points(name, x[rows], y[rows], {"color": colour, "size": 5, "opacity": opacity}, columns["design"][rows]))
    if len(front):
        rows = front[np.argsort(x[front])]
        best = _points("best", x[rows], y[rows], {"color": MODEL, "size": 7}, columns["design"][rows])
        data.append(best | {"mode": "lines+markers", "line": {"color": MODEL, "width": 1.2, "shape": "hv"} if len(rows) > 1 else {}})
    better = [one for one in refined if one["better"]]
    if better:
        ends = [_shown(np.array([one["metrics"][name] for one in better], float), unit, shown) for name, unit, shown in axes]
        data.append(_points("refined", ends[0], ends[1], {"color": "#22272e", "size": 11, "symbol": "star"}, np.arange(1, len(better) + 1)))
    layout["xaxis"], layout["yaxis"] = (axis_style(_title(name, shown)) for name, _, shown in axes)
    layout["showlegend"] = True
    caption = "Each point is a design. The best ones are those that no other one beats in all objectives."
    if not (np.isfinite(x[kept]).all() and np.isfinite(y[kept]).all()):
        caption += " Designs with an infinite figure, or with none, have no point."
    return Picture("What it costs", caption, {"data": data, "layout": layout}, 480)


def parallel_picture(
    columns: Mapping[str, np.ndarray], kept: np.ndarray, axes: Sequence[tuple[str, str, str, bool]], front: np.ndarray
) -> Picture:
    """Parallel coordinates: a line for each design across parameters and metrics, ``(name, unit, shown unit, log)`` each."""
    layout = base()
    heights, marks = [], []
    for k, (name, unit, shown, log) in enumerate(axes):
        values = _shown(columns[name], unit, shown)
        good = values[np.isfinite(values)]
        low, high = (float(good.min()), float(good.max())) if len(good) else (0.0, 1.0)
        scaled = np.log(values / low) / np.log(high / low) if log and 0 < low < high else (values - low) / ((high - low) or 1.0)
        heights.append(scaled)
        for end, at, anchor in ((low, -0.02, "top"), (high, 1.02, "bottom")):
            marks.append({"x": k, "y": at, "text": f"{end:.3g}", "showarrow": False, "yanchor": anchor, "font": {"size": 11}})
    table = np.column_stack(heights)
    whole = np.all(np.isfinite(table), axis=1)
    data = []
    for name, rows, style in (
        ("beyond a constraint", _some(np.flatnonzero(~kept & whole), _LINES if not kept.any() else 0), {"color": MEASURED, "width": 0.7}),
        ("keeps all constraints", _some(np.flatnonzero(kept & whole), _LINES), {"color": RESIDUAL, "width": 0.7}),
        ("best", _some(front[whole[front]], _LINES) if len(front) else front, {"color": MODEL, "width": 1.6}),
    ):
        x, y = [], []
        for row in rows:
            x += [*range(len(axes)), None]
            y += [*rounded(table[row]), None]
        if len(rows):
            data.append({"type": "scatter", "mode": "lines", "name": name, "x": x, "y": y, "line": style, "hoverinfo": "skip"})
    labels = [_title(name, shown).replace(" [", "<br>[").replace(".", ".<br>", 1) for name, _, shown, _ in axes]
    layout["xaxis"] = {"tickvals": list(range(len(axes))), "ticktext": labels, "range": [-0.4, len(axes) - 0.6], "fixedrange": True}
    # To the lower left, where the last one has room, too.
    layout["xaxis"] |= {"showgrid": True, "gridcolor": "#9aa4b0", "zeroline": False, "automargin": True, "tickangle": -35}
    layout["yaxis"] = {"visible": False, "range": [-0.12, 1.12], "fixedrange": True}
    layout["annotations"], layout["showlegend"] = marks, True
    caption = f"Each line is a design, each upright an axis from its lowest to its highest value; up to {_LINES} designs of each colour."
    return Picture("Designs across all axes", caption, {"data": data, "layout": layout}, 420)


def sensitivity_picture(found: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Picture:
    """Total Sobol indices, parameters across and metrics down."""
    metrics = [name for name, told in found.items() if told]
    names = list(found[metrics[0]])
    layout = base()
    layout["xaxis"] = {"side": "bottom", "automargin": True, "tickangle": -25}
    layout["yaxis"] = {"autorange": "reversed", "automargin": True}
    z = [[found[metric][name]["total"] for name in names] for metric in metrics]
    trace = {
        "type": "heatmap", "x": [escape(n) for n in names], "y": metrics, "z": z, "zmin": 0, "zmax": 1,
        "colorscale": [[0, "#ffffff"], [1, "#c8501e"]], "text": [["-" if v is None else f"{v:.2f}" for v in row] for row in z],
        "texttemplate": "%{text}", "hovertemplate": "%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        "colorbar": {"thickness": 12, "outlinewidth": 0},
    }  # fmt: skip
    caption = "Total Sobol indices: the share of a metric's variance over the space that would go if the parameter were known."
    return Picture("What matters", caption, {"data": [trace], "layout": layout}, 130 + 44 * len(metrics) + 60)


def _shown(values: np.ndarray, unit: str, shown: str) -> np.ndarray:
    return np.asarray(from_si(np.asarray(values, float), shown, unit)) if shown != unit else np.asarray(values, float)


def _title(name: str, unit: str) -> str:
    return escape(name if unit == "1" else f"{name} [{unit}]")


def _points(name: str, x: np.ndarray, y: np.ndarray, marker: dict[str, Any], numbers: np.ndarray) -> dict[str, Any]:
    told = {"text": [str(n) for n in numbers], "hovertemplate": "design %{text}<br>%{x:.5g}, %{y:.5g}<extra></extra>"}
    return {"type": "scatter", "mode": "markers", "name": name, "x": rounded(x), "y": rounded(y), "marker": marker} | told


def _some(rows: np.ndarray, most: int) -> np.ndarray:
    """At most so many rows, evenly taken."""
    return rows[:most] if len(rows) <= most or not most else rows[np.linspace(0, len(rows) - 1, most).astype(int)]
