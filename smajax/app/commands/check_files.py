"""Descriptions of controller and sweep files for ``smajax check``."""

import math
from pathlib import Path

import numpy as np

from smajax.channels import CHANNELS, channel_of
from smajax.control.controller_file.read import read_controller
from smajax.control.loop.gains import gain, gains
from smajax.files.rig_file import Rig
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
    return [*lines, *(f"  Note: {note}" for note in content.notes)]


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
    limits = []
    units = content.subject.units
    for metric, (low, high) in content.constraints.items():
        limits += [f"{metric} at least {as_text(low, units[metric])}"] if math.isfinite(low) else []
        limits += [f"{metric} at most {as_text(high, units[metric])}"] if math.isfinite(high) else []
    lines.append(f"  Metrics: {', '.join(content.metrics)}.")
    lines.append(f"  Objectives: {', '.join(goals) or 'none'}. Constraints: {', '.join(limits) or 'none'}.")
    return lines
