"""The sections ``[objectives]`` and ``[constraints]`` of a SWEEP.toml, and the check of its metrics."""

import math
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from smajax.errors import InputError
from smajax.files.toml import advice, quantity_at, show, validate
from smajax.sweeps.margins import HIGHEST, LOWEST
from smajax.sweeps.schema import Limit
from smajax.sweeps.space import Axis
from smajax.sweeps.subject import METRIC_NAMES, Subject
from smajax.units import unit_of

GOALS = ("max", "min")
# Upper bounds of metrics by their definition: work is at most the energy, and a gap at most the range.
_UPPER_BOUNDS = {"efficiency": 1.0, "settling": 1.0}
# Metrics that are strains: a number above 1 was meant in percent.
_STRAINS = ("strain_range",)
# Units in which limits of the material are shown where the file has no constraint on the metric.
_LIMIT_UNITS = {"peak_stress": "MPa", "peak_temperature": "degC", "strain_range": "%"}


def check_metrics(place: str, names: Sequence[str], units: Mapping[str, str]) -> Sequence[str]:
    """Check names of metrics.

    Args:
        place: Key of the names in the file, for the message.
        names: Names of metrics.
        units: Internal units of the metrics that exist, by name.

    Returns:
        The names.

    Raises:
        InputError: If a name is not a metric.
    """
    for name in names:
        if name not in units:
            raise InputError(f"{place}: {show(name)} is not a metric{_unknown_metric(name, units)}")
    return names


def _unknown_metric(name: str, units: Mapping[str, str]) -> str:
    """End of a sentence about a metric that the subject does not have."""
    if name in METRIC_NAMES:
        return f" of this actuator, but of rigs with wires: its metrics are {', '.join(units)}"
    return advice(name, units, "the metrics are")


def read_objectives(data: Mapping[str, Any], units: Mapping[str, str]) -> dict[str, str]:
    """Read the objectives.

    Args:
        data: Data of the sweep file.
        units: Internal units of the metrics that exist, by name.

    Returns:
        ``max`` or ``min`` by metric.

    Raises:
        InputError: If a metric or its goal is not known.
    """
    section = data.get("objectives", {})
    if not isinstance(section, dict):
        raise InputError('[objectives] is a section, not a value: write lines like stroke = "max" below it')
    for name, goal in section.items():
        if name not in units:
            raise InputError(f"objectives.{name} is not a metric{_unknown_metric(name, units)}")
        if goal not in GOALS:
            raise InputError(f'objectives.{name} = {show(goal)} is not known: it is "max" or "min"')
    return dict(section)


def read_constraints(data: Mapping[str, Any], subject: Subject, axes: Sequence[Axis]) -> dict[str, tuple[float, float]]:
    """Read the constraints.

    Args:
        data: Data of the sweep file.
        subject: The rig or actuator, with its metrics.
        axes: Axes of the space.

    Returns:
        Lower and upper bound by metric, in internal units; infinite where there is none.

    Raises:
        InputError: If a constraint is not valid, or no design can satisfy it.
    """
    section = data.get("constraints", {})
    if not isinstance(section, dict):
        raise InputError(
            '[constraints] is a section: write lines like peak_temperature = { at_most = "120 degC" } below it'
        )
    constraints = {}
    for name, value in section.items():
        if name not in subject.units:
            raise InputError(f"constraints.{name} is not a metric{_unknown_metric(name, subject.units)}")
        limit = validate(Limit, value, f"constraints.{name}")
        constraints[name] = _read_bounds(name, limit, subject.units[name])
        _check_possible(name, limit, constraints[name], subject, axes)
    return constraints


def _read_bounds(name: str, limit: Limit, unit: str) -> tuple[float, float]:
    bounds = []
    for key, otherwise in (("at_least", -math.inf), ("at_most", math.inf)):
        text = getattr(limit, key)
        bounds.append(otherwise if text is None else quantity_at(text, unit, f"constraints.{name}.{key}"))
    if bounds == [-math.inf, math.inf]:
        raise InputError(f'constraints.{name} has no bound: write at_least = "..." or at_most = "..." in it')
    if bounds[0] > bounds[1]:
        shown = f"at least {show(limit.at_least)} and at most {show(limit.at_most)}"
        raise InputError(f"constraints.{name}: no value is {shown}: correct one of the two")
    return bounds[0], bounds[1]


def _check_possible(
    name: str, limit: Limit, bounds: tuple[float, float], subject: Subject, axes: Sequence[Axis]
) -> None:
    unit, (low, high) = subject.units[name], bounds
    for key, value in (("at_least", low), ("at_most", high)):
        if name in _STRAINS and 1.0 < value < math.inf:
            text = getattr(limit, key)
            raise InputError(
                f"constraints.{name}.{key} = {show(text)} is a strain of {100.0 * value:g} %, which no wire bears: "
                f'write "{value:g} %" if that is meant'
            )
    place = f"constraints.{name}: at_most = {show(limit.at_most)} can never be satisfied"
    if high < 0.0 and unit != "degC":
        raise InputError(f"{place}, as {name} is never negative: correct it")
    if high < (smallest := subject.lower_bound(name, axes)):
        raise InputError(f"{place}, as it is never below {smallest:g} {unit}: correct it")
    if low > (largest := _UPPER_BOUNDS.get(name, math.inf)):
        raise InputError(
            f"constraints.{name}: at_least = {show(limit.at_least)} can never be satisfied, as it is never above "
            f"{largest:g}: correct it"
        )


def constraint_units(data: Mapping[str, Any], constraints: Iterable[str]) -> dict[str, str]:
    """Return the unit in which each constraint is shown: that in the file, of two bounds that of the lower one.

    Args:
        data: Data of the sweep file.
        constraints: Names of the metrics that have a constraint, with margin or without.
    """
    section = data.get("constraints", {})
    written = {name: unit_of(limit.get("at_least", limit.get("at_most"))) for name, limit in section.items()}
    plain = {name: name.removeprefix(LOWEST).removeprefix(HIGHEST) for name in constraints}
    return {name: written.get(metric) or _LIMIT_UNITS.get(metric, "1") for name, metric in plain.items()}
