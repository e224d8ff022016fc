"""Figures of a diagnosis: autocorrelation of the residual, and the nonparametric term."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Mapping, Sequence
from html import escape
from itertools import pairwise
from typing import Any

import plotly.graph_objects as go

from smajax.report.figures import (
    INPUT,
    MEASURED,
    MODEL,
    RESIDUAL,
    Picture,
    axis_style,
    base_layout,
    level_line,
    noise_band,
)

_HEIGHT = 320
# Units of the states of which a nonparametric term can be a function; times are in s.
_UNITS = {"temperature": "degC", "martensite": "fraction", "travel": "full transformations"}


def autocorrelation_picture(channel: str, statistics: Mapping[str, Any]) -> Picture:
    """Show the autocorrelation of a channel's residual before and after, with the 99 % band of white noise.

    Args:
        channel: The channel.
        statistics: Statistics of the residual by fit ("before", "after"), with ``autocorrelation`` and ``band_99``.
    """
    layout = base_layout()
    layout["xaxis"] = axis_style("lag [samples]")
    layout["yaxis"] = axis_style("correlation")
    data, shapes = [], []
    for (name, entry), colour in zip(statistics.items(), (MEASURED, MODEL), strict=False):
        data.append(
            go.Scatter(
                mode="lines+markers",
                name=escape(name),
                x=list(range(1, len(entry["autocorrelation"]) + 1)),
                y=entry["autocorrelation"],
                line={"color": colour},
            )
        )
        shapes += noise_band(entry["band_99"] / 2.0, "y")
    layout.update(shapes=shapes)
    caption = "Autocorrelation of the residual; dotted lines: 99 % band of white noise."
    title = f"Autocorrelation of the residual of {channel}"
    return Picture(title, caption, go.Figure(data, layout), _HEIGHT, wide=False)


def nonparametric_picture(term: Mapping[str, Any]) -> Picture:
    """Show a nonparametric term as a function of its state; ``term`` is ``free_form`` of diagnosis.json."""
    layout = base_layout()
    layout["xaxis"] = axis_style(escape(f"{term['against']} [{_UNITS.get(term['against'], 's')}]"))
    layout["yaxis"] = axis_style(escape(f"{term['adds']} [{term['unit']}]" if term["unit"] != "1" else term["adds"]))
    line = go.Scatter(mode="lines+markers", x=term["at"], y=term["term"], line={"color": MODEL}, showlegend=False)
    caption = "The term that the stage lacks, as a function of the state. It describes what is missing, not its cause."
    title = f"Nonparametric term in the {term['stage']} stage"
    return Picture(title, caption, go.Figure([line], layout), _HEIGHT, wide=False)


def budget_picture(channel: str, noise: float | None, entries: Sequence[Mapping[str, Any]]) -> Picture:
    """Show the errors on the holdout as a waterfall, in the order in which things were added to the model.

    Args:
        channel: The channel.
        noise: Its noise, in the unit; ``None`` if unknown.
        entries: ``error_budget`` of diagnosis.json.
    """
    naive, *channels = [entry["channels"][channel] for entry in entries]
    errors, unit = [c["holdout"] for c in channels], naive["unit"]
    layout = base_layout()
    layout["yaxis"] = axis_style(escape(f"error on the holdout [{unit}]")) | {"rangemode": "tozero"}
    layout["xaxis"] = {"type": "category", "automargin": True}
    layout["showlegend"] = False
    labels = ["-" if error is None else f"{error:.3g}" for error in errors]
    bars = go.Waterfall(
        x=[*(escape(entry["added"]) for entry in entries[1:]), "all"],
        y=[errors[0], *(None if None in pair else pair[1] - pair[0] for pair in pairwise(errors)), None],
        measure=["absolute", *["relative"] * (len(errors) - 1), "total"],
        text=[*labels, labels[-1]],
        textposition="outside",
        decreasing={"marker": {"color": INPUT}},
        increasing={"marker": {"color": MODEL}},
        totals={"marker": {"color": RESIDUAL}},
        connector={"line": {"color": MEASURED, "width": 1}},
    )
    if noise is not None:
        layout["shapes"] = [level_line(noise, "y", {"dash": "dot", "color": MEASURED, "width": 1.5})]
    forecast = "none" if naive["holdout"] is None else f"{naive['holdout']:.3g} {unit}"
    caption = (
        "Error on the holdout of the rig's own model, and with each thing added in turn. The dotted line is the noise. "
        f"The error of a naive forecast, the mean of the training recording, is {forecast}."
    )
    return Picture(f"Error budget of {channel}", caption, go.Figure([bars], layout), _HEIGHT, wide=True)
