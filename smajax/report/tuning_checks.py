"""Sentences and table rows on the check of tuned gains: cases, jumps of the reference, what got worse, margins."""

from collections.abc import Mapping, Sequence
from typing import Any

from smajax.channels import CHANNELS
from smajax.control.analysis.cases import GROUPS
from smajax.control.analysis.margins import USUAL_MARGINS
from smajax.control.analysis.step_response import SETTLING_BAND
from smajax.report.prediction import usual_unit
from smajax.report.tuning_metrics import LABELS, format_entry
from smajax.units import from_si

# Increase of a metric, as a share of its value with the start gains, that a sentence names; of an overshoot, as a share
# of the jump.
_WORSE_SHARE = 0.05
_WORSE_OVERSHOOT = 0.005
# Number of jumps in a table; tune.json has all.
_MOST_JUMPS = 8
# Metrics for which less is better; a mean command is neither.
_COSTS = tuple(name for name in LABELS if name != "mean_command")
_RESPONSES = ("rise", "settling", "overshoot")
# Metrics of which the check names the largest value, first those with a limit.
_NAMED_WORST = ("overshoot", "settling", "rmse")
# Band of the settling time in words.
_BAND = f"within {100 * SETTLING_BAND:g} % of the jump"


def check_words(doc: Mapping[str, Any]) -> str:
    """Return sentences on the check on cases; empty for a document without one.

    Args:
        doc: The document tune.json.
    """
    check = doc.get("case_check")
    if not check:
        return ""
    groups = ", ".join(f"{count} for {GROUPS.get(key, key)}" for key, count in check["groups"].items())
    words = f" Judged on {check['cases']} rollouts that no search used ({groups})"
    if doc["limits"] and not check["beyond"]:
        words += ", all of which keep the limits"
    parts = [_worst_words(doc, name) for name in _NAMED_WORST if name in check["worst"]]
    words += f": {'; '.join(parts)}." if parts else "."
    if check["retunings"]:
        times = "once" if check["retunings"] == 1 else f"{check['retunings']} times"
        words += f" The gains were tuned again {times} for cases that missed a limit."
    return words


def _worst_words(doc: Mapping[str, Any], name: str) -> str:
    """A clause on the largest value of a metric over all cases."""
    worst = doc["case_check"]["worst"][name]
    value = format_entry(doc, worst["value"], name)
    if value == "-" and name == "settling":
        return f"a jump does not settle {_BAND} ({worst['case']})"
    return f"{LABELS[name]} at worst {value} ({worst['case']})"


def jump_name(doc: Mapping[str, Any], jump: Mapping[str, Any]) -> str:
    """Return the name of a jump, as in ``jump 2, 3 to 5 mm at 8 s``.

    Args:
        doc: The document tune.json.
        jump: Its entry of the jump.
    """
    before, after = (_channel_value(doc["channel"], jump[key]) for key in ("before", "after"))
    if before.split()[-1] == after.split()[-1]:
        before = before.rsplit(" ", 1)[0]
    return f"jump {jump['number']}, {before} to {after} at {jump['time']:.4g} s"


def _channel_value(channel: str, value: float) -> str:
    unit = usual_unit(channel)
    number = value if unit == "degC" else from_si(value, unit, CHANNELS[channel].unit)
    return f"{round(number, 9) + 0.0:.4g} {unit}"


def jump_rows(doc: Mapping[str, Any]) -> list[tuple[str, ...]]:
    """Return table rows for each jump: rise, settling and overshoot with start and tuned gains, and the worst case.

    Args:
        doc: The document tune.json.
    """
    rows = []
    for jump in doc.get("jumps") or ():
        if jump["number"] > _MOST_JUMPS:
            break
        size = abs(jump["after"] - jump["before"])
        for name in _RESPONSES:
            label = jump_name(doc, jump) if name == _RESPONSES[0] else ""
            cells = [_response_text(doc, jump[when][name], name, size) for when in ("start", "tuned")]
            if jump.get("worst"):
                cells.append(_response_text(doc, jump["worst"][name], name, size))
            rows.append((label, LABELS[name], *cells))
    return rows


def _response_text(doc: Mapping[str, Any], value: float | None, name: str, size: float) -> str:
    """A value of a step response with its unit; an overshoot also in the unit of the channel."""
    output = format_entry(doc, value, name)
    if name != "overshoot" or value is None:
        return output
    return f"{output}, {format_entry(doc, value * size, 'max_error')}"


def jump_head(doc: Mapping[str, Any]) -> tuple[str, ...]:
    """Return the head of the table of jumps.

    Args:
        doc: The document tune.json.
    """
    head = ("jump", "", "start", "tuned")
    return (*head, f"worst of {doc['case_check']['cases']}") if doc.get("case_check") else head


def further_jumps(doc: Mapping[str, Any]) -> str:
    """Return a sentence on jumps that the table leaves out; empty if there are none.

    Args:
        doc: The document tune.json.
    """
    more = len(doc.get("jumps") or ()) - _MOST_JUMPS
    return f"tune.json has {more} further jumps." if more > 0 else ""


def unsettled_words(doc: Mapping[str, Any]) -> str:
    """Return a sentence on jumps that do not reach or keep their settling band; empty if all do.

    Args:
        doc: The document tune.json.
    """
    names = [jump_name(doc, jump) for jump in doc.get("jumps") or () if jump["tuned"]["settling"] is None]
    if not names:
        return ""
    shown = "; ".join(names[:_MOST_JUMPS])
    return f" With the tuned gains not settled {_BAND} at the end of its hold: {shown}."


def worse_words(doc: Mapping[str, Any]) -> str:
    """Return a sentence on the metrics that are worse with the tuned gains than with the start gains.

    Args:
        doc: The document tune.json.
    """
    start, tuned = doc["metrics"]["start"], doc["metrics"]["tuned"]
    worse = []
    for name in _COSTS:
        if name not in tuned or not _is_worse(start[name], tuned[name], name):
            continue
        before, after = (format_entry(doc, v, name) for v in (start[name], tuned[name]))
        worse.append(f"{LABELS[name]} {after} instead of {before}" if after != "-" else f"{LABELS[name]} (not finite)")
    return f" Worse than with the start gains: {', '.join(worse)}." if worse else ""


def _is_worse(start: float | None, tuned: float | None, name: str) -> bool:
    if start is None or tuned is None:
        return start is not None
    most = _WORSE_OVERSHOOT if name == "overshoot" else _WORSE_SHARE * abs(start)
    return tuned > start + most


def usual_margin_words(doc: Mapping[str, Any]) -> str:
    """Return a sentence on median margins that are not the usual ones; empty if they are.

    Args:
        doc: The document tune.json.
    """
    margins, usual = doc["margins"]["tuned"], USUAL_MARGINS
    gain, phase, sensitivity = (margins.get(name) for name in ("gain", "phase", "sensitivity"))
    missed = [
        f"{label} {value:.3g} instead of {sign} {wanted:g}{unit}"
        for label, value, sign, wanted, unit, is_missed in (
            ("gain margin", gain, ">=", usual.gain, "", gain is not None and gain < usual.gain),
            ("phase margin", phase, ">=", usual.phase, " degrees", phase is not None and phase < usual.phase),
            (
                "largest sensitivity",
                sensitivity,
                "<=",
                usual.sensitivity,
                "",
                sensitivity is not None and sensitivity > usual.sensitivity,
            ),
        )
        if is_missed
    ]
    return f" The median margins are not the usual ones: {', '.join(missed)}." if missed else ""


def low_margin_rows(doc: Mapping[str, Any], labels: Mapping[str, str]) -> list[tuple[str, ...]]:
    """Return table rows of the margins at the worst twentieth of the operating points; none without them.

    Args:
        doc: The document tune.json.
        labels: Labels of the margins by name.
    """
    low = doc.get("low_margins")
    if not low:
        return []
    return [
        (f"{label}, worst 5 %", *("-" if low[when][name] is None else f"{low[when][name]:.3g}" for when in low))
        for name, label in labels.items()
    ]


def worst_cell(doc: Mapping[str, Any], name: str) -> str:
    """Return the worst value of a metric over all cases, with its unit.

    Args:
        doc: The document tune.json, with a check.
        name: Name of the metric.
    """
    worst = doc["case_check"]["worst"].get(name)
    return format_entry(doc, worst["value"], name) if worst else "-"


def padded(rows: Sequence[tuple[str, ...]], width: int) -> list[tuple[str, ...]]:
    """Return rows with empty cells up to a number of columns.

    Args:
        rows: The rows.
        width: Number of columns.
    """
    return [(*row, *[""] * (width - len(row))) for row in rows]
