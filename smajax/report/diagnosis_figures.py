"""Figures of a diagnosis: autocorrelation of the residual, and the nonparametric term."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Mapping
from html import escape
from typing import Any

import plotly.graph_objects as go

from smajax.report.figures import MEASURED, MODEL, Picture, axis_style, base_layout, noise_band

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
                name=name,
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
