"""Metrics of a tuning with their labels and units."""

import math
from collections.abc import Mapping
from typing import Any

from smajax.channels import CHANNELS
from smajax.report.prediction import usual_unit
from smajax.units import from_si

# Labels of the metrics by their names in tune.json.
LABELS = {
    "rmse": "RMSE",
    "max_error": "largest error",
    "itae": "ITAE",
    "rise": "rise 10 to 90 %",
    "settling": "settling",
    "overshoot": "overshoot",
    "energy": "energy",
    "mean_command": "mean command",
    "peak_temperature": "highest temperature",
    "peak_stress": "largest stress",
    "peak_current": "largest current",
}
_UNITS = {"rise": "s", "settling": "s", "energy": "J", "peak_temperature": "degC", "peak_current": "A"}


def format_entry(doc: Mapping[str, Any], value: float | None, name: str) -> str:
    """Format a metric of tune.json with its usual unit.

    Args:
        doc: The document tune.json.
        value: The metric in SI units or degC; ``None`` if there is none.
        name: Name of the metric.
    """
    return format_metric(value, name, doc["channel"], doc.get("command_unit") or "")


def format_metric(value: float | None, name: str, channel: str, command_unit: str = "") -> str:
    """Format a metric with its usual unit.

    Args:
        value: The metric in SI units or degC; ``None`` if there is none.
        name: Name of the metric, such as ``rmse``.
        channel: The controlled channel.
        command_unit: Unit of the command, if it is known.

    Returns:
        The text; ``-`` for ``None`` and for a value that is not finite, such as an infinite settling time.
    """
    if value is None or not math.isfinite(value):
        return "-"
    if name in ("rmse", "max_error", "itae", channel):
        unit = usual_unit(channel)
        number = from_si(value, unit, CHANNELS[channel].unit) if unit != "degC" else value
        unit = "K" if unit == "degC" and name != channel else unit  # a difference
        return f"{number:.4g} {unit}" + (" s\N{SUPERSCRIPT TWO}" if name == "itae" else "")
    if name == "overshoot":
        return f"{100 * value:.2f} %"
    if name == "peak_stress":
        return f"{value / 1e6:.4g} MPa"
    unit = command_unit if name == "mean_command" else _UNITS.get(name, "")
    return f"{value:.4g} {unit}".strip()
