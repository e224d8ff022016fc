"""Text and values of result documents (JSON)."""

import json
import math
from collections.abc import Mapping
from typing import Any


def to_json(document: Mapping[str, Any]) -> str:
    """Return a document as JSON text in the strict standard, which has neither NaN nor infinity."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def finite_or_none(value: Any, factor: float = 1.0) -> float | None:
    """Return a number as a float for a document, or ``None`` where it is missing, NaN or infinite.

    Args:
        value: A number, or ``None``.
        factor: Factor by which it is multiplied, such as that of a unit.
    """
    return None if value is None or not math.isfinite(value) else float(value) * factor


def is_undetermined(entry: Mapping[str, Any]) -> bool:
    """Return whether the data do not determine a parameter.

    A parameter is undetermined if it has no interval although it is not at a bound, or if the interval is wider than
    the range between its bounds.

    Args:
        entry: The parameter as in ``fit.json``: ``lower95``, ``upper95``, ``free``, ``at_bound`` and ``bounds``.
    """
    low, high = entry["lower95"], entry["upper95"]
    if low is None or high is None:
        return entry["free"] and not entry["at_bound"]
    lower, upper = entry.get("bounds") or (None, None)
    return lower is not None and upper is not None and high - low > upper - lower
