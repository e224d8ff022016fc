"""Units in which a rig file gives its parameters, for texts about them."""

from collections.abc import Mapping
from typing import Any

from smajax.errors import InputError
from smajax.files.renamed_keys import with_current_rig_keys
from smajax.files.rig_file import Rig
from smajax.files.toml import flatten_keys, parse_toml
from smajax.units import conversion, unit_of


def file_units(rig: Rig, units: Mapping[str, str]) -> dict[str, str]:
    """Return the unit of each parameter in a rig file, which texts about the rig use as well.

    Args:
        rig: The rig; one that was made from no file has none.
        units: Internal unit by name of the parameter.

    Returns:
        Units by name; names whose values the file does not give, or gives without a unit, are left out.
    """
    if rig.text is None:
        return {}
    data = with_current_rig_keys(parse_toml(rig.text, rig.name))
    given = flatten_keys({key: value for key, value in data.items() if isinstance(value, dict)})
    bounds = data.get("fit", {}).get("bounds", {})
    for name, ends in flatten_keys(bounds).items() if isinstance(bounds, dict) else ():
        given.setdefault(name, next(iter(ends), None) if isinstance(ends, list) else None)
    shown = {name: _unit(given[name], unit) for name, unit in units.items() if name in given}
    return {name: unit for name, unit in shown.items() if unit}


def _unit(value: Any, internal: str) -> str:
    """The unit of a quantity; empty for a number, and for a quantity of another kind, such as a degC for a K."""
    if not isinstance(value, str):
        return ""
    try:
        unit = unit_of(value)
        conversion(unit, internal)
    except InputError:
        return ""
    return "" if unit == "1" else unit
