"""Figures of one channel against another: hysteresis loops over temperature, stress and force over strain."""

from __future__ import annotations  # plotly loads its classes when a figure is made

import plotly.graph_objects as go

from smajax.channels import channel_of
from smajax.report.figures import (
    MEASURED,
    MODEL,
    Picture,
    axis_style,
    axis_title,
    base_layout,
    line_trace,
    thin_note,
)
from smajax.report.prediction import Series

# Gap between two loops, as a share of the width. Chosen by trial.
_GAP = 0.12
_HEIGHT = 460


def phase_picture(series: Series, channel: str) -> Picture | None:
    """Show a channel against the temperatures; stress and force against strain if that was measured.

    If the other channel was measured, the measurement is drawn over it. If not, both lines are drawn over the model's
    channel, and the title of the axis says so.

    Args:
        series: One recording with its model.
        channel: The channel to show.

    Returns:
        The figure, or ``None`` if the series has no other channel for the abscissa.
    """
    partners = _partner_channels(series, channel)
    if not partners:
        return None
    data: list[go.Scatter] = []
    layout = base_layout()
    thinned = False
    width = (1.0 - _GAP * (len(partners) - 1)) / len(partners)
    for k, partner in enumerate(partners):
        suffix = f"{k + 1}" if k else ""
        traces, partner_thinned = _loop_traces(series, channel, partner, suffix)
        data += traces
        thinned |= partner_thinned
        start = k * (width + _GAP)
        title = axis_title(partner, series.units) + ("" if partner in series.measured else ", of the model")
        domain = {"domain": [start, start + width], "anchor": f"y{suffix}"}
        layout[f"xaxis{suffix}"] = axis_style(title) | domain
        layout[f"yaxis{suffix}"] = axis_style(axis_title(channel, series.units)) | {"anchor": f"x{suffix}"}
    caption = f"Loops of {channel} over {' and '.join(partners)}: grey is measured, orange the model."
    caption += thin_note(len(series.time), thinned)
    title = f"Phase plot of {series.name} ({series.role})"
    return Picture(title, caption, go.Figure(data, layout), _HEIGHT, len(partners) > 1)


def _loop_traces(series: Series, channel: str, partner: str, suffix: str) -> tuple[list[go.Scatter], bool]:
    """Lines of measurement and model over one other channel, and whether points were left out."""
    traces, thinned = [], False
    partner_measured = partner in series.measured
    for name, values, colour in (("measured", series.measured, MEASURED), ("model", series.model, MODEL)):
        over_measured = partner_measured and (name == "measured" or partner not in series.model)
        across = series.measured if over_measured else series.model
        if channel in values and partner in across:
            trace, trace_thinned = line_trace(
                across[partner],
                values[channel],
                name,
                colour,
                f"y{suffix}",
                x_axis=f"x{suffix}",
                in_legend=not suffix,
            )
            traces.append(trace)
            thinned |= trace_thinned
    return traces, thinned


def _partner_channels(series: Series, channel: str) -> list[str]:
    """Channels against which a channel is shown."""
    available = [c for c in series.units if c in series.measured or c in series.model]
    if channel_of(channel) in ("stress", "force"):
        strains = [c for c in available if channel_of(c) == "strain" and c in series.measured]
        if strains:
            return strains
    return [c for c in available if channel_of(c) == "temperature" and c != channel]
