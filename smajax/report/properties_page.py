"""Figure and page of ``smajax properties``: strain against temperature with the transformation temperatures."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Mapping, Sequence
from html import escape
from typing import Any

import plotly.graph_objects as go

from smajax.report import pages
from smajax.report.figures import (
    MEASURED,
    MODEL,
    RESIDUAL,
    Picture,
    axis_style,
    axis_title,
    base_layout,
    line_trace,
    thin_note,
)
from smajax.report.prediction import Series
from smajax.report.properties import PROPERTY_HEAD, group_title, left_out_sentences, property_rows

# Labels of the transformation temperatures and colours of their lines: blue on cooling, orange on heating.
_TRANSFORMATIONS = {
    "martensite_start": ("M<sub>s</sub>", RESIDUAL),
    "martensite_finish": ("M<sub>f</sub>", RESIDUAL),
    "austenite_start": ("A<sub>s</sub>", MODEL),
    "austenite_finish": ("A<sub>f</sub>", MODEL),
}
_HEIGHT = 480


def cycles_picture(doc: Mapping[str, Any], series: Sequence[Series]) -> Picture:
    """Show strain against temperature, and the mean transformation temperatures with their 95 % intervals.

    Args:
        doc: The document properties.json.
        series: Recordings with the measured channels temperature and strain.
    """
    layout = base_layout()
    layout.showlegend = True
    layout.xaxis = axis_style(axis_title("temperature", series[0].units))
    layout.yaxis = axis_style(axis_title("strain", series[0].units))
    data, caption = [], "Dotted lines: mean temperatures of the transformations; shaded: their 95 % intervals."
    for recording in series:
        strain, temperature = recording.measured["strain"], recording.measured["temperature"]
        trace, thinned = line_trace(temperature, strain, escape(recording.name), MEASURED, "y")
        data.append(trace)
        caption += thin_note(len(strain), thinned)
    figure = go.Figure(data, layout)
    means = [entry["mean"] for entry in doc["recordings"] if entry["mean"] is not None]
    for mean in means:
        for name, (label, colour) in _TRANSFORMATIONS.items():
            entry = mean[name]
            figure.add_vrect(x0=entry["lower95"], x1=entry["upper95"], fillcolor=colour, opacity=0.15, line_width=0)
            line = {"dash": "dot", "color": colour, "width": 1}
            # The labels of several stresses would cover one another.
            figure.add_vline(x=entry["value"], line=line, annotation_text=label if len(means) == 1 else "")
    return Picture("Thermal cycles", caption, figure, _HEIGHT)


def properties_page(doc: Mapping[str, Any], series: Sequence[Series], run: Mapping[str, Any], rig: str) -> str:
    """Build the page of an analysis of thermal cycles.

    Args:
        doc: The document properties.json.
        series: Recordings with the measured channels temperature and strain.
        run: The document run.json.
        rig: Empty, as thermal cycles need no rig.

    Returns:
        The page as HTML.
    """
    pictures: list[Picture] = []
    sections = [pages.verdict_section([doc["definition"]])]
    for entry in doc["recordings"]:
        if entry["mean"] is not None:
            rows = property_rows(entry)
            sections += [f"<h2>{escape(group_title(entry))}</h2>", pages.table(PROPERTY_HEAD, rows, numbers=(1, 2, 3))]
            sections.append(pages.bullets(left_out_sentences(entry)))
    sections.append(pages.bullets([f"Not read: {sentence}." for sentence in doc["refused"]]))
    sections.append(pages.add_picture(cycles_picture(doc, series), pictures))
    sections += pages.provenance_sections(run, rig)
    names = ", ".join(dict.fromkeys(entry["name"] for entry in doc["recordings"]))
    return pages.render_page("Properties of thermal cycles", f"Properties of {names}.", sections, pictures)
