"""Keys and parameter names of files written before version 0.2, and the names as which they are read.

A renamed key is read under both names and written under the new one. A file that has both is refused, since one of the
two values would be lost.
"""

from collections.abc import Iterable, Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.toml import flatten_keys, line_numbers

# Parameter names, SECTION.KEY: the old one and the current one.
RENAMED_PARAMETERS: Mapping[str, str] = {
    "material.max_strain": "material.max_transformation_strain",
    "sheath.bend": "sheath.wrap_angle",
    "sheath.conduction": "sheath.conductance_ratio",
}
# Keys of a rig file that are no parameters.
RENAMED_RIG_KEYS: Mapping[str, str] = {"material.set": "rig.parameters"}


def current_name(name: str) -> str:
    """Return the current name of a parameter, ``SECTION.KEY`` or ``SECTION.KEY@RECORDING``."""
    parameter, at, recording = name.partition("@")
    return RENAMED_PARAMETERS.get(parameter, parameter) + at + recording


def current_names(names: Iterable[Any]) -> list[Any]:
    """Return the current names of a list of parameters; what is no text is passed on for the schema to refuse."""
    return [current_name(name) if isinstance(name, str) else name for name in names]


def with_current_names(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table whose keys are parameter names, dotted or as tables in tables, under their current names.

    Raises:
        InputError: if a parameter is given under both names.
    """
    flat = flatten_keys(table)
    for name in flat:
        if current_name(name) != name and current_name(name) in flat:
            raise InputError(_both_given(name, current_name(name)))
    return {current_name(name): value for name, value in flat.items()}


def with_current_keys(data: Mapping[str, Any], renamed: Mapping[str, str] = RENAMED_PARAMETERS) -> dict[str, Any]:
    """Return the sections of a file with renamed keys under their current names.

    A key that moves to a section that the file does not have stays, so that the missing section is reported.

    Args:
        data: Sections of a TOML file, each a table; other values are passed on.
        renamed: Old and current name of each key, ``SECTION.KEY``.

    Returns:
        The sections, as new tables.

    Raises:
        InputError: if a key is given under both names.
    """
    current = {section: dict(table) if isinstance(table, dict) else table for section, table in data.items()}
    for old, new in renamed.items():
        (old_section, old_key), (section, key) = old.split(".", 1), new.split(".", 1)
        source, target = current.get(old_section), current.get(section)
        if not isinstance(source, dict) or old_key not in source or not isinstance(target, dict):
            continue
        if key in target:
            raise InputError(_both_given(old, new))
        target[key] = source.pop(old_key)
    return current


def with_current_rig_keys(data: Mapping[str, Any]) -> dict[str, Any]:
    """Return the sections of a rig file with all renamed keys and parameter names under their current names.

    Raises:
        InputError: if a key is given under both names.
    """
    current = with_current_keys(data, {**RENAMED_PARAMETERS, **RENAMED_RIG_KEYS})
    fit = current.get("fit")
    if isinstance(fit, dict):
        for key in ("free", "per_recording"):
            if isinstance(fit.get(key), list):
                _refuse_both_in_list(fit[key])
                fit[key] = current_names(fit[key])
        if isinstance(fit.get("bounds"), dict):
            fit["bounds"] = with_current_names(fit["bounds"])
    return current


def current_line_numbers(text: str) -> dict[str, int]:
    """Return the row of each ``section.key`` of a rig or actuator file, under its current name."""
    return {RENAMED_RIG_KEYS.get(key, current_name(key)): row for key, row in line_numbers(text).items()}


def _refuse_both_in_list(names: Iterable[Any]) -> None:
    listed = [name for name in names if isinstance(name, str)]
    for name in listed:
        if current_name(name) != name and current_name(name) in listed:
            raise InputError(_both_given(name, current_name(name)))


def _both_given(old: str, new: str) -> str:
    return f"{old} is the old name of {new}, and both are given: take {old} out"
