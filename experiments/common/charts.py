"""Line charts of the experiments: a small SVG for the documentation, and a self-contained plotly page."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from html import escape
from pathlib import Path

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
_WIDTH, _HEIGHT = 760, 420
_LEFT, _RIGHT, _TOP, _BOTTOM = 76, 16, 40, 54


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
    paths[0].write_text(svg(chart), encoding="utf-8")
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


def svg(chart: Chart) -> str:
    """Return a chart as an SVG document."""
    x_axis = _Axis([v for c in chart.curves for v in c.x], chart.log_x, _LEFT, _WIDTH - _RIGHT)
    y_axis = _Axis([v for c in chart.curves for v in c.y], chart.log_y, _HEIGHT - _BOTTOM, _TOP)
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDTH} {_HEIGHT}" font-family="sans-serif" '
        'font-size="12" fill="#333333">',
        f'<rect width="{_WIDTH}" height="{_HEIGHT}" fill="white"/>',
        f'<text x="{_LEFT}" y="22" font-size="15">{escape(chart.title)}</text>',
        f'<text x="{(_LEFT + _WIDTH - _RIGHT) / 2}" y="{_HEIGHT - 12}" text-anchor="middle">{escape(chart.x)}</text>',
        f'<text transform="translate(18 {(_TOP + _HEIGHT - _BOTTOM) / 2}) rotate(-90)" '
        f'text-anchor="middle">{escape(chart.y)}</text>',
    ]
    for value in x_axis.ticks:
        position = x_axis(value)
        parts.append(
            f'<line x1="{position:.1f}" y1="{_TOP}" x2="{position:.1f}" y2="{_HEIGHT - _BOTTOM}" stroke="#e5e5e5"/>'
        )
        parts.append(f'<text x="{position:.1f}" y="{_HEIGHT - _BOTTOM + 17}" text-anchor="middle">{value:g}</text>')
    for value in y_axis.ticks:
        position = y_axis(value)
        parts.append(
            f'<line x1="{_LEFT}" y1="{position:.1f}" x2="{_WIDTH - _RIGHT}" y2="{position:.1f}" stroke="#e5e5e5"/>'
        )
        parts.append(f'<text x="{_LEFT - 7}" y="{position + 4:.1f}" text-anchor="end">{value:g}</text>')
    lines = [[(x_axis(x), y_axis(y)) for x, y in zip(curve.x, curve.y, strict=True)] for curve in chart.curves]
    left, first = _legend_corner([p for points in lines for p in points], 17 * len(lines))
    for i, (curve, colour, points) in enumerate(zip(chart.curves, _colours(len(chart.curves)), lines, strict=True)):
        if curve.steps:
            points = [p for (x0, y0), (x1, _) in itertools.pairwise(points) for p in ((x0, y0), (x1, y0))] + points[-1:]
        path = "M" + "L".join(f"{x:.1f} {y:.1f}" for x, y in points)
        style = f'stroke="{colour}" stroke-width="2"' + (' stroke-dasharray="6 4"' if curve.dashed else "")
        parts.append(f'<path d="{path}" fill="none" stroke-linejoin="round" {style}/>')
        row = first + 14 + 17 * i
        parts.append(f'<line x1="{left}" y1="{row - 4}" x2="{left + 22}" y2="{row - 4}" {style}/>')
        parts.append(
            f'<text x="{left + 28}" y="{row}" stroke="white" stroke-width="3" '
            f'paint-order="stroke">{escape(curve.name)}</text>'
        )
    return "\n".join([*parts, "</svg>"]) + "\n"


def _legend_corner(points: list[tuple[float, float]], height: int) -> tuple[float, float]:
    """Return left and top, in pixels, of the corner in which the fewest points lie."""
    corners = [(left, top) for left in (_WIDTH - 206, _LEFT + 10) for top in (_TOP, _HEIGHT - _BOTTOM - height - 6)]
    return min(
        corners, key=lambda c: sum(c[0] - 10 <= x <= c[0] + 200 and c[1] <= y <= c[1] + height + 6 for x, y in points)
    )


class _Axis:
    """An axis: maps values to pixels, and chooses the ticks."""

    def __init__(self, values: list[float], log: bool, start: float, stop: float):
        self._log, self._start, self._stop = log, start, stop
        self._low, self._high = (self._scaled(v) for v in (min(values), max(values)))
        margin = 0.04 * (self._high - self._low) or 0.5
        self._low = self._low - margin
        self._high = self._high + margin
        self.ticks = self._decades() if log else self._even()

    def _scaled(self, value: float) -> float:
        return math.log10(value) if self._log else value

    def __call__(self, value: float) -> float:
        return self._start + (self._scaled(value) - self._low) / (self._high - self._low) * (self._stop - self._start)

    def _decades(self) -> list[float]:
        factors = (1.0,) if self._high - self._low > 3 else (1.0, 2.0, 5.0)
        powers = range(math.floor(self._low), math.ceil(self._high) + 1)
        return [v for p in powers for f in factors if self._low <= math.log10(v := f * 10.0**p) <= self._high]

    def _even(self) -> list[float]:
        rough = (self._high - self._low) / 6
        unit = 10.0 ** math.floor(math.log10(rough))
        step = unit * next(f for f in (1, 2, 5, 10) if f * unit >= rough)
        return [round(k * step, 12) for k in range(math.ceil(self._low / step), math.floor(self._high / step) + 1)]


def _colours(count: int) -> list[str]:
    return [_COLOURS[i % len(_COLOURS)] for i in range(count)]
