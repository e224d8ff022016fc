"""The shipped parameter sets, with the source of each value."""

import math

from docs.generate.markdown import code, table
from smajax.files.parameter_sets import find_set, read_header, read_parameters, shipped_sets
from smajax.units import as_text


def parameter_sets() -> str:
    """Return a section for each set."""
    return "\n".join(_section(name) for name in shipped_sets())


def _section(name: str) -> str:
    path = find_set(name)
    header, entries = read_header(path), read_parameters(path)
    rows = [
        (code(key), as_text(e.value, e.unit), _bounds(e.lower, e.upper, e.unit), e.source) for key, e in entries.items()
    ]
    text = f"\n## {name} {{ #{name} }}\n\n{header.get('title', '')}. {_sentence(header.get('source', ''))}\n\n"
    return text + table(("parameter", "value", "bounds", "source"), rows)


def _bounds(lower: float, upper: float, unit: str) -> str:
    if not (math.isfinite(lower) or math.isfinite(upper)):
        return ""
    ends = ("none" if not math.isfinite(end) else as_text(end, unit) for end in (lower, upper))
    return " to ".join(ends)


def _sentence(text: str) -> str:
    return f"Source: {' '.join(text.split())}." if text else ""
