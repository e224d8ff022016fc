"""Figures of the uncertainty of parameters: profile likelihoods and correlations."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Sequence
from html import escape

import plotly.graph_objects as go

from smajax.report.figures import MODEL, RESIDUAL, Picture, axis_style, base_layout, level_line
from smajax.report.summary import RISE_95

_PROFILE_HEIGHT = 340
# Height of a matrix in pixels: the smallest one, and that of a row and of the frame.
_MIN_MATRIX_HEIGHT = 260
_CELL_PIXELS = 46
_MATRIX_FRAME_PIXELS = 130


def profile_picture(name: str, unit: str, values: Sequence[float | None], rise: Sequence[float | None]) -> Picture:
    """Show the profile likelihood of a parameter, with the level that bounds its 95 % interval.

    Args:
        name: The parameter.
        unit: Its unit.
        values: Values at which it was fixed; ``None`` for none.
        rise: Rise of the cost at each value; ``None`` for none.
    """
    layout = base_layout()
    layout["xaxis"] = axis_style(escape(f"{name} [{unit}]" if unit != "1" else name))
    layout["yaxis"] = axis_style("rise of the cost") | {"rangemode": "tozero"}
    layout["shapes"] = [level_line(RISE_95, "y", {"dash": "dot", "color": MODEL, "width": 1.5})]
    trace = go.Scatter(mode="lines+markers", line={"color": RESIDUAL}, showlegend=False, x=list(values), y=list(rise))
    caption = (
        "The smallest cost with the parameter fixed at each value and all others refitted; "
        "the dotted line bounds the 95 % interval."
    )
    return Picture(f"Profile likelihood of {name}", caption, go.Figure([trace], layout), _PROFILE_HEIGHT, False)


def correlation_picture(names: Sequence[str], matrix: Sequence[Sequence[float | None]]) -> Picture:
    """Show the correlations of the estimates as a matrix of colours from -1 to 1.

    Args:
        names: The parameters.
        matrix: Their correlations, row by row; ``None`` for none.
    """
    layout, labels = base_layout(), [escape(name) for name in names]
    size = max(_MIN_MATRIX_HEIGHT, _CELL_PIXELS * len(names) + _MATRIX_FRAME_PIXELS)
    layout["xaxis"] = {"side": "bottom", "automargin": True, "tickangle": -40, "constrain": "domain"}
    layout["yaxis"] = {"autorange": "reversed", "automargin": True, "scaleanchor": "x", "constrain": "domain"}
    trace = go.Heatmap(
        x=labels,
        y=labels,
        z=[list(row) for row in matrix],
        zmin=-1,
        zmax=1,
        colorscale=[[0, "#23648c"], [0.5, "#ffffff"], [1, "#c8501e"]],
        text=[["" if v is None else f"{v:.2f}" for v in row] for row in matrix],
        texttemplate="%{text}",
        hovertemplate="%{x}<br>%{y}<br>%{z:.3f}<extra></extra>",
        colorbar={"thickness": 12, "outlinewidth": 0},
    )
    caption = (
        "Correlations of the estimates. Pairs near 1 or -1 can change together with almost no effect on the residual."
    )
    return Picture("Correlations", caption, go.Figure([trace], layout), size, False)
