"""Figures of a sweep: the trade-off between two metrics, all designs across all axes, and sensitivities."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import numpy as np
import plotly.graph_objects as go

from smajax.report.figures import MEASURED, MODEL, RESIDUAL, Picture, axis_style, base_layout, single_precision
from smajax.sweeps.sobol import is_resolved
from smajax.units import from_si

# Largest number of points, and of lines, of each kind in a figure: more would make it slow to draw; chosen by trial.
_MAX_POINTS = 4000
_MAX_LINES = 150
# Room around useful designs in a figure, as a share of their range, its least range as a share of their size, and the
# share of designs on each side that may lie outside where none is useful; chosen by trial.
_AXIS_ROOM = 0.5
_LEAST_ROOM = 0.1
_OUTER_SHARE = 0.02
# Rounding error of a scaled value, which must not remove a line at the end of an axis.
_HEIGHT_ROUNDING = 1e-9
_REFINED_COLOUR = "#22272e"
# Heights of the figures in pixels; the matrix of indices has so many per metric, and a frame.
_TRADE_OFF_HEIGHT = 480
_PARALLEL_HEIGHT = 420
_CELL_PIXELS = 44
_MATRIX_FRAME_PIXELS = 190


def trade_off_picture(
    columns: Mapping[str, np.ndarray],
    feasible: np.ndarray,
    axes: Sequence[tuple[str, str, str]],
    front: np.ndarray,
    refined: Sequence[Mapping[str, Any]],
) -> Picture:
    """Show all designs over two metrics.

    Args:
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        feasible: Mask of the designs that satisfy the constraints, shape ``(m,)``.
        axes: The two metrics: name, internal unit, shown unit.
        front: Rows of the Pareto front, shape ``(front,)``.
        refined: Entries of the refined designs in sweep.json.
    """
    layout = base_layout()
    data: list[go.Scatter] = []
    x, y = (_in_shown_unit(columns[name], unit, shown) for name, unit, shown in axes)
    ranges = [_useful_range(values, feasible, front) for values in (x, y)]
    near = np.all([(v >= low) & (v <= high) for v, (low, high) in zip((x, y), ranges, strict=True)], axis=0)
    groups = [
        ("violates a constraint", ~feasible, MEASURED, 0.5),
        ("satisfies all constraints", feasible, RESIDUAL, 0.9),
    ]
    for name, chosen, colour, opacity in groups:
        rows = _evenly_chosen(np.flatnonzero(chosen & near), _MAX_POINTS)
        if len(rows):
            marker = {"color": colour, "size": 5, "opacity": opacity}
            data.append(_points(name, x[rows], y[rows], marker, columns["design"][rows]))
    if len(front):
        rows = front[np.argsort(x[front])]
        best = _points("best", x[rows], y[rows], {"color": MODEL, "size": 7}, columns["design"][rows])
        line = {"color": MODEL, "width": 1.2, "shape": "hv"} if len(rows) > 1 else {}
        data.append(best.update(mode="lines+markers", line=line))
    if better := [entry for entry in refined if entry["better"]]:
        ends = [
            _in_shown_unit(np.array([entry["metrics"][name] for entry in better], float), unit, shown)
            for name, unit, shown in axes
        ]
        marker = {"color": _REFINED_COLOUR, "size": 11, "symbol": "star"}
        data.append(_points("refined", ends[0], ends[1], marker, np.arange(1, len(better) + 1)))
    layout.xaxis, layout.yaxis = (axis_style(_title(name, shown)) for name, _, shown in axes)
    layout.showlegend = True
    caption = (
        "Each point is a design. The best ones form the Pareto front: no other design is better in all objectives."
    )
    if not (np.isfinite(x[feasible]).all() and np.isfinite(y[feasible]).all()):
        caption += " Designs with an infinite or missing metric are left out."
    if far := int(np.sum(np.isfinite(x) & np.isfinite(y) & ~near)):
        lie = "design lies" if far == 1 else "designs lie"
        caption += f" {far:,} {lie} far from those that satisfy all constraints, outside of the figure."
    return Picture("Trade-off", caption, go.Figure(data, layout), _TRADE_OFF_HEIGHT)


def parallel_picture(
    columns: Mapping[str, np.ndarray],
    feasible: np.ndarray,
    axes: Sequence[tuple[str, str, str, bool]],
    front: np.ndarray,
) -> Picture:
    """Show all designs in parallel coordinates: a line for each design across parameters and metrics.

    Args:
        columns: Columns of the sweep's table by name, shape ``(m,)`` each.
        feasible: Mask of the designs that satisfy the constraints, shape ``(m,)``.
        axes: The axes: name, internal unit, shown unit, whether the scale is logarithmic.
        front: Rows of the Pareto front, shape ``(front,)``.
    """
    layout = base_layout()
    heights, marks = [], []
    # Only designs that are drawn determine the ends of the axes.
    drawn = feasible if feasible.any() else np.ones(len(feasible), bool)
    for k, (name, unit, shown, log) in enumerate(axes):
        shown_values = _in_shown_unit(columns[name], unit, shown)
        height, (low, high) = _axis_heights(shown_values, log, drawn)
        heights.append(height)
        for end, place, anchor in ((low, -0.02, "top"), (high, 1.02, "bottom")):
            mark = {"x": k, "y": place, "text": f"{end:.3g}", "showarrow": False, "yanchor": anchor}
            marks.append(mark | {"font": {"size": 11}})
    data = _design_lines(np.column_stack(heights), feasible, front)
    labels = [_title(name, shown).replace(" [", "<br>[").replace(".", ".<br>", 1) for name, _, shown, _ in axes]
    layout["xaxis"] = {
        "tickvals": list(range(len(axes))),
        "ticktext": labels,
        "range": [-0.4, len(axes) - 0.6],
        "fixedrange": True,
        "showgrid": True,
        "gridcolor": "#9aa4b0",
        "zeroline": False,
        "automargin": True,
        # Labels point to the lower left, so that the last one fits.
        "tickangle": -35,
    }
    layout["yaxis"] = {"visible": False, "range": [-0.12, 1.12], "fixedrange": True}
    layout.annotations, layout.showlegend = marks, True
    caption = (
        "Each line is a design, each vertical line an axis from the lowest to the highest value of these designs; "
        f"up to {_MAX_LINES} designs of each colour."
    )
    return Picture("Designs across all axes", caption, go.Figure(data, layout), _PARALLEL_HEIGHT)


def _useful_range(values: np.ndarray, feasible: np.ndarray, front: np.ndarray) -> tuple[float, float]:
    """Range of the values of useful designs, widened by half of itself on both sides.

    Useful designs are the feasible ones; without any, all but the outermost ``_OUTER_SHARE`` on each side.
    """
    finite = values[feasible & np.isfinite(values)]
    if len(finite):
        low, high = float(finite.min()), float(finite.max())
    else:
        finite = values[np.isfinite(values)]
        if not len(finite):
            return 0.0, 1.0
        low, high = (float(end) for end in np.quantile(finite, [_OUTER_SHARE, 1.0 - _OUTER_SHARE]))
    room = _AXIS_ROOM * max(high - low, _LEAST_ROOM * max(abs(low), abs(high)))
    return low - room, high + room


def _axis_heights(values: np.ndarray, log: bool, drawn: np.ndarray) -> tuple[np.ndarray, tuple[float, float]]:
    """Values of an axis scaled to [0, 1], and the ends of the axis, those of the designs that are drawn."""
    finite = values[drawn & np.isfinite(values)]
    if len(finite) and np.all(drawn):
        finite = np.clip(finite, *np.quantile(finite, [_OUTER_SHARE, 1.0 - _OUTER_SHARE]))
    low, high = (float(finite.min()), float(finite.max())) if len(finite) else (0.0, 1.0)
    if log and 0 < low < high:
        return np.log(values / low) / np.log(high / low), (low, high)
    return (values - low) / ((high - low) or 1.0), (low, high)


def _design_lines(heights: np.ndarray, feasible: np.ndarray, front: np.ndarray) -> list[go.Scatter]:
    """Lines of designs by kind; designs that violate a constraint are drawn only if none is feasible."""
    finite = np.all((heights >= -_HEIGHT_ROUNDING) & (heights <= 1.0 + _HEIGHT_ROUNDING), axis=1)
    infeasible_rows = _evenly_chosen(np.flatnonzero(~feasible & finite), 0 if feasible.any() else _MAX_LINES)
    feasible_rows = _evenly_chosen(np.flatnonzero(feasible & finite), _MAX_LINES)
    best = _evenly_chosen(front[finite[front]], _MAX_LINES) if len(front) else front
    data = []
    for name, rows, style in (
        ("violates a constraint", infeasible_rows, {"color": MEASURED, "width": 0.7}),
        ("satisfies all constraints", feasible_rows, {"color": RESIDUAL, "width": 0.7}),
        ("best", best, {"color": MODEL, "width": 1.6}),
    ):
        # A gap after each design.
        y = single_precision(np.pad(heights[rows], ((0, 0), (0, 1)), constant_values=np.nan))
        x = np.broadcast_to(np.arange(y.shape[1]), y.shape)
        if len(rows):
            data.append(go.Scatter(mode="lines", name=name, x=x.ravel(), y=y.ravel(), line=style, hoverinfo="skip"))
    return data


def sensitivity_picture(sensitivity: Mapping[str, Mapping[str, Mapping[str, Any]]]) -> Picture:
    """Show the total Sobol indices, with a column for each parameter and a row for each metric.

    Args:
        sensitivity: ``sensitivity`` of sweep.json: indices by metric and parameter.
    """
    metrics = [name for name, indices in sensitivity.items() if indices]
    names = list(sensitivity[metrics[0]])
    layout = base_layout()
    layout["xaxis"] = {"side": "bottom", "automargin": True, "tickangle": -25}
    layout["yaxis"] = {"autorange": "reversed", "automargin": True}
    z = [[_resolved(sensitivity[metric][name]["total"]) for name in names] for metric in metrics]
    trace = go.Heatmap(
        x=[escape(n) for n in names],
        y=metrics,
        z=z,
        zmin=0,
        zmax=1,
        colorscale=[[0, "#ffffff"], [1, "#c8501e"]],
        text=[["-" if v is None else f"{abs(v):.2f}" for v in row] for row in z],
        texttemplate="%{text}",
        hovertemplate="%{y}<br>%{x}<br>%{z:.3f}<extra></extra>",
        colorbar={"thickness": 12, "outlinewidth": 0},
    )
    caption = "Total Sobol indices: the share of a metric's variance that would vanish if the parameter were fixed."
    height = _CELL_PIXELS * len(metrics) + _MATRIX_FRAME_PIXELS
    return Picture("Sensitivity", caption, go.Figure([trace], layout), height)


def _resolved(value: float | None) -> float | None:
    return value if is_resolved(value) else None


def _in_shown_unit(values: np.ndarray, unit: str, shown: str) -> np.ndarray:
    return np.asarray(from_si(np.asarray(values, float), shown, unit)) if shown != unit else np.asarray(values, float)


def _title(name: str, unit: str) -> str:
    return escape(name if unit == "1" else f"{name} [{unit}]")


def _points(name: str, x: np.ndarray, y: np.ndarray, marker: dict[str, Any], numbers: np.ndarray) -> go.Scatter:
    return go.Scatter(
        mode="markers",
        name=name,
        x=single_precision(x),
        y=single_precision(y),
        marker=marker,
        text=[str(n) for n in numbers],
        hovertemplate="design %{text}<br>%{x:.5g}, %{y:.5g}<extra></extra>",
    )


def _evenly_chosen(rows: np.ndarray, count: int) -> np.ndarray:
    """At most ``count`` rows, evenly spaced."""
    return rows[:count] if len(rows) <= count or not count else rows[np.linspace(0, len(rows) - 1, count).astype(int)]
