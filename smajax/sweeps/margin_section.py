"""The section ``[margins]`` of a SWEEP.toml.

[margins]
vary = { "environment.ambient" = "3 K" }   # half width of a range around the value of the rig or the design
fit = "result"                             # the intervals of a fit
constraints = ["stroke"]                   # the constraints that have the margin; default: all but settling
"""

import itertools
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from smajax.control.tuning.plant_draws import confidence_axes
from smajax.errors import InputError
from smajax.files.renamed_keys import current_name
from smajax.files.result_folder import read_json
from smajax.files.toml import advice, flatten_keys, quantity_at, show, validate
from smajax.sweeps.margins import HIGHEST, LOWEST, Margins
from smajax.sweeps.schema import MarginSection
from smajax.sweeps.subject import RigSubject, Subject
from smajax.units import as_text

# Largest number of parameters whose ranges are combined: each doubles the number of simulations of a design.
_MAX_VARIED = 4


def read_margins(data: Mapping[str, Any], subject: Subject, folder: Path) -> Margins | None:
    """Read the margins, without the metrics that have them; see ``with_margins``.

    Args:
        data: Data of the sweep file.
        subject: The rig.
        folder: Folder from which the path of a fit starts.

    Returns:
        The margins; ``None`` without the section.

    Raises:
        InputError: If a key or value is not valid, or the rig is not the fitted one.
    """
    if "margins" not in data:
        return None
    section = validate(MarginSection, data["margins"], "margins")
    if not isinstance(subject, RigSubject):
        raise InputError("[margins] has no place with an actuator, only with a rig: take it out")
    widths = _read_widths(section, subject)
    if not widths and section.fit is None:
        raise InputError(
            '[margins] has neither vary nor fit: add a line like vary = { "environment.ambient" = "3 K" }, or '
            'fit = "FOLDER"'
        )
    names, axes = _fit_axes(section.fit, subject, folder) if section.fit is not None else ((), np.zeros((0, 0)))
    if both := [n for n in names if n in widths]:
        raise InputError(f"margins.vary has {both[0]}, whose interval is that of the fit already: take it out of vary")
    corners = tuple(
        (*row, *(0.0,) * len(names)) for row in itertools.product(*((-width, width) for width in widths.values()))
    )
    padding = (0.0,) * len(widths)
    return Margins(
        names=(*widths, *names),
        corners=corners if widths else (),
        axes=tuple((*padding, *map(float, axis)) for axis in axes),
        fit=section.fit or "",
    )


def _read_widths(section: MarginSection, subject: RigSubject) -> dict[str, float]:
    """Half widths of the ranges by parameter, in internal units."""
    widths = {}
    for key, text in flatten_keys(section.vary).items():
        name = current_name(key)
        if name not in subject.declarations:
            raise InputError(
                f"margins.vary: {name} is not a parameter of this rig"
                f"{advice(name, subject.declarations, 'its parameters are')}"
            )
        declaration = subject.declarations[name]
        if declaration.whole:
            raise InputError(f"margins.vary: {name} is a whole number, which has no margin: take it out")
        unit = "K" if declaration.unit == "degC" else declaration.unit
        widths[name] = quantity_at(text, unit, f"margins.vary.{name}")
        if not widths[name] > 0.0:
            raise InputError(f"margins.vary.{name} = {show(text)} is not above 0: give the half width of its range")
    if len(widths) > _MAX_VARIED:
        raise InputError(
            f"margins.vary has {len(widths)} parameters, and each doubles the simulations: take at most {_MAX_VARIED}"
        )
    return widths


def _fit_axes(name: str, subject: RigSubject, folder: Path) -> tuple[tuple[str, ...], np.ndarray]:
    """Parameters and half axes of the intervals of a fit, whose estimates must be the values of the rig."""
    document = read_json(folder / name, "fit.json")
    declarations = subject.declarations
    try:
        names, axes = confidence_axes(document, [n for n in document["parameters"] if n in declarations])
    except InputError as error:
        raise InputError(f"margins.fit: {error}") from None
    for parameter in names:
        entry, value = document["parameters"][parameter], subject.value(parameter)
        if not entry["lower95"] <= value <= entry["upper95"]:
            shown = as_text(value, declarations[parameter].unit)
            raise InputError(
                f"margins.fit: {parameter} of the rig is {shown}, outside of its interval in that fit: sweep the "
                'fitted rig, as in rig = "result/rig-fitted.toml"'
            )
    return names, axes


def with_margins(
    margins: Margins, data: Mapping[str, Any], constraints: Mapping[str, tuple[float, float]]
) -> tuple[Margins, dict[str, tuple[float, float]]]:
    """Return margins with their metrics, and constraints on these.

    Args:
        margins: The margins.
        data: Data of the sweep file.
        constraints: Lower and upper bound by metric.

    Raises:
        InputError: If there is no constraint that could have a margin.
    """
    section = validate(MarginSection, data["margins"], "margins")
    chosen = [n for n in constraints if n != "settling"] if section.constraints is None else section.constraints
    for name in chosen:
        if name not in constraints:
            raise InputError(
                f"margins.constraints: there is no constraint on {name}{advice(name, constraints, 'they are on')}"
            )
    if not chosen:
        raise InputError("[margins] needs a constraint that it applies to: add [constraints], or take it out")
    with_margin: dict[str, tuple[float, float]] = {}
    for name, (low, high) in constraints.items():
        if name not in chosen:
            with_margin[name] = (low, high)
            continue
        if np.isfinite(low):
            with_margin[f"{LOWEST}{name}"] = (low, np.inf)
        if np.isfinite(high):
            with_margin[f"{HIGHEST}{name}"] = (-np.inf, high)
    metrics = tuple(n for n in with_margin if n not in constraints)
    return Margins(margins.names, margins.corners, margins.axes, metrics, margins.fit), with_margin
