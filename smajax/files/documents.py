"""Values of result documents (JSON)."""

import json
import math
from collections.abc import Mapping
from typing import Any


def to_json(document: Mapping[str, Any]) -> str:
    """Format a document as JSON text that any reader accepts: without NaN and infinity."""
    return json.dumps(document, indent=2, ensure_ascii=False, allow_nan=False) + "\n"


def finite_or_none(value: Any, factor: float = 1.0) -> float | None:
    """Return ``factor`` times a number as a float, or ``None`` where it is missing, NaN or infinite."""
    return None if value is None or not math.isfinite(value) else float(value) * factor


def is_undetermined(entry: Mapping[str, Any]) -> bool:
    """Tell whether the data do not determine a parameter.

    That is so where its interval is missing without a bound as the reason, or where it is wider than the range of its
    bounds.

    Args:
        entry: The parameter as in ``fit.json``: ``lower95``, ``upper95``, ``free``, ``at_bound`` and ``bounds``.
    """
    low, high = entry["lower95"], entry["upper95"]
    if low is None or high is None:
        return entry["free"] and not entry["at_bound"]
    lower, upper = entry.get("bounds") or (None, None)
    return lower is not None and upper is not None and high - low > upper - lower
