"""Values of the parameters of a rig: from the rig file, else from its parameter set, else the defaults."""

import math
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from smajax.errors import InputError, suggestion
from smajax.files.parameter_sets import Entry, find_set, read_parameters
from smajax.files.rig_classes import rig_classes
from smajax.files.rig_kinds import Stages
from smajax.files.toml import show, validate
from smajax.files.validators import section_model
from smajax.parameters import TIES, by_leaf, declarations
from smajax.parameters.definitions import Declaration


class ParameterSet(NamedTuple):
    """A parameter set that a rig names.

    Attributes:
        name: Name in the rig file; empty if the rig has no parameter set.
        entries: Entries by parameter name.
        per_recording: Names of the entries that belong to one recording; a rig does not use them.
    """

    name: str
    entries: Mapping[str, Entry]
    per_recording: tuple[str, ...] = ()


def read_parameter_set(data: Mapping[str, Any], folder: Path) -> ParameterSet:
    """Read the parameter set that ``rig.parameters`` names.

    Args:
        data: Sections of the rig file.
        folder: Folder to which the path of a set is relative.

    Returns:
        The set; without entries if the rig names none.

    Raises:
        InputError: If the set is unknown, or its file is missing or invalid.
    """
    name = data["rig"].get("parameters")
    if name is None:
        return ParameterSet("", {})
    if not isinstance(name, str) or not name:
        raise InputError(f'rig.parameters = {show(name)} is not a name: write it like parameters = "my-wire.toml"')
    path = find_set(name, folder, "rig.parameters = ")
    try:
        entries = read_parameters(path)
    except InputError as error:
        raise InputError(f"rig.parameters: {error}") from None
    per_recording = tuple(n for n in entries if "@" in n)
    return ParameterSet(name, {n: entry for n, entry in entries.items() if n not in per_recording}, per_recording)


def entries_for(
    parameter_set: ParameterSet, table: Mapping[str, Declaration], leaf_values: Mapping[str, Any]
) -> dict[str, Entry]:
    """Return the entries of a parameter set that a rig uses: those with a leaf that has no value in the rig file.

    Args:
        parameter_set: The set.
        table: Declarations of the parameters of the rig by name.
        leaf_values: Values in the rig file by leaf.

    Raises:
        InputError: If the unit of an entry differs from that of the parameter of the rig.
    """
    entries = {
        n: entry
        for n, entry in parameter_set.entries.items()
        if n in table and not leaf_values.keys() >= set(TIES.get(n, (n,)))
    }
    for n, entry in entries.items():
        if entry.unit != table[n].unit:
            problem = f"{n} is in {entry.unit}, and that of this rig in {table[n].unit}"
            raise InputError(f"parameter set {parameter_set.name}: {problem}: give it in the rig, in that unit")
    return entries


def file_values(data: Mapping[str, Any], stages: Stages) -> dict[str, float]:
    """Return the parameters in the rig file.

    Args:
        data: Sections of the rig file.
        stages: Classes of the stages of the rig.

    Returns:
        Values in internal units by name, ties included.

    Raises:
        InputError: If a key or a value is not valid.
    """
    values: dict[str, float] = {}
    for section in stages.parts:
        table = {n: d for n, d in stages.table().items() if n.startswith(f"{section}.")}
        values |= section_values(section, data.get(section, {}), table)
    return values


def section_values(section: str, content: Any, table: Mapping[str, Declaration]) -> dict[str, float]:
    """Return the parameters in one section of the rig file.

    Args:
        section: Name of the section.
        content: Its content.
        table: Declarations of its parameters by name.

    Returns:
        Values in internal units by name.

    Raises:
        InputError: If a key or a value is not valid.
    """
    keys = {name.rsplit(".", 1)[1]: declaration for name, declaration in table.items()}
    values = validate(section_model(section, keys), content, section)
    return {f"{section}.{key}": value for key, value in values.model_dump(exclude_unset=True).items()}


def effect_values(content: Any) -> dict[str, dict[str, float]]:
    """Return the parameters in the sections ``[effects.KEY]``.

    Args:
        content: Content of ``[effects]``.

    Returns:
        Values in internal units by key of the effect and name of the parameter.

    Raises:
        InputError: If an effect is not in the catalogue, or a value is not valid.
    """
    if not isinstance(content, dict):
        cure = 'write an effect as [effects.latent-heat] with strength = "60 MJ/m^3" below it (smajax explain effects)'
        raise InputError(f"effects is not a section: {cure}")
    catalogue, read = rig_classes().effects, {}
    for key, keys in content.items():
        effect = catalogue.get(key)
        if effect is None:
            cure = "an effect of your own needs its module to be imported before, or an installed entry point"
            hint = suggestion(key, catalogue) or f": {cure}"
            raise InputError(f"effects.{key} is not in the catalogue{hint} (smajax explain effects)")
        section = f"effects.{key}"
        values = section_values(section, keys, {f"{section}.{n}": d for n, d in declarations(effect).items()})
        read[key] = {n.rsplit(".", 1)[1]: value for n, value in values.items()}
    return read


def entry_values(entries: Mapping[str, Entry]) -> dict[str, float]:
    """Return the values of entries by name."""
    return {n: entry.value for n, entry in entries.items()}


def value_sources(
    leaves: Sequence[str],
    set_entries: Mapping[str, Any],
    values: Mapping[str, Any],
    set_name: str,
    place: Mapping[str, str],
) -> dict[str, str]:
    """Return where the value of each parameter comes from.

    Args:
        leaves: Names of the parameters.
        set_entries: Entries of the parameter set that the rig uses, by name.
        values: Values in the rig file by name.
        set_name: Name of the parameter set.
        place: Place of each value in the rig file.

    Returns:
        Texts by name: a place in the rig file, "parameter set NAME", or "default".
    """
    from_set = dict.fromkeys(by_leaf(set_entries), f"parameter set {set_name}")
    return dict.fromkeys(leaves, "default") | from_set | by_leaf({n: place[n] for n in values})


def set_bounds(entries: Mapping[str, Entry], leaf_values: Mapping[str, Any]) -> dict[str, tuple[float, float]]:
    """Return the bounds in a parameter set of the values that the rig file does not replace.

    Args:
        entries: Entries of the parameter set that the rig uses, by name.
        leaf_values: Values in the rig file by leaf.

    Returns:
        Bounds ``(low, high)`` in internal units by name.
    """
    bounded = {n: entry for n, entry in entries.items() if entry.upper - entry.lower < math.inf}
    return {
        n: (entry.lower, entry.upper) for n, entry in bounded.items() if not leaf_values.keys() & set(TIES.get(n, (n,)))
    }


def has_exponent(data: Mapping[str, Any], parameter_set: ParameterSet) -> bool:
    """Return whether h(T) has an exponent, by the coefficients in the rig file, else those in the parameter set.

    Args:
        data: Sections of the rig file.
        parameter_set: The parameter set.
    """
    heat = data.get("heat")
    keys = heat.keys() if isinstance(heat, dict) else set()
    return "exponent" in keys or ("heat.exponent" in parameter_set.entries and not {"h1", "h2"} & keys)
