"""Common parts of the figures of a report, as classes of plotly.

A line of more than ``MAX_POINTS`` rows shows the lowest and the highest point of each of many short spans, so no peak
is lost, and the caption says so; prediction.csv has all rows. In a figure of many models a line has up to
``MAX_POINTS_OF_MANY`` points. The figures themselves are in ``time_figures``, ``phase_figures``,
``parameter_figures`` and ``diagnosis_figures``.
"""

from __future__ import annotations  # plotly loads its classes when a figure is made

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np
import plotly.graph_objects as go

from smajax.recordings.recording import Floats
from smajax.report.prediction import Series, usual_unit

# Largest number of points of a line: a browser zooms so many without delay.
MAX_POINTS = 20_000
# The same in a comparison of many models: a page of twelve models stays at a few megabytes.
MAX_POINTS_OF_MANY = 2_000
MEASURED, MODEL, RESIDUAL, INPUT = "#8b95a1", "#c8501e", "#23648c", "#4a7a3f"
# Colours of several models, in the order of their rank.
MODEL_COLOURS = (
    MODEL,
    RESIDUAL,
    INPUT,
    "#7b4a94",
    "#8a6d1d",
    "#2f6f6f",
    "#b0577f",
    "#5d6b2f",
    "#3c4f86",
    "#a3452c",
    "#6b6f76",
    "#1f7a5c",
)
# Height of a panel of weight 1, and the gap between two panels, in pixels.
_PANEL_PIXELS = 58
_GAP_PIXELS = 24
# Height of the title, the legend and the time axis, in pixels.
_FRAME_PIXELS = 144
# Margin above the panels, which has the legend, and height of the title above it, in pixels.
_TOP_PIXELS = 58
_TITLE_PIXELS = 26
# A panel of a smaller weight has its axis title in two lines of small print.
_LOW_PANEL = 3.0


@dataclass(frozen=True)
class Picture:
    """A figure with its title and caption.

    Attributes:
        title: Its title.
        caption: Explanation of the figure.
        figure: The plotly figure.
        height: Height in pixels.
        wide: Whether the figure takes the whole width of the page.
    """

    title: str
    caption: str
    figure: go.Figure
    height: int
    wide: bool = True

    def standalone(self) -> go.Figure:
        """Return the figure with its title and height, to be shown by itself, as in a notebook."""
        return go.Figure(self.figure).update_layout(
            title={"text": escape(self.title), "font": {"size": 15}, "y": 0.99, "yanchor": "top"},
            height=self.height + _TITLE_PIXELS,
            margin={"t": _TOP_PIXELS + _TITLE_PIXELS},
        )


def base_layout() -> go.Layout:
    """Return the layout that all figures share; it has no template."""
    return go.Layout(
        template="none",
        paper_bgcolor="#ffffff",
        plot_bgcolor="#ffffff",
        font={"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13, "color": "#22272e"},
        margin={"l": 74, "r": 16, "t": _TOP_PIXELS, "b": 52},
        legend={"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"},
        hovermode="closest",
    )


def axis_style(title: str) -> dict[str, Any]:
    """Return the settings of an axis with this title."""
    return {
        "title": {"text": title, "standoff": 8},
        "gridcolor": "#e7eaee",
        "zerolinecolor": "#c9d0d8",
        "linecolor": "#9aa4b0",
        "showline": True,
        "ticks": "outside",
        "tickcolor": "#9aa4b0",
        "automargin": True,
        "exponentformat": "power",
    }


def panel_layout(panels: Sequence[tuple[str, float]], series: Series) -> go.Layout:
    """Lay out panels above one another over one time axis.

    Args:
        panels: Name and weight of each panel, from the top; its height is proportional to the weight.
        series: The series that is shown, for the title of the axis.
    """
    layout = base_layout()
    total = sum(weight for _, weight in panels)
    gap = _GAP_PIXELS / (_PANEL_PIXELS * total)
    room = 1.0 - gap * (len(panels) - 1)
    top = 1.0
    for k, (_, weight) in enumerate(panels):
        bottom = max(top - room * weight / total, 0.0)
        layout[f"yaxis{k + 1 if k else ''}"] = axis_style("") | {"domain": [bottom, top], "anchor": "x"}
        top = bottom - gap
    layout["xaxis"] = axis_style(time_title(series)) | {"anchor": panel_axis(len(panels) - 1), "domain": [0, 1]}
    layout.hovermode = "x"
    return layout


def panel_height(panels: Sequence[tuple[str, float]]) -> int:
    """Return the height in pixels of a figure of panels, each with name and weight."""
    return _FRAME_PIXELS + round(_PANEL_PIXELS * sum(weight for _, weight in panels))


def panel_axis(panel: int) -> str:
    """Return plotly's name of the y axis of a panel, counted from 0."""
    return f"y{panel + 1 if panel else ''}"


def set_panel_title(layout: go.Layout, panel: int, title: str, panels: Sequence[tuple[str, float]]) -> None:
    """Set the title of a panel's y axis, in two small lines if the panel is low.

    Args:
        layout: The layout, which is changed.
        panel: Index of the panel.
        title: Title of its axis.
        panels: Name and weight of each panel.
    """
    low = panels[panel][1] < _LOW_PANEL
    entry: dict[str, Any] = {"text": title.replace(" [", "<br>[") if low else title}
    entry |= {"font": {"size": 11}} if low else {}
    layout.update({f"yaxis{panel + 1 if panel else ''}": {"title": entry}})


def line_trace(
    x: Floats,
    y: Floats,
    name: str,
    colour: str,
    y_axis: str,
    *,
    x_axis: str = "x",
    in_legend: bool = True,
    max_points: int = MAX_POINTS,
) -> tuple[go.Scatter, bool]:
    """Make the trace of a line.

    Args:
        x: Abscissae, shape ``(n,)``.
        y: Values, shape ``(n,)``; values that are not finite leave gaps.
        name: Name in the legend.
        colour: Colour of the line.
        y_axis: Plotly's name of the y axis.
        x_axis: Plotly's name of the x axis.
        in_legend: Whether the legend lists it.
        max_points: Largest number of points.

    Returns:
        The trace, and whether points were left out.
    """
    rows = thin_rows(y, max_points)
    trace = go.Scatter(
        mode="lines",
        name=name,
        x=single_precision(x[rows]),
        y=single_precision(y[rows]),
        xaxis=x_axis,
        yaxis=y_axis,
        line={"color": colour, "width": 2.2 if colour == MEASURED else 1.2},
        showlegend=in_legend,
        hovertemplate="%{y:.6g}",
    )
    return trace, len(rows) < len(y)


def thin_rows(values: Floats, max_points: int = MAX_POINTS) -> np.ndarray:
    """Choose the rows that are drawn: all, or the extremes of ``max_points // 2`` equal spans.

    Args:
        values: Values, shape ``(n,)``.
        max_points: Largest number of points without thinning.

    Returns:
        Rows in ascending order.
    """
    n = len(values)
    if n <= max_points:
        return np.arange(n)
    edges = np.linspace(0, n, max_points // 2 + 1).astype(int)
    finite = np.where(np.isfinite(values), values, 0.0)
    rows = [
        first + offset
        for first, last in pairwise(edges.tolist())
        for offset in (int(np.argmin(finite[first:last])), int(np.argmax(finite[first:last])))
    ]
    return np.unique([0, *rows, n - 1])


def thin_note(rows: int, thinned: bool, max_points: int = MAX_POINTS) -> str:
    """Return the sentence of a caption that says which rows are drawn; empty if all are.

    Args:
        rows: Number of rows.
        thinned: Whether rows were left out.
        max_points: Largest number of points of a line.
    """
    if not thinned:
        return ""
    return f" Of {rows:,} rows the picture draws the lowest and highest of every {math.ceil(2 * rows / max_points)}."


def single_precision(values: Floats) -> np.ndarray:
    """Return values in single precision, as many digits as a screen shows; plotly encodes such an array as bytes.

    Args:
        values: Values of any shape; those that are not finite, or too large, become NaN, a gap in a line.
    """
    with np.errstate(over="ignore", under="ignore"):
        single = np.asarray(values, np.float32)
    return np.where(np.isfinite(single), single, np.float32(np.nan))


def noise_band(noise: float | None, axis: str) -> list[go.layout.Shape]:
    """Return dotted lines at plus and minus two standard deviations of the noise; none if it is unknown.

    Args:
        noise: Standard deviation in the unit of the axis.
        axis: Plotly's name of the y axis.
    """
    if not noise:
        return []
    return [level_line(end, axis, {"dash": "dot", "color": MODEL, "width": 1}) for end in (-2 * noise, 2 * noise)]


def level_line(value: float, axis: str, line: dict[str, Any]) -> go.layout.Shape:
    """Return a horizontal line across the figure.

    Args:
        value: Its ordinate.
        axis: Plotly's name of the y axis.
        line: Plotly's style of the line.
    """
    return go.layout.Shape(type="line", x0=0, x1=1, xref="paper", y0=value, y1=value, yref=axis, line=line)


def axis_title(channel: str, units: Mapping[str, str]) -> str:
    """Return the title of an axis: the channel with its unit.

    Args:
        channel: The channel.
        units: Units by channel; a channel without one has its usual unit.
    """
    unit = units.get(channel) or usual_unit(channel)
    return channel if unit == "1" else f"{channel} [{unit}]"


def time_title(series: Series) -> str:
    """Return the title of the time axis, or of rows if there is no clock."""
    return f"time [{series.units['time']}]" if series.has_clock else "row"


def has_residual(series: Series, channel: str) -> bool:
    """Return whether a channel has a residual: it was measured and is modelled.

    Args:
        series: One recording with its model.
        channel: The channel.
    """
    return channel in series.measured and channel in series.model
