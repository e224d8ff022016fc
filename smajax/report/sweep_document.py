"""Document sweep.json: best designs of a sweep, ranges of the metrics, sensitivities and refined designs."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

from smajax import __version__
from smajax.files.documents import finite_or_none
from smajax.report.documents.sweep import SweepDocument
from smajax.report.shown_values import format_in_unit, format_value, metric_entry
from smajax.report.sweep import sweep_summary
from smajax.sweeps.best_designs import BestDesigns
from smajax.sweeps.design_input import show_command, what_to_buy
from smajax.sweeps.metrics import SETTLED_GAP
from smajax.sweeps.pareto import constraint_violation, thin_front
from smajax.sweeps.problem import AbstractSweepProblem
from smajax.sweeps.refinement import RefinedDesign
from smajax.sweeps.sobol import complete_rows, missing_reason, sobol_indices, unresolved_indices
from smajax.sweeps.sweep_file import SweepFile

# Approximate number of designs of the front in the document: enough for a plot; the table has all.
_MAX_FRONT = 200
# Relative difference between a metric and its bound up to which it is at the bound; it only affects a message.
_AT_BOUND = 1e-3


def sweep_document(
    sweep: SweepFile,
    problem: AbstractSweepProblem,
    columns: Mapping[str, np.ndarray],
    sobol_columns: Mapping[str, np.ndarray],
    best: BestDesigns,
    refined: Sequence[RefinedDesign],
) -> dict[str, Any]:
    """Return the document sweep.json.

    Args:
        sweep: The sweep.
        problem: Problem that maps a design to its metrics.
        columns: Columns of the table of the sweep, shape ``(designs,)``, by name.
        sobol_columns: Columns of the designs of the Sobol indices, by name.
        best: The best designs.
        refined: The refined designs.
    """
    codes, counts = np.unique(columns["code"], return_counts=True)
    front, keeps = best.front_rows, best.feasible
    sensitivity, notes = _sensitivity(sweep, problem, sobol_columns)
    document: dict[str, Any] = {
        "schema": SweepDocument.SCHEMA,
        "sweep": sweep.name,
        "rig": sweep.subject.name,
        "sampling": sweep.sampling,
        "designs": len(keeps),
        "codes": {str(c): int(n) for c, n in zip(codes, counts, strict=True)},
        "feasible": int(keeps.sum()),
        "parameters": _axis_entries(sweep),
        "metrics": {n: {"unit": unit, **_span(columns[n])} for n, unit in problem.units.items()},
        "objectives": dict(sweep.objectives),
        "constraints": _constraint_entries(sweep, columns),
        "limits": {
            limit.metric: {
                "at_most": limit.value,
                "cycles": limit.cycles,
                "parameter_set": limit.parameter_set,
                "source": limit.source,
            }
            for limit in sweep.limits
        },
        **_margin_entry(sweep),
        "front": [_design_entry(sweep, problem, columns, k) for k in front[thin_front(best.costs[front], _MAX_FRONT)]],
        "on_front": len(front),
        "settling": _settling(columns, front, refined),
        "sensitivity": sensitivity,
        "sensitivity_notes": notes,
        "refined": [_refined_entry(sweep, design, k) for k, design in enumerate(refined, 1)],
        "problems": _problems(sweep, columns, keeps, refined),
        "seed": sweep.seed,
        "smajax": __version__,
    }
    document["purchase"] = _purchase(sweep, document)
    return SweepDocument.check(document | {"summary": sweep_summary(document)})


def _problems(
    sweep: SweepFile, columns: Mapping[str, np.ndarray], keeps: np.ndarray, refined: Sequence[RefinedDesign]
) -> list[str]:
    """Return the reasons why the sweep has no usable design."""
    if not np.any(columns["code"] == "done"):
        codes = ", ".join(np.unique(columns["code"]))
        return [f"none of the {len(keeps):,} designs could be simulated: {codes}"]
    if sweep.constraints and not keeps.any() and not any(design.better for design in refined):
        return [_infeasible_words(sweep, columns, refined)]
    return []


def _axis_entries(sweep: SweepFile) -> dict[str, Any]:
    return {
        axis.name: {
            "unit": axis.unit,
            "from": axis.lower,
            "to": axis.upper,
            "scale": "log" if axis.log else "even",
            "values": list(axis.values),
            **({"labels": list(axis.labels)} if axis.labels else {}),
            **({"catalogue": axis.catalogue} if axis.catalogue else {}),
        }
        for axis in sweep.axes
    }


def _constraint_entries(sweep: SweepFile, columns: Mapping[str, np.ndarray]) -> dict[str, Any]:
    """Return the constraints, with the numbers of simulated designs that violate them."""
    done = columns["code"] == "done"
    violated = {n: done & ~((columns[n] >= low) & (columns[n] <= high)) for n, (low, high) in sweep.constraints.items()}
    count = sum((mask.astype(int) for mask in violated.values()), np.zeros(len(done), int))
    return {
        n: {
            "at_least": finite_or_none(low),
            "at_most": finite_or_none(high),
            "excludes": int(violated[n].sum()),
            "excludes_alone": int((violated[n] & (count == 1)).sum()),
        }
        for n, (low, high) in sweep.constraints.items()
    }


def _margin_entry(sweep: SweepFile) -> dict[str, Any]:
    """Return the entry of the margins; empty without them."""
    margins = sweep.margins
    if margins is None:
        return {}
    widths = np.max(np.abs(margins.corners), axis=0) if margins.corners else np.zeros(len(margins.names))
    vary = {n: float(width) for n, width in zip(margins.names, widths, strict=True) if width > 0.0}
    declared = {n: sweep.subject.declarations[n].unit for n in vary}
    units = {n: "K" if unit == "degC" else unit for n, unit in declared.items()}
    return {"margins": {"metrics": list(margins.metrics), "vary": vary, "units": units, "fit": margins.fit}}


def _purchase(sweep: SweepFile, document: Mapping[str, Any]) -> str:
    """Return what to buy for the design that is best in the first objective, refined or sampled; empty for none."""
    if not sweep.objectives:
        return ""
    name, goal = next(iter(sweep.objectives.items()))
    rows = [*(entry for entry in document["refined"] if entry["better"]), *document["front"]]
    if not rows:
        return ""
    best = (max if goal == "max" else min)(rows, key=lambda row: float(row["metrics"][name]))
    return what_to_buy(sweep.subject, sweep.axes, best["parameters"])


def _span(values: np.ndarray) -> dict[str, Any]:
    """Return the lowest and highest value of a metric."""
    defined = values[~np.isnan(values)]
    if not len(defined):
        return {"lowest": None, "highest": None}
    return {"lowest": metric_entry(defined.min()), "highest": metric_entry(defined.max())}


def _design_entry(
    sweep: SweepFile, problem: AbstractSweepProblem, columns: Mapping[str, np.ndarray], k: int
) -> dict[str, Any]:
    return {
        "design": int(columns["design"][k]),
        "parameters": {axis.name: float(columns[axis.name][k]) for axis in sweep.axes},
        "metrics": {n: metric_entry(columns[n][k]) for n in problem.units},
    }


def _refined_entry(sweep: SweepFile, refined: RefinedDesign, number: int) -> dict[str, Any]:
    command = show_command(sweep.subject, number)
    return {
        "parameters": {axis.name: float(v) for axis, v in zip(sweep.axes, refined.design, strict=True)},
        "before": {n: metric_entry(v) for n, v in refined.before.items()},
        "metrics": {n: metric_entry(v) for n, v in refined.metrics.items()},
        "simulations": refined.simulations,
        "better": refined.better,
        "rescued": refined.restored,
        **({"command": command} if refined.better and command else {}),
    }


def _infeasible_words(sweep: SweepFile, columns: Mapping[str, np.ndarray], refined: Sequence[RefinedDesign]) -> str:
    """Return a sentence on the design nearest to the constraints, on the refined one, and on what both violate."""
    violation = np.where(columns["code"] == "done", constraint_violation(columns, sweep.constraints), np.inf)
    k = int(np.argmin(violation))
    nearest = {n: float(columns[n][k]) for n in sweep.constraints}
    words = f"none of the {len(violation):,} designs satisfies the constraints: the nearest, design "
    words += f"{int(columns['design'][k])}, has {', '.join(_violated(sweep, nearest))}"
    if not refined:
        return words
    last = min(refined, key=lambda design: float(constraint_violation(design.metrics, sweep.constraints)))
    place = ", ".join(
        f"{axis.name} {format_value(float(v), axis.unit)}" for axis, v in zip(sweep.axes, last.design, strict=True)
    )
    words += f"; its refinement does not satisfy them either and ended at {', '.join(_violated(sweep, last.metrics))}"
    bounds = [(n, bound) for n, pair in sweep.constraints.items() for bound in pair if np.isfinite(bound)]
    if binding := [n for n, bound in bounds if abs(last.metrics[n] - bound) <= _AT_BOUND * abs(bound)]:
        words += f" with {' and '.join(binding)} at the limit,"
    return f"{words} at {place}"


def _violated(sweep: SweepFile, metrics: Mapping[str, float]) -> list[str]:
    """Return the violated constraints with metric and allowed range, in the units of the sweep file."""
    words = []
    for name, (low, high) in sweep.constraints.items():
        if not low <= metrics[name] <= high:
            unit, written = sweep.problem().units[name], sweep.constraint_units[name]
            bounds = [(key, bound) for key, bound in (("at least", low), ("at most", high)) if np.isfinite(bound)]
            allowed = " and ".join(f"{key} {format_in_unit(bound, unit, written)}" for key, bound in bounds)
            words.append(f"{name} {format_in_unit(metrics[name], unit, written)} (allowed: {allowed})")
    return words


def _settling(columns: Mapping[str, np.ndarray], front: np.ndarray, refined: Sequence[RefinedDesign]) -> dict[str, Any]:
    """Return the numbers of designs that have not settled; empty for an actuator, which has no cycles."""
    if "settling" not in columns:
        return {}
    unsettled = (columns["code"] == "done") & ~(columns["settling"] <= SETTLED_GAP)
    return {
        "limit": SETTLED_GAP,
        "unsettled": int(unsettled.sum()),
        "unsettled_on_front": int(unsettled[front].sum()),
        "unsettled_refined": sum(design.better and not design.metrics["settling"] <= SETTLED_GAP for design in refined),
    }


def _sensitivity(
    sweep: SweepFile, problem: AbstractSweepProblem, columns: Mapping[str, np.ndarray]
) -> tuple[dict[str, Any], list[str]]:
    """Return the Sobol indices by metric, and sentences on the rows and indices that are missing."""
    if not len(columns["design"]):
        return {}, [note for note in [sweep.missing_indices_note()] if note]
    succeeded, axes = columns["code"] == "done", len(problem.names)
    entries, notes = {}, []
    failed = ~complete_rows(np.where(succeeded, 0.0, np.nan), axes)
    if failed.any():
        notes.append(
            f"Sobol indices leave out {failed.sum():,} of {len(failed):,} rows of designs, "
            "in which a simulation failed."
        )
    for name in problem.units:
        values = np.where(succeeded, columns[name], np.nan)
        indices = sobol_indices(values, problem.names, sweep.seed)
        if reason := missing_reason(values, axes):
            notes.append(f"No Sobol indices of {name}: {reason}.")
        elif outside := unresolved_indices(indices):
            notes.append(
                f"Not shown of {name}: {', '.join(outside)}, which lie outside of 0 to 1, where no index can be: "
                "the estimates from so few designs are too rough, and more designs make them precise."
            )
        if not reason and (missing := int(np.sum(~complete_rows(values, axes)) - failed.sum())):
            notes.append(f"Those of {name} leave out {missing:,} more rows, in which it has no value.")
        entries[name] = {
            axis: {key: _numbers(value) for key, value in index._asdict().items()} for axis, index in indices.items()
        }
    return entries, notes


def _numbers(value: float | tuple[float, float]) -> Any:
    return [finite_or_none(v) for v in value] if isinstance(value, tuple) else finite_or_none(value)
