"""The text of a rig that fits imported recordings: the template of its kind with values from the recordings."""

import tomllib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import tomlkit
from tomlkit.items import Table

from smajax import parameters
from smajax.errors import InputError
from smajax.files.rig_draft.kind import RigKind, suggest_kind
from smajax.files.rig_draft.observation import SUPPLY, Observation, choose_observation
from smajax.files.rig_draft.start_values import thermal_start, values_in
from smajax.files.rig_file import Rig, parse_rig
from smajax.files.rig_schema import PRESCRIBED_TEMPERATURE
from smajax.files.templates import set_value
from smajax.recordings.datasets import data_path
from smajax.recordings.recording import Recording

# Sections of a rig that describe the bench, as opposed to alloy, heat transfer and fit; a recording gives none of them.
_NOT_OF_BENCH = ("schema", "rig", "material", "heat", "environment", "fit")
# Nominal voltage of a supply of which nothing is known, and of which the fit or a regression finds the value.
_UNKNOWN_SUPPLY = "1 V"
# Digits of start values.
_DIGITS = 3
_AMBIENT = "environment.ambient"
_ASSUMED = "assumed: no recording gives it"
_FITTED = "start value, as no recording gives it"
_START = "start value, from the temperature of the recording"
# First line of the examples of sections in a template, which the sections of the recording replace, and the section
# after them, with an example line in it that the fit replaces.
_EXAMPLES, _FIT, _INITIAL = "# [channels]", "[fit]", 'initial = ["temperature"]'
# Column of the comments in the templates.
_COMMENT_COLUMN = 34


@dataclass(frozen=True)
class Assumption:
    """A value in a rig that no recording gives.

    Attributes:
        name: Name of the parameter.
        value: The value, as it is in the rig.
        meaning: What it is.
        is_fitted: Whether the value is where a fit begins, because it can find it.
    """

    name: str
    value: str
    meaning: str
    is_fitted: bool = False


@dataclass(frozen=True)
class RigDraft:
    """A rig for imported recordings.

    Attributes:
        kind: Its kind, and why.
        text: Text of the rig file.
        rig: The rig.
        assumptions: Values that no recording gives.
    """

    kind: RigKind
    text: str
    rig: Rig
    assumptions: tuple[Assumption, ...]


def draft_rig(
    recordings: Sequence[Recording],
    sections: str,
    name: str,
    *,
    kind: str | None = None,
    values: Mapping[str, str] | None = None,
) -> RigDraft:
    """Return a rig that reads a file and fits its recordings.

    Args:
        recordings: Recordings of the file.
        sections: Text of its sections ``[recording]`` and ``[channels]``.
        name: Name of the rig file, for messages.
        kind: Kind of the rig; by default that which the recordings suggest.
        values: Values by name, such as ``{"wire.diameter": "0.5 mm"}``.

    Raises:
        InputError: If the recordings suggest no rig, or a kind or a value is not possible.
    """
    given = dict(values or {})
    chosen = suggest_kind(recordings, kind)
    document = _template(chosen, sections)
    observation = choose_observation(chosen, recordings, list(document["fit"]["free"]), given)
    _set_control(document, chosen)
    assumed = _assumed_names(document, chosen, recordings, given)
    for parameter, (value, origin) in values_in(recordings).items():
        if parameter in assumed:
            assumed.remove(parameter)
            _set_parameter(document, parameter, value, origin)
    _set_values(document, given)
    _set_fit(document, observation)
    for parameter in assumed:
        _set_comment(document, parameter, _FITTED if parameter in observation.free else _ASSUMED)
    if SUPPLY in observation.free and "temperature" in observation.channels:
        _set_thermal_start(document, chosen, recordings, given, name)
    text = tomlkit.dumps(document)
    rig = parse_rig(text, name)
    _require_signals(rig, recordings)
    declarations = parameters.all_declarations(rig.plant)
    assumptions = tuple(
        Assumption(p, str(_item(document, p)), declarations[p].meaning, p in observation.free) for p in assumed
    )
    return RigDraft(chosen, text, rig, assumptions)


def _template(kind: RigKind, sections: str) -> Any:
    """Return the template of a kind with the sections of a recording in place of its examples of them."""
    text = data_path("templates", f"{kind.kind}.toml").read_text("utf-8")
    if kind.control == "duty":
        text = text.replace("\n[wire]", f'\n[drive]\nsupply = "{_UNKNOWN_SUPPLY}"\n\n[wire]')
    head, _, rest = text.partition(_EXAMPLES)
    fit = rest[rest.index(_FIT) :]
    fit = "\n".join(_INITIAL if line.startswith(f"# {_INITIAL}") else line for line in fit.splitlines())
    return tomlkit.parse("\n\n".join(part.strip() for part in (head, sections, fit) if part.strip()) + "\n")


def _set_control(document: Any, kind: RigKind) -> None:
    """Set the control and what depends on it."""
    if kind.control is None:
        return
    set_value(document["rig"], "control", kind.control)
    if kind.control == PRESCRIBED_TEMPERATURE:
        del document["heat"]
        set_value(document["rig"], "interpolation", "linear")
        return
    set_value(document["rig"], "interpolation", "hold")


def _assumed_names(
    document: Any, kind: RigKind, recordings: Sequence[Recording], given: Mapping[str, str]
) -> list[str]:
    """Return the names of the values that neither recording nor user gives."""
    if kind.kind == "path":
        return []
    names = [
        f"{section}.{key}"
        for section, content in document.items()
        if section not in _NOT_OF_BENCH and section not in ("recording", "channels") and isinstance(content, Table)
        for key in content
    ]
    if kind.control != PRESCRIBED_TEMPERATURE and "ambient" not in recordings[0].channels:
        names.append(_AMBIENT)
    return [name for name in names if name not in given]


def _set_values(document: Any, values: Mapping[str, str]) -> None:
    """Set values of the user; ``parse_rig`` checks their names."""
    for parameter, text in values.items():
        section, dot, key = parameter.partition(".")
        if not dot or not key:
            raise InputError(f"'{parameter}' is not the name of a value: write it like 'wire.diameter = 0.5 mm'")
        if section not in document:
            document[section] = tomlkit.table()
        value = _toml_value(text)
        if key in document[section]:
            set_value(document[section], key, value)
        else:
            document[section][key] = value


def _toml_value(text: str) -> Any:
    """Return a number, a truth value or a list as such, and any other text as a text."""
    try:
        return tomllib.loads(f"value = {text}")["value"]
    except tomllib.TOMLDecodeError:
        return text


def _set_parameter(document: Any, parameter: str, value: str, comment: str) -> None:
    section, key = parameter.split(".", 1)
    set_value(document[section], key, value)
    _set_comment(document, parameter, comment)


def _set_comment(document: Any, parameter: str, comment: str) -> None:
    section, key = parameter.split(".", 1)
    item = document[section].item(key)
    item.comment(comment)
    item.trivia.comment_ws = " " * max(_COMMENT_COLUMN - len(f"{key} = {item.as_string()}"), 1)


def _set_fit(document: Any, observation: Observation) -> None:
    fit = document["fit"]
    set_value(fit, "free", list(observation.free))
    set_value(fit, "observe", list(observation.channels))
    if not observation.initial:
        fit.pop("initial", None)


def _set_thermal_start(
    document: Any, kind: RigKind, recordings: Sequence[Recording], given: Mapping[str, str], name: str
) -> None:
    """Set the heat loss and the supply by a regression on the recorded temperature.

    Per volume, the heat of a duty u is u V^2 / (rho L^2), and that which is lost 4 h (T - T_ambient) / d.
    """
    plant = parse_rig(tomlkit.dumps(document), name).plant
    ambient = float(plant.environment.ambient)
    start = thermal_start(recordings, str(kind.control), ambient)
    if start is None:
        return
    capacity = float(parameters.get(plant, "heat.capacity_martensite"))
    resistivity = float(plant.material.resistivity_martensite)
    supply = float(plant.wire.length) * np.sqrt(start.heating * capacity * resistivity)
    loss = start.loss * capacity * float(plant.wire.diameter) / 4
    starts = ((SUPPLY, f"{supply:.{_DIGITS}g} V"), ("heat.h0", f"{loss:.{_DIGITS}g} W/m^2/K"))
    for parameter, value in (*starts, ("heat.h2", "0 W/m^2/K^3")):
        section, key = parameter.split(".")
        if parameter not in given and key in document[section]:
            _set_parameter(document, parameter, value, _START)


def _require_signals(rig: Rig, recordings: Sequence[Recording]) -> None:
    missing = [name for name in rig.plant.signals if name not in recordings[0].channels]
    if missing:
        has = ", ".join(recordings[0].channels)
        cure = "choose another kind of rig by --rig, or name the column by --channel"
        raise InputError(f"a {rig.kind} rig needs {' and '.join(missing)}, and the recording has {has}: {cure}")


def _item(document: Any, parameter: str) -> Any:
    section, key = parameter.split(".", 1)
    return document[section][key]
