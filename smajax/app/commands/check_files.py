"""Descriptions of controller and sweep files for ``smajax check``."""

import math
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from smajax.channels import CHANNELS, channel_of
from smajax.control.controller_file.read import ControllerFile, read_controller
from smajax.control.controller_file.search_sections import LIMIT_UNITS
from smajax.control.loop.gains import gain, gains
from smajax.control.tuning.controller_problem import draw_parameters
from smajax.files.rig_file import Rig
from smajax.report.shown_values import format_in_unit
from smajax.report.summary import table
from smajax.sweeps.sweep_file import read_sweep
from smajax.units import as_text


def describe_controller(path: Path, rig: Rig) -> list[str]:
    """Describe a controller file for its rig; nothing is simulated.

    Args:
        path: The file.
        rig: The rig.

    Raises:
        InputError: For a mistake in the file.
    """
    content = read_controller(path, rig)
    draw_parameters(rig, content, content.seed)  # raises for a folder of [robust] without a fit
    loop, scenario = content.loop, content.scenario
    channel = loop.channel
    unit = CHANNELS[channel_of(channel) or channel].unit
    reference = np.asarray(scenario.reference)
    period = float(loop.controller.period)
    low, high = (as_text(float(end), unit) for end in (reference.min(), reference.max()))
    lines = [
        f"{path.name}: {type(loop.controller).__name__} of {channel}, every {as_text(period, 's')}, for {rig.name}",
        f"  reference: {low} to {high} over {len(reference) * period:.6g} s",
    ]
    rows = []
    for name in gains(loop):
        bounds = content.bounds.get(name)
        tuned = "not tuned" if bounds is None else f"{bounds[0]:.4g} .. {bounds[1]:.4g}"
        rows.append((f"  {name}", f"{float(gain(loop, name)):.4g}", content.units.get(name, ""), tuned))
    lines += table([("  gain", "start", "unit", "searched"), *rows])
    lines.append(f"  Objective: {_objective_text(content)}. Limits: {_limits_text(content.limits)}.")
    return [*lines, *(f"  Note: {note}" for note in content.notes)]


def _objective_text(content: ControllerFile) -> str:
    """The terms of the objective with their weights."""
    terms = [f"{weight:g} {name}" for name, weight in content.weights.items()]
    return " + ".join(["settling"] if content.settle else terms)


def _limits_text(limits: Mapping[str, float]) -> str:
    shares = {name: f"{100.0 * value:g} %" for name, value in limits.items() if LIMIT_UNITS[name] == "1"}
    texts = {name: shares.get(name) or as_text(value, LIMIT_UNITS[name]) for name, value in limits.items()}
    return ", ".join(f"{name} at most {text}" for name, text in texts.items()) or "none"


def describe_sweep(path: Path) -> list[str]:
    """Describe a sweep file; no design is simulated.

    Args:
        path: The file.

    Raises:
        InputError: For a mistake in the file or in the rig that it names.
    """
    content = read_sweep(path)
    lines = [
        f"{path.name}: {content.count:,} designs of {content.subject.name} ({content.sampling}), seed {content.seed}"
    ]
    rows = []
    for axis in content.axes:
        ends = ", ".join(as_text(v, axis.unit) for v in axis.values) or " .. ".join(
            as_text(end, axis.unit) for end in (axis.lower, axis.upper)
        )
        rows.append((f"  {axis.name}", ends))
    lines += table([("  parameter", "range or values"), *rows])
    goals = [f"{metric} ({goal})" for metric, goal in content.objectives.items()]
    limits, units = [], content.problem().units
    for metric, (low, high) in content.constraints.items():
        bounds = [(words, bound) for words, bound in (("at least", low), ("at most", high)) if math.isfinite(bound)]
        written = content.constraint_units[metric]
        limits += [f"{metric} {words} {format_in_unit(bound, units[metric], written)}" for words, bound in bounds]
    lines.append(f"  Metrics: {', '.join(content.metrics)}.")
    lines.append(f"  Objectives: {', '.join(goals) or 'none'}. Constraints: {', '.join(limits) or 'none'}.")
    if content.limits:
        words = ", ".join(limit.in_words() for limit in content.limits)
        lines.append(f"  Limits of the material ({content.limits[0].parameter_set}): {words}.")
    return lines
