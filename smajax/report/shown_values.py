"""Values of documents in the units that people read."""

from collections.abc import Mapping
from typing import Any

import numpy as np

from smajax.files.documents import finite_or_none
from smajax.units import display_unit, from_si

# Units that are shown unchanged, since no multiple of them is more usual.
_UNSCALED_UNITS = ("1", "J", "Hz", "s", "degC", "K")


def shown_unit(unit: str) -> str:
    """Return the unit in which a value with an internal ``unit`` is shown."""
    return unit if unit in _UNSCALED_UNITS else "deg" if unit == "rad" else display_unit(unit)


def metric_entry(value: float) -> float | str | None:
    """Return a metric as JSON can store it: ``"inf"`` and ``"-inf"`` for infinities, ``None`` for NaN."""
    return str(float(value)) if np.isinf(value) else finite_or_none(value)


def format_value(value: float | str | None, unit: str) -> str:
    """Format a value of the document in its shown unit.

    Args:
        value: The value in its internal unit, as ``metric_entry`` returns it.
        unit: Its internal unit.

    Returns:
        The number with its unit; ``-`` for ``None``.
    """
    if value is None:
        return "-"
    if np.isinf(float(value)):
        return "infinite" if float(value) > 0.0 else "minus infinite"
    size = float(from_si(float(value), shown_unit(unit), unit)) if shown_unit(unit) != unit else float(value)
    return f"{size:.4g}" + ("" if unit == "1" else f" {shown_unit(unit)}")


def format_in_unit(value: float, unit: str, written: str, digits: int = 4) -> str:
    """Format a value in the unit of a file.

    Args:
        value: The value in its internal unit; may be infinite.
        unit: Its internal unit.
        written: The unit of the file.
        digits: Number of significant digits.
    """
    size = float(from_si(float(value), written, unit)) if np.isfinite(value) else float(value)
    return f"{size:.{digits}g}" + ("" if written == "1" else f" {written}")


def format_parameter(value: float, entry: Mapping[str, Any]) -> str:
    """Format a value of a parameter of a sweep.

    Args:
        value: The value in its internal unit.
        entry: Entry of the parameter in sweep.json.

    Returns:
        The number with its unit, or the name of a listed value.
    """
    labels = entry.get("labels")
    return labels[round(value)] if labels else format_value(value, entry["unit"])
