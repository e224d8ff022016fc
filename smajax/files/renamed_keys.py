"""Renamed keys: keys and parameter names of files written before version 0.2, and their current names.

A renamed key is read under both names and written under the current one. A file with both names is refused, since one
of the two values would be lost.
"""

from collections.abc import Collection, Iterable, Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.toml import flatten_keys, line_numbers

# Parameter names, SECTION.KEY: the old one and the current one.
RENAMED_PARAMETERS: Mapping[str, str] = {
    "material.max_strain": "material.max_transformation_strain",
    "sheath.bend": "sheath.wrap_angle",
    "sheath.conduction": "sheath.conductance_ratio",
}
# Keys of a rig file that are not parameters.
RENAMED_RIG_KEYS: Mapping[str, str] = {"material.set": "rig.parameters"}


def current_name(name: str) -> str:
    """Return the current name of a parameter, ``SECTION.KEY`` or ``SECTION.KEY@RECORDING``."""
    parameter, at, recording = name.partition("@")
    return RENAMED_PARAMETERS.get(parameter, parameter) + at + recording


def current_names(names: Iterable[Any]) -> list[Any]:
    """Return the current names of a list of parameters; entries that are not text are left to the schema to refuse."""
    return [current_name(name) if isinstance(name, str) else name for name in names]


def with_current_names(table: Mapping[str, Any]) -> dict[str, Any]:
    """Return a table of parameters under their current names.

    Args:
        table: Values by parameter name, with dotted keys or nested tables.

    Returns:
        The values by current name, with dotted keys.

    Raises:
        InputError: If a parameter is given under both names.
    """
    flat = flatten_keys(table)
    _refuse_both_names(flat.keys())
    return {current_name(name): value for name, value in flat.items()}


def with_current_keys(data: Mapping[str, Any], renamed: Mapping[str, str] = RENAMED_PARAMETERS) -> dict[str, Any]:
    """Return the sections of a file with renamed keys under their current names.

    A key whose new section is not in the file is not moved, so that the missing section is reported.

    Args:
        data: Sections of a TOML file, each a table; other values are kept.
        renamed: Old and current name of each key, ``SECTION.KEY``.

    Returns:
        The sections, as new tables.

    Raises:
        InputError: If a key is given under both names.
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
        InputError: If a key is given under both names.
    """
    current = with_current_keys(data, {**RENAMED_PARAMETERS, **RENAMED_RIG_KEYS})
    fit = current.get("fit")
    if isinstance(fit, dict):
        for key in ("free", "per_recording"):
            if isinstance(fit.get(key), list):
                _refuse_both_names([name for name in fit[key] if isinstance(name, str)])
                fit[key] = current_names(fit[key])
        if isinstance(fit.get("bounds"), dict):
            fit["bounds"] = with_current_names(fit["bounds"])
    return current


def current_line_numbers(text: str) -> dict[str, int]:
    """Return the row of each ``section.key`` of a rig or actuator file, under its current name."""
    return {RENAMED_RIG_KEYS.get(key, current_name(key)): row for key, row in line_numbers(text).items()}


def _refuse_both_names(names: Collection[str]) -> None:
    """Refuse parameters of which the old and the current name are given."""
    for name in names:
        if current_name(name) != name and current_name(name) in names:
            raise InputError(_both_given(name, current_name(name)))


def _both_given(old: str, new: str) -> str:
    return f"{old} is the old name of {new}, and both are given: remove {old}"
