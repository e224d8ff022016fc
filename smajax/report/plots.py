"""Pictures of a run as plotly figures, written as plain dictionaries (``data`` and ``layout``), so that no plotting library is loaded.

A picture of more than ``MOST_POINTS`` rows shows the lowest and the highest point of each of many short spans, which loses no peak, and
its caption says so; the table beside the report has all rows. A picture of many models has fewer points of each, ``MOST_OF_MANY``.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from html import escape
from itertools import pairwise
from typing import Any

import numpy as np

from smajax.recording import Floats
from smajax.report.prediction import Series, usual_unit
from smajax.units import channel_of

MOST_POINTS = 20_000
MOST_OF_MANY = 2_000
MEASURED, MODEL, RESIDUAL, INPUT = "#8b95a1", "#c8501e", "#23648c", "#4a7a3f"
MANY = (MODEL, RESIDUAL, INPUT, "#7b4a94", "#8a6d1d", "#2f6f6f", "#b0577f", "#5d6b2f", "#3c4f86", "#a3452c", "#6b6f76", "#1f7a5c")
INPUTS = (INPUT, "#7b4a94", "#8a6d1d", "#2f6f6f")
_DIGITS = 7
_PIXELS = 58  # of a panel of weight 1
_GAP = 24
_SLIM = 3.0


@dataclass(frozen=True)
class Picture:
    """A figure with what it shows in words; ``height`` in pixels. ``tall`` ones are wider than they are square."""

    title: str
    caption: str
    figure: dict[str, Any]
    height: int
    wide: bool = True


def time_picture(series: Series, observed: Sequence[str], inputs: Sequence[str], floor: Mapping[str, float | None]) -> Picture:
    """Measured against model, the residual between the noise floor's lines, and the inputs, over one axis of time.

    ``observed`` channels that were measured have a residual; ``floor`` is their noise in the series' unit.
    """
    panels: list[tuple[str, float]] = []
    weight = 5.0 if len(observed) < 3 else 2.6
    for channel in observed:
        panels += [(channel, weight)] + ([("residual of " + channel, 2.2)] if _compared(series, channel) else [])
    groups: dict[str, list[str]] = {}
    for channel in inputs:
        if channel in series.measured:
            groups.setdefault(series.units[channel], []).append(channel)
    panels += [(", ".join(group), 1.8) for group in groups.values()]
    data: list[dict[str, Any]] = []
    layout = _layout(panels, time_title(series), series)
    x, thinned = series.time, False
    row = 0
    for channel in observed:
        axis = _axis(row)
        for name, values, style in (("measured", series.measured, MEASURED), ("model", series.model, MODEL)):
            if channel in values:
                trace, less = _line(x, values[channel], name, style, axis, name_shown=not any(t["name"] == name for t in data))
                data.append(trace)
                thinned |= less
        _entitle(layout, row, titled(channel, series.units), panels)
        row += 1
        if _compared(series, channel):
            trace, less = _line(x, series.residual(channel), f"residual of {channel}", RESIDUAL, _axis(row), name_shown=False)
            data.append(trace)
            _entitle(layout, row, "residual", panels)
            layout["shapes"] += _band(floor.get(channel), _axis(row))
            row += 1
    for unit, group in groups.items():
        for colour, channel in zip(INPUTS, group, strict=False):
            data.append(_line(x, series.measured[channel], channel, colour, _axis(row), name_shown=len(group) > 1)[0])
        _entitle(layout, row, titled(group[0], series.units) if len(group) == 1 else f"inputs [{unit}]", panels)
        row += 1
    height = 144 + round(_PIXELS * sum(weight for _, weight in panels))
    caption = "Grey is measured, orange the model."
    if any(_compared(series, c) for c in observed):
        caption += " Below, measured minus model" + (", with two standard deviations of the noise either way dotted." if floor else ".")
    return Picture(f"{series.name} ({series.role})", caption + _thin_note(len(x), thinned), {"data": data, "layout": layout}, height)


def comparison_picture(series: Mapping[str, Series], channel: str, role: str) -> Picture:
    """One recording as several models predict it, best first, over time: the best three stand out, the others wait in the legend."""
    first = next(iter(series.values()))
    panels = [(channel, 6.0), ("model minus measured", 4.0)]
    layout = _layout(panels, time_title(first), first)
    data, thinned = [], False
    trace, thinned = _line(first.time, first.measured[channel], "measured", MEASURED, _axis(0), most=MOST_OF_MANY)
    data.append(trace)
    for k, (name, one) in enumerate(series.items()):
        colour = MANY[k % len(MANY)]
        for row, values in enumerate((one.model[channel], -one.residual(channel))):
            trace, less = _line(one.time, values, name, colour, _axis(row), name_shown=row == 0, most=MOST_OF_MANY)
            data.append(trace | {"legendgroup": name, "visible": True if k < 3 else "legendonly"})
            thinned |= less
    _entitle(layout, 0, titled(channel, first.units), panels)
    _entitle(layout, 1, "model - measured", panels)
    caption = "Grey is measured. Click a name to show or hide a model; below, what each leaves."
    caption += _thin_note(len(first.time), thinned, MOST_OF_MANY)
    return Picture(f"{first.name.rpartition(' (')[0]} ({role})", caption, {"data": data, "layout": layout}, 760)


def response_picture(series: Sequence[Series], channel: str) -> Picture:
    """Closed-loop rollouts over time: the channel with its reference, and what else each of them gives, a panel for each kind."""
    first = series[0]
    kinds: dict[str, list[str]] = {}
    for name in first.model:
        if name != channel:
            kinds.setdefault(channel_of(name) or name, []).append(name)
    panels = [(channel, 5.0), *((kind, 2.2) for kind in kinds)]
    layout = _layout(panels, time_title(first), first)
    data = [_line(first.time, first.measured[channel], "reference", MEASURED, _axis(0))[0]]
    thinned = False
    for k, one in enumerate(series):
        colour = (RESIDUAL, MODEL)[k % 2]
        trace, less = _line(one.time, one.model[channel], one.name, colour, _axis(0))
        data.append(trace | {"legendgroup": one.name})
        thinned |= less
        for row, names in enumerate(kinds.values(), 1):
            for i, name in enumerate(names):
                trace, _ = _line(one.time, one.model[name], f"{one.name}, {name}", colour, _axis(row), name_shown=False)
                data.append(trace | {"legendgroup": one.name, "line": trace["line"] | {"dash": "solid" if i == 0 else "dot"}})
    _entitle(layout, 0, titled(channel, first.units), panels)
    for row, names in enumerate(kinds.values(), 1):
        _entitle(layout, row, titled(names[0], first.units), panels)
    caption = "Grey is the reference, blue the start gains, orange the tuned ones." + _thin_note(len(first.time), thinned)
    if any(len(names) > 1 for names in kinds.values()):
        caption += " Dotted is the second wire."
    height = 144 + round(_PIXELS * sum(weight for _, weight in panels))
    return Picture("Response", caption, {"data": data, "layout": layout}, height)


def phase_picture(series: Series, channel: str) -> Picture | None:
    """The channel against temperature (stress and force against strain where there is one); ``None`` if the series has neither.

    Where the partner was recorded, measured goes over measured; else both go over the model's partner, which the axis says.
    """
    partners = _partners(series, channel)
    if not partners:
        return None
    data: list[dict[str, Any]] = []
    layout = base()
    thinned = False
    share = (1.0 - 0.12 * (len(partners) - 1)) / len(partners)
    for k, partner in enumerate(partners):
        x_key, y_key = (f"{axis}axis{k + 1 if k else ''}" for axis in "xy")
        both = partner in series.measured
        for name, values, style in (("measured", series.measured, MEASURED), ("model", series.model, MODEL)):
            across = series.measured if both and (name == "measured" or partner not in series.model) else series.model
            if channel in values and partner in across:
                axes = (f"x{k + 1 if k else ''}", f"y{k + 1 if k else ''}")
                trace, less = _line(across[partner], values[channel], name, style, axes[1], x_axis=axes[0], name_shown=k == 0)
                data.append(trace)
                thinned |= less
        start = k * (share + 0.12)
        across_title = titled(partner, series.units) + ("" if both else ", of the model")
        layout[x_key] = axis_style(across_title) | {"domain": [start, start + share], "anchor": y_key.replace("axis", "")}
        layout[y_key] = axis_style(titled(channel, series.units)) | {"anchor": x_key.replace("axis", "")}
    caption = f"The loops of {channel} over {' and '.join(partners)}: grey is measured, orange the model."
    caption += _thin_note(len(series.time), thinned)
    return Picture(f"Phase picture of {series.name} ({series.role})", caption, {"data": data, "layout": layout}, 460, len(partners) > 1)


def whiteness_picture(channel: str, looks: Mapping[str, Any]) -> Picture:
    """The residual's autocorrelation before and after, with the band that holds 99 % of white noise."""
    layout = base()
    layout["xaxis"] = axis_style("lag [samples]")
    layout["yaxis"] = axis_style("correlation")
    data = []
    for (when, look), colour in zip(looks.items(), (MEASURED, MODEL), strict=False):
        lags = list(range(1, len(look["autocorrelation"]) + 1))
        data.append(
            {"type": "scatter", "mode": "lines+markers", "name": when, "x": lags, "y": look["autocorrelation"], "line": {"color": colour}}
        )
        layout["shapes"] = layout.get("shapes", []) + _band(look["band_99"] / 2.0, "y")
    caption = "How far each residual goes with itself some samples before; between the dotted lines it looks like white noise."
    return Picture(f"Autocorrelation of the residual of {channel}", caption, {"data": data, "layout": layout}, 320, wide=False)


def free_form_picture(form: Mapping[str, Any]) -> Picture:
    """A term of free form against the state that it stands against."""
    layout = base()
    units = {"temperature": "degC", "martensite": "fraction", "travel": "full transformations"}
    layout["xaxis"] = axis_style(escape(f"{form['against']} [{units.get(form['against'], 's')}]"))
    layout["yaxis"] = axis_style(escape(f"{form['adds']} [{form['unit']}]" if form["unit"] != "1" else form["adds"]))
    line = {"type": "scatter", "mode": "lines+markers", "x": form["at"], "y": form["term"], "line": {"color": MODEL}, "showlegend": False}
    caption = "What would have to be added to the stage, as a function of the state. It describes what is missing and names no cause."
    return Picture(f"Free term in the {form['stage']} stage", caption, {"data": [line], "layout": layout}, 320, wide=False)


def profile_picture(name: str, unit: str, values: Sequence[float | None], rise: Sequence[float | None]) -> Picture:
    """The profile likelihood of one parameter, with the level that bounds its 95 % interval."""
    layout = base()
    layout["xaxis"] = axis_style(escape(f"{name} [{unit}]" if unit != "1" else name))
    layout["yaxis"] = axis_style("rise of the cost") | {"rangemode": "tozero"}
    layout["shapes"] = [_level(3.841, "y", {"dash": "dot", "color": MODEL, "width": 1.5})]
    points = {"x": list(values), "y": list(rise)}
    trace = {"type": "scatter", "mode": "lines+markers", "line": {"color": RESIDUAL}, "showlegend": False} | points
    caption = "The best cost with the parameter held at each value, all others fitted anew; the dotted line bounds the 95 % interval."
    return Picture(f"Profile likelihood of {name}", caption, {"data": [trace], "layout": layout}, 340, False)


def correlation_picture(names: Sequence[str], matrix: Sequence[Sequence[float | None]]) -> Picture:
    """Correlations of the estimates, as a matrix of colours from -1 to 1."""
    layout, labels = base(), [escape(name) for name in names]
    size = max(260, 46 * len(names) + 130)
    layout["xaxis"] = {"side": "bottom", "automargin": True, "tickangle": -40, "constrain": "domain"}
    layout["yaxis"] = {"autorange": "reversed", "automargin": True, "scaleanchor": "x", "constrain": "domain"}
    layout["hovermode"] = "closest"
    trace = {
        "type": "heatmap",
        "x": labels,
        "y": labels,
        "z": [list(row) for row in matrix],
        "zmin": -1,
        "zmax": 1,
        "colorscale": [[0, "#23648c"], [0.5, "#ffffff"], [1, "#c8501e"]],
        "text": [["" if v is None else f"{v:.2f}" for v in row] for row in matrix],
        "texttemplate": "%{text}",
        "hovertemplate": "%{x}<br>%{y}<br>%{z:.3f}<extra></extra>",
        "colorbar": {"thickness": 12, "outlinewidth": 0},
    }
    caption = "Correlations of the estimates. Pairs near 1 or -1 can trade places without the residual noticing."
    return Picture("Correlations", caption, {"data": [trace], "layout": layout}, size, False)


def thin(values: Floats, most: int = MOST_POINTS) -> np.ndarray:
    """The indices to draw of ``n`` values: all up to ``most``, else the first lowest and highest of each of ``most // 2`` equal spans."""
    n = len(values)
    if n <= most:
        return np.arange(n)
    edges = np.linspace(0, n, most // 2 + 1).astype(int)
    safe = np.where(np.isfinite(values), values, 0.0)
    kept = [first + offset for first, last in pairwise(edges.tolist()) for offset in _ends(safe[first:last])]
    return np.unique([0, *kept, n - 1])


def titled(channel: str, units: Mapping[str, str]) -> str:
    """An axis title: the channel with its unit."""
    unit = units.get(channel) or usual_unit(channel)
    return channel if unit == "1" else f"{channel} [{unit}]"


def time_title(series: Series) -> str:
    """The title of the axis of time, or of rows."""
    return f"time [{series.units['time']}]" if series.clock else "row"


def rounded(values: Floats) -> list[float | None]:
    """Floats for JSON, to seven digits; ``None`` where there is none, which leaves a gap in a line."""
    return [float(f"{v:.{_DIGITS}g}") if math.isfinite(v) else None for v in np.asarray(values, float).tolist()]


def _ends(part: Floats) -> tuple[int, int]:
    return int(np.argmin(part)), int(np.argmax(part))


def _compared(series: Series, channel: str) -> bool:
    return channel in series.measured and channel in series.model


def _partners(series: Series, channel: str) -> list[str]:
    there = [c for c in series.units if c in series.measured or c in series.model]
    if channel_of(channel) in ("stress", "force"):
        strained = [c for c in there if channel_of(c) == "strain" and c in series.measured]
        if strained:
            return strained
    return [c for c in there if channel_of(c) == "temperature" and c != channel]


def _line(
    x: Floats, y: Floats, name: str, colour: str, y_axis: str, *, x_axis: str = "x", name_shown: bool = True, most: int = MOST_POINTS
) -> tuple[dict[str, Any], bool]:
    rows = thin(y, most)
    trace = {
        "type": "scatter",
        "mode": "lines",
        "name": name,
        "x": rounded(x[rows]),
        "y": rounded(y[rows]),
        "xaxis": x_axis,
        "yaxis": y_axis,
        "line": {"color": colour, "width": 2.2 if colour == MEASURED else 1.2},
        "showlegend": name_shown,
        "hovertemplate": "%{y:.6g}",
    }
    return trace, len(rows) < len(y)


def _layout(panels: Sequence[tuple[str, float]], x_title: str, series: Series) -> dict[str, Any]:
    """Panels above one another over one x axis, each as high as its weight."""
    layout = base()
    total = sum(weight for _, weight in panels)
    gap = _GAP / (_PIXELS * total)
    room = 1.0 - gap * (len(panels) - 1)
    top = 1.0
    for k, (_, weight) in enumerate(panels):
        bottom = max(top - room * weight / total, 0.0)
        layout[f"yaxis{k + 1 if k else ''}"] = axis_style("") | {"domain": [bottom, top], "anchor": "x"}
        top = bottom - gap
    layout["xaxis"] = axis_style(x_title) | {"anchor": _axis(len(panels) - 1), "domain": [0, 1]}
    layout["shapes"] = []
    layout["hovermode"] = "x"
    return layout


def base() -> dict[str, Any]:
    """The layout that all pictures share."""
    return {
        "paper_bgcolor": "#ffffff",
        "plot_bgcolor": "#ffffff",
        "font": {"family": "system-ui, -apple-system, 'Segoe UI', Roboto, sans-serif", "size": 13, "color": "#22272e"},
        "margin": {"l": 74, "r": 16, "t": 58, "b": 52},
        "legend": {"orientation": "h", "x": 0, "y": 1.0, "yanchor": "bottom"},
        "hovermode": "closest",
    }


def axis_style(title: str) -> dict[str, Any]:
    """How an axis looks."""
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


def _entitle(layout: dict[str, Any], row: int, title: str, panels: Sequence[tuple[str, float]]) -> None:
    """Titles a panel's y axis; beside a low panel, in two small lines."""
    low = panels[row][1] < _SLIM
    found = layout[f"yaxis{row + 1 if row else ''}"]["title"]
    found["text"] = title.replace(" [", "<br>[") if low else title
    if low:
        found["font"] = {"size": 11}


def _axis(row: int) -> str:
    return f"y{row + 1 if row else ''}"


def _band(noise: float | None, axis: str) -> list[dict[str, Any]]:
    if not noise:
        return []
    return [_level(end, axis, {"dash": "dot", "color": MODEL, "width": 1}) for end in (-2 * noise, 2 * noise)]


def _level(value: float, axis: str, line: dict[str, Any]) -> dict[str, Any]:
    return {"type": "line", "x0": 0, "x1": 1, "xref": "paper", "y0": value, "y1": value, "yref": axis, "line": line}


def _thin_note(rows: int, thinned: bool, most: int = MOST_POINTS) -> str:
    return f" Of {rows:,} rows the picture draws the lowest and highest of every {math.ceil(2 * rows / most)}." if thinned else ""
