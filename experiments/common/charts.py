"""Line charts of the experiments: a small SVG for the documentation, and a self-contained plotly page."""

import textwrap
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

# Distinguishable with colour blindness.
_COLOURS = (
    "#0072b2",
    "#d55e00",
    "#009e73",
    "#cc79a7",
    "#e69f00",
    "#56b4e9",
    "#333333",
    "#999999",
)
# The texts remain legible on a phone, whose pages are about 3.6 inches wide.
_INCHES = (5.2, 3.6)
_PANEL_INCHES = 3.2  # height of one of several panels
_POINTS = 10.5
# The largest number of curves whose names stand within the axes, and the distance of others below these.
_INSIDE = 2
_LEGEND_INCHES = 0.72
# Settings of matplotlib; a fixed salt of the names in a file keeps equal charts equal.
STYLE = {
    "svg.fonttype": "none",
    "svg.hashsalt": "smajax",
    "font.family": "sans-serif",
    "font.size": _POINTS,
    "axes.titlesize": "medium",
    "legend.fontsize": "medium",
    "axes.grid": True,
    "axes.edgecolor": "#e5e5e5",
    "axes.labelcolor": "#333333",
    "grid.color": "#e5e5e5",
    "xtick.color": "#333333",
    "ytick.color": "#333333",
    "lines.linewidth": 1.5,
    "legend.framealpha": 0.8,
}


@dataclass(frozen=True)
class Curve:
    """A named line through points.

    Attributes:
        name: Name in the legend.
        x: Abscissae.
        y: Ordinates.
        steps: Hold each value until the next point.
        dashed: Draw a dashed line, as for a reference.
    """

    name: str
    x: Sequence[float] | np.ndarray
    y: Sequence[float] | np.ndarray
    steps: bool = False
    dashed: bool = False


@dataclass(frozen=True)
class Chart:
    """A chart of several curves.

    Attributes:
        title: Title.
        x: Label of the abscissa.
        y: Label of the ordinate.
        curves: The curves.
        log_x: Whether the abscissa is logarithmic; its values are positive then.
        log_y: Whether the ordinate is.
    """

    title: str
    x: str
    y: str
    curves: Sequence[Curve]
    log_x: bool = False
    log_y: bool = False


def draw(chart: Chart, folder: Path, name: str) -> list[Path]:
    """Write NAME.svg and NAME.html into a folder.

    Args:
        chart: The chart.
        folder: The folder.
        name: Name of the files.

    Returns:
        The paths of the files.
    """
    paths = [folder / f"{name}.svg", folder / f"{name}.html"]
    write_svg(chart, paths[0])
    paths[1].write_text(_page(chart), encoding="utf-8")
    return paths


def _page(chart: Chart) -> str:
    import plotly.graph_objects as go

    figure = go.Figure()
    for curve, colour in zip(chart.curves, _colours(len(chart.curves)), strict=True):
        line = {
            "color": colour,
            "shape": "hv" if curve.steps else "linear",
            "dash": "dash" if curve.dashed else "solid",
        }
        figure.add_trace(go.Scatter(x=list(curve.x), y=list(curve.y), name=curve.name, mode="lines", line=line))
    figure.update_layout(title=chart.title, template="plotly_white")
    figure.update_xaxes(title=chart.x, type="log" if chart.log_x else "linear")
    figure.update_yaxes(title=chart.y, type="log" if chart.log_y else "linear")
    return figure.to_html(include_plotlyjs=True)


def write_svg(chart: Chart, path: Path) -> None:
    """Write a chart as an SVG file, with text as text; the same chart gives the same file."""
    write_panels([chart], path)


def write_panels(charts: Sequence[Chart], path: Path) -> None:
    """Write charts one below the other as an SVG file."""
    import matplotlib
    from matplotlib.figure import Figure

    with matplotlib.rc_context(STYLE):
        size = _INCHES[0], _INCHES[1] if len(charts) == 1 else _PANEL_INCHES * len(charts)
        figure = Figure(figsize=size, layout="constrained")
        for axes, chart in zip(np.ravel(figure.subplots(len(charts), squeeze=False)), charts, strict=True):
            _draw_axes(axes, chart)
        figure.savefig(path, format="svg", metadata={"Date": None})


def _draw_axes(axes: Any, chart: Chart) -> None:
    from matplotlib.ticker import FuncFormatter

    for curve, colour in zip(chart.curves, _colours(len(chart.curves)), strict=True):
        axes.plot(
            curve.x,
            curve.y,
            color=colour,
            label=curve.name,
            linestyle="--" if curve.dashed else "-",
            drawstyle="steps-post" if curve.steps else "default",
        )
    axes.set_title(chart.title, loc="left")
    axes.set(
        xlabel=chart.x,
        ylabel=chart.y,
        xscale="log" if chart.log_x else "linear",
        yscale="log" if chart.log_y else "linear",
    )
    for axis, is_log in ((axes.xaxis, chart.log_x), (axes.yaxis, chart.log_y)):
        if is_log:
            axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    if len(chart.curves) <= _INSIDE:
        axes.legend()
        return
    height = axes.figure.get_figheight() / len(axes.figure.axes)
    place = (0.43, -_LEGEND_INCHES / height)
    axes.legend(loc="upper center", bbox_to_anchor=place, ncols=2, handlelength=1.4, columnspacing=0.9)


def _colours(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]


@dataclass(frozen=True)
class Bars:
    """A group of horizontal bars.

    Attributes:
        title: Title of the group.
        names: Names of the bars, from the top.
        values: Their lengths.
    """

    title: str
    names: Sequence[str]
    values: Sequence[float]


# Inches of a line of a name and of a group's title, characters of such a line, and lines from one bar to the next name.
_LINE_INCHES, _TITLE_INCHES, _LINE_LENGTH, _BAR_LINES = 0.18, 0.55, 58, 1.5


def draw_bars(groups: Sequence[Bars], folder: Path, name: str, label: str) -> Path:
    """Write NAME.svg into a folder: groups of horizontal bars, one below the other.

    Args:
        groups: The groups.
        folder: The folder.
        name: Name of the file.
        label: Label of the abscissa.

    Returns:
        The path of the file.
    """
    import matplotlib
    from matplotlib.figure import Figure

    names = [[textwrap.wrap(name, _LINE_LENGTH) for name in group.names] for group in groups]
    # Places of the names from the top, and of the end, in lines.
    places = [np.cumsum([0.0, *(len(lines) + _BAR_LINES for lines in group)]) for group in names]
    heights = [_TITLE_INCHES + _LINE_INCHES * float(place[-1]) for place in places]
    path = folder / f"{name}.svg"
    with matplotlib.rc_context(STYLE | {"axes.grid.axis": "x", "axes.axisbelow": True}):
        figure = Figure(figsize=(_INCHES[0], sum(heights) + 0.3), layout="constrained")
        every = np.ravel(figure.subplots(len(groups), 1, height_ratios=heights, squeeze=False))
        for axes, group, texts, place in zip(every, groups, names, places, strict=True):
            ends = place[:-1] + [len(lines) for lines in texts]
            drawn = axes.barh(ends + 0.5, group.values, color=_COLOURS[0], height=0.9)
            axes.bar_label(drawn, fmt="%.2f", padding=3)
            for top, lines in zip(place, texts, strict=False):
                axes.annotate("\n".join(lines), (0.0, top), (2.0, 0.0), textcoords="offset points", va="top")
            axes.set(ylim=(place[-1], -0.3), yticks=[])
            axes.set_title(group.title, loc="left", weight="bold")
            axes.margins(x=0.12)
        axes.set_xlabel(label)
        figure.savefig(path, format="svg", metadata={"Date": None})
    return path
