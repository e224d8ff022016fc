"""Figures over time: measurement and model, several models, closed-loop responses."""

from __future__ import annotations  # plotly loads its classes when a figure is made

from collections.abc import Mapping, Sequence

import plotly.graph_objects as go

from smajax.channels import channel_of
from smajax.report.figures import (
    INPUT,
    MAX_POINTS_OF_MANY,
    MEASURED,
    MODEL,
    MODEL_COLOURS,
    RESIDUAL,
    Picture,
    axis_title,
    has_residual,
    line_trace,
    noise_band,
    panel_axis,
    panel_height,
    panel_layout,
    set_panel_title,
    thin_note,
)
from smajax.report.prediction import Series, split_label

_INPUT_COLOURS = (INPUT, "#7b4a94", "#8a6d1d", "#2f6f6f")
# Weights of panels: of a channel (smaller if many are observed), of a residual, of the inputs, of the two panels of a
# comparison, and of a response. Chosen by trial.
_CHANNEL_WEIGHT = 5.0
_CHANNEL_WEIGHT_OF_MANY = 2.6
_MANY_CHANNELS = 3
_RESIDUAL_WEIGHT = 2.2
_INPUT_WEIGHT = 1.8
_COMPARISON_WEIGHTS = (6.0, 4.0)
_RESPONSE_WEIGHT = 5.0
# Number of models that are visible at first; the others are switched on in the legend.
_MODELS_SHOWN = 3
_COMPARISON_HEIGHT = 760


def time_picture(
    series: Series, observed: Sequence[str], inputs: Sequence[str], floor: Mapping[str, float | None]
) -> Picture:
    """Show measurement and model, the residual with the noise band, and the inputs over time.

    Args:
        series: One recording with its model.
        observed: Channels to show; those that were measured have a residual.
        inputs: Input channels to show; those of one unit share a panel.
        floor: Standard deviation of the noise by channel, in the unit of the series.
    """
    groups: dict[str, list[str]] = {}
    for channel in inputs:
        if channel in series.measured:
            groups.setdefault(series.units[channel], []).append(channel)
    panels: list[tuple[str, float]] = []
    weight = _CHANNEL_WEIGHT if len(observed) < _MANY_CHANNELS else _CHANNEL_WEIGHT_OF_MANY
    for channel in observed:
        panels.append((channel, weight))
        if has_residual(series, channel):
            panels.append((f"residual of {channel}", _RESIDUAL_WEIGHT))
    panels += [(", ".join(group), _INPUT_WEIGHT) for group in groups.values()]
    layout = panel_layout(panels, series)
    data: list[go.Scatter] = []
    shapes: list[go.layout.Shape] = []
    thinned, panel = False, 0
    for channel in observed:
        thinned |= _add_channel(data, series, channel, panel)
        set_panel_title(layout, panel, axis_title(channel, series.units), panels)
        panel += 1
        if has_residual(series, channel):
            residual, axis = series.residual(channel), panel_axis(panel)
            trace, _ = line_trace(series.time, residual, f"residual of {channel}", RESIDUAL, axis, in_legend=False)
            data.append(trace)
            set_panel_title(layout, panel, axis_title("residual", {"residual": series.units[channel]}), panels)
            shapes += noise_band(floor.get(channel), axis)
            panel += 1
    for unit, group in groups.items():
        for colour, channel in zip(_INPUT_COLOURS, group, strict=False):
            values, axis = series.measured[channel], panel_axis(panel)
            data.append(line_trace(series.time, values, channel, colour, axis, in_legend=len(group) > 1)[0])
        title = axis_title(group[0], series.units) if len(group) == 1 else f"inputs [{unit}]"
        set_panel_title(layout, panel, title, panels)
        panel += 1
    layout.update(shapes=shapes)
    caption = _time_caption(any(has_residual(series, c) for c in observed), bool(floor))
    caption += thin_note(len(series.time), thinned)
    return Picture(f"{series.name} ({series.role})", caption, go.Figure(data, layout), panel_height(panels))


def comparison_picture(series: Mapping[str, Series], channel: str, role: str) -> Picture:
    """Show the predictions of several models over time; the first three are visible, the others can be switched on.

    Args:
        series: The recording with the prediction of each model by its name, best first.
        channel: The channel that is predicted.
        role: Role of the recording, for the title.
    """
    first = next(iter(series.values()))
    panels = list(zip((channel, "measured minus model"), _COMPARISON_WEIGHTS, strict=True))
    layout = panel_layout(panels, first)
    measured = first.measured[channel]
    trace, thinned = line_trace(
        first.time, measured, "measured", MEASURED, panel_axis(0), max_points=MAX_POINTS_OF_MANY
    )
    data = [trace]
    for k, (name, prediction) in enumerate(series.items()):
        colour = MODEL_COLOURS[k % len(MODEL_COLOURS)]
        for panel, values in enumerate((prediction.model[channel], prediction.residual(channel))):
            trace, is_thinned = line_trace(
                prediction.time,
                values,
                name,
                colour,
                panel_axis(panel),
                in_legend=panel == 0,
                max_points=MAX_POINTS_OF_MANY,
            )
            data.append(trace.update(legendgroup=name, visible=True if k < _MODELS_SHOWN else "legendonly"))
            thinned |= is_thinned
    set_panel_title(layout, 0, axis_title(channel, first.units), panels)
    difference = "measured - model"
    set_panel_title(layout, 1, axis_title(difference, {difference: first.units[channel]}), panels)
    caption = "Grey is measured. Click a name to show or hide a model; below, the residual of each model."
    caption += thin_note(len(first.time), thinned, MAX_POINTS_OF_MANY)
    title = f"{split_label(first.name)[0]} ({role})"
    return Picture(title, caption, go.Figure(data, layout), _COMPARISON_HEIGHT)


def response_picture(series: Sequence[Series], channel: str) -> Picture:
    """Show closed-loop rollouts over time: the channel with its reference, and a panel for each other kind of channel.

    Args:
        series: The rollouts; the reference is the measured channel of the first one.
        channel: The controlled channel.
    """
    first = series[0]
    kinds: dict[str, list[str]] = {}
    for name in first.model:
        if name != channel:
            kinds.setdefault(channel_of(name) or name, []).append(name)
    panels = [(channel, _RESPONSE_WEIGHT), *((kind, _RESIDUAL_WEIGHT) for kind in kinds)]
    layout = panel_layout(panels, first)
    data = [line_trace(first.time, first.measured[channel], "reference", MEASURED, panel_axis(0))[0]]
    thinned = False
    for k, rollout in enumerate(series):
        colour = (RESIDUAL, MODEL)[k % 2]
        trace, is_thinned = line_trace(rollout.time, rollout.model[channel], rollout.name, colour, panel_axis(0))
        data.append(trace.update(legendgroup=rollout.name))
        thinned |= is_thinned
        for panel, names in enumerate(kinds.values(), 1):
            data += _dashed_traces(rollout, names, colour, panel)
    set_panel_title(layout, 0, axis_title(channel, first.units), panels)
    for panel, names in enumerate(kinds.values(), 1):
        set_panel_title(layout, panel, axis_title(names[0], first.units), panels)
    caption = "Grey is the reference, blue the start gains, orange the tuned ones." + thin_note(
        len(first.time), thinned
    )
    if any(len(names) > 1 for names in kinds.values()):
        caption += " Dotted is the second wire."
    return Picture("Response", caption, go.Figure(data, layout), panel_height(panels))


def _add_channel(data: list[go.Scatter], series: Series, channel: str, panel: int) -> bool:
    """Adds measurement and model of a channel to a figure's data; returns whether points were left out."""
    thinned = False
    for name, values, colour in (("measured", series.measured, MEASURED), ("model", series.model, MODEL)):
        if channel in values:
            in_legend = not any(trace.name == name for trace in data)
            trace, is_thinned = line_trace(
                series.time, values[channel], name, colour, panel_axis(panel), in_legend=in_legend
            )
            data.append(trace)
            thinned |= is_thinned
    return thinned


def _time_caption(with_residual: bool, with_noise: bool) -> str:
    caption = "Grey is measured, orange the model."
    if with_residual:
        band = "; dotted lines: plus and minus two standard deviations of the noise." if with_noise else "."
        caption += f" Below, the residual, measured minus model{band}"
    return caption


def _dashed_traces(series: Series, names: Sequence[str], colour: str, panel: int) -> list[go.Scatter]:
    """Lines of the channels of one kind; the first line is solid, the others are dotted."""
    traces = []
    for k, name in enumerate(names):
        label = f"{series.name}, {name}"
        trace, _ = line_trace(series.time, series.model[name], label, colour, panel_axis(panel), in_legend=False)
        dash = "solid" if k == 0 else "dot"
        traces.append(trace.update(legendgroup=series.name, line={"dash": dash}))
    return traces
