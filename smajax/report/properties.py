"""Document and summary of ``smajax properties``: mean properties of thermal cycles with 95 % intervals."""

from collections.abc import Mapping
from typing import Any

from smajax import __version__
from smajax.properties.recording_analysis import CycleAnalysis
from smajax.properties.refused_cycles import merge_refusals
from smajax.properties.stress_levels import StressGroup
from smajax.properties.thermal_cycles import Value, mean_properties
from smajax.report.documents.properties import PropertiesDocument
from smajax.report.summary import table

_LABELS = {
    "martensite_start": "M_s",
    "martensite_finish": "M_f",
    "austenite_start": "A_s",
    "austenite_finish": "A_f",
    "transformation_strain": "transformation strain",
    "actuation_strain": "actuation strain",
    "width": "hysteresis width",
    "span": "span A_f - M_f",
}
PROPERTY_HEAD = ("property", "mean", "95 % from", "to", "unit")
_STRAINS = ("transformation_strain", "actuation_strain")
_TEMPERATURE_DIFFERENCES = ("width", "span")
_DEFINITIONS: dict[str, str] = {
    "lines": "Start and finish are the intersections of three straight lines, fitted by least squares. If a "
    "transformation begins or ends gradually, the tangent at its steepest point gives other values "
    "(--tangent steepest).",
    "steepest": "Start and finish are the intersections of the tangent at the steepest point of the transformation "
    "with the plateau lines.",
}
_BRANCH_NAMES = {True: "cooling", False: "heating"}
_MISSING_PARTNERS = {"cooling": "heating after", "heating": "cooling before"}


def properties_document(analysis: CycleAnalysis, guessed: str | None = None) -> dict[str, Any]:
    """Build the document that ``smajax properties --json`` prints; its model is ``documents.properties``.

    Args:
        analysis: The cycles of all recordings, by recording and stress.
        guessed: Sentence on the values of the written parameter set that do not come from the cycles; ``None`` if none
            was written.
    """
    document = {
        "schema": PropertiesDocument.SCHEMA,
        "tangent": analysis.tangent,
        "definition": _DEFINITIONS[analysis.tangent],
        "recordings": [_group_entry(group) for group in analysis.groups],
        "refused": [str(refusal) for refusal in analysis.refused],
        "refused_merged": merge_refusals(analysis.refused),
        "smajax": __version__,
    }
    return PropertiesDocument.check(document if guessed is None else document | {"guessed": guessed})


def text(document: Mapping[str, Any], folder: str = "") -> str:
    """Format the mean properties of each recording and stress, with their intervals, for a terminal.

    Args:
        document: The document properties.json.
        folder: The result folder, which the last line names; empty for none.
    """
    lines = []
    for entry in document["recordings"]:
        if entry["mean"] is not None:
            lines += [*_group_text(entry), ""]
    sentences = document.get("refused_merged", document["refused"])  # absent in documents of earlier versions
    lines += [document["definition"], *(f"Not read: {sentence}." for sentence in sentences)]
    lines += [f"Results: {folder}"] if folder else []
    return "\n".join(lines).rstrip()


def _group_entry(group: StressGroup) -> dict[str, Any]:
    """Entry of the cycles of a recording at one stress; rows are counted from 1."""
    return {
        "name": group.recording.name,
        "sha256": group.recording.sha256,
        "stress_Pa": group.stress,
        "smoothed_rows": group.smooth,
        "mean": _value_entries(mean_properties(group.cycles)) if group.cycles else None,
        "cycles": [
            {
                "number": cycle.number,
                "rows": [cycle.rows[0] + 1, cycle.rows[1] + 1],
                "loops_left_out": [[first + 1, last + 1] for first, last in cycle.loops],
                "values": _value_entries(cycle.values),
            }
            for cycle in group.cycles
        ],
        "in_no_cycle": [
            {"rows": [first + 1, last + 1], "branch": _BRANCH_NAMES[cools]} for first, last, cools in group.unpaired
        ],
        "notes": list(group.recording.notes),
    }


def _value_entries(values: Mapping[str, Value]) -> dict[str, Any]:
    return {
        name: {"value": v.value, "lower95": v.lower95, "upper95": v.upper95, "unit": _unit(name)}
        for name, v in values.items()
    }


def _unit(name: str) -> str:
    return "1" if name in _STRAINS else "K" if name in _TEMPERATURE_DIFFERENCES else "degC"


def _group_text(entry: Mapping[str, Any]) -> list[str]:
    """Lines about the cycles of a recording at one stress."""
    rows = [PROPERTY_HEAD, *property_rows(entry)]
    return [group_title(entry), *table(rows, right=(1, 2, 3)), *left_out_sentences(entry)]


def group_title(entry: Mapping[str, Any]) -> str:
    """Return the title of a recording's cycles at one stress; ``entry`` is one of ``recordings`` of the document."""
    count, stress = len(entry["cycles"]), entry["stress_Pa"]
    head = f"{entry['name']}: {count} cycle{'s' if count > 1 else ''}"
    head += f" at {stress / 1e6:.4g} MPa" if stress is not None else ""
    return head + (f", temperatures smoothed over {entry['smoothed_rows']} rows" if entry["smoothed_rows"] > 1 else "")


def property_rows(entry: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows of the mean properties: name, mean, ends of the interval, unit."""
    rows = []
    for name, value in entry["mean"].items():
        scale, digits, unit = (100.0, 3, "%") if name in _STRAINS else (1.0, 2, _unit(name))
        numbers = (f"{scale * value[k]:.{digits}f}" for k in ("value", "lower95", "upper95"))
        rows.append((_LABELS[name], *numbers, unit))
    return rows


def left_out_sentences(entry: Mapping[str, Any]) -> list[str]:
    """List sentences about rows of a recording that are in no cycle, or in a minor loop of one."""
    lines = []
    for cycle in entry["cycles"]:
        for first, last in cycle["loops_left_out"]:
            lines.append(f"Left out of cycle {cycle['number']}: rows {first} to {last}, a loop within it.")
    for branch in entry["in_no_cycle"]:
        (first, last), kind = branch["rows"], branch["branch"]
        lines.append(f"Left out: rows {first} to {last}, a {kind} without a {_MISSING_PARTNERS[kind]} it in the file.")
    return lines + [f"Reading: {note}." for note in entry.get("notes", [])]  # absent in earlier documents
