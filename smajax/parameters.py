"""One declaration per parameter, and the names under which a plant's leaves are read and set.

A parameter is declared once, as a field of the stage that uses it: unit, meaning, bounds and default stand in the field's metadata,
and the rig file, the fit, the parameter files and the report all read them from there. Its name is ``section.key``, where the section
is the plant's field of that name (``heat.h0``) or a section of its mechanism (``pulley.radius``). Some names are *ties*: one number
that is written to several leaves, such as ``heat.capacity`` for a capacity that does not depend on the phase.
"""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax import jax_options  # noqa: F401
from smajax.errors import InputError, nearest

TIES: Mapping[str, tuple[str, ...]] = {
    "heat.capacity": ("heat.capacity_austenite", "heat.capacity_martensite"),
    "material.thermal_expansion": ("material.thermal_expansion_austenite", "material.thermal_expansion_martensite"),
}
# Within each pair the first has to stay below the second, or a transformation has no band to run through, or a coil no room inside.
ORDERED: tuple[tuple[str, str], ...] = (
    ("material.austenite_start", "material.austenite_finish"),
    ("material.martensite_finish", "material.martensite_start"),
    ("material.detwinning_start_stress", "material.detwinning_finish_stress"),
    ("wire.diameter", "wire.coil_diameter"),
)


@dataclasses.dataclass(frozen=True)
class Declaration:
    """What is known of a parameter before any data: internal unit, meaning, and the bounds within which the equations hold.

    ``default`` is ``None`` where the rig file has to say the value, NaN where the plant derives it from others. A ``whole`` parameter
    counts something: the equations take any number, files give whole ones and a sweep draws such; one that is fitted may be any.
    """

    unit: str
    meaning: str
    lower: float
    upper: float
    default: float | None
    whole: bool = False


def as_float(value: Any) -> Any:
    """A float64 array; ``None`` stays, and so do the placeholder leaves that JAX puts into pytrees."""
    if value is None or isinstance(value, jax.Array) or not isinstance(value, int | float):
        return value
    return jnp.asarray(value, dtype=jnp.float64)


def parameter(
    unit: str, meaning: str, lower: float = -math.inf, upper: float = math.inf, default: float | None = None, *, whole: bool = False
) -> Any:
    """Declares a parameter as a field of a module; see ``Declaration``."""
    declaration = Declaration(unit, meaning, lower, upper, default, whole)
    metadata = {"declaration": declaration}
    if default is None:
        return eqx.field(converter=as_float, metadata=metadata)
    if math.isnan(default):
        return eqx.field(default=None, metadata=metadata)
    return eqx.field(converter=as_float, default=default, metadata=metadata)


def declarations(module: Any) -> dict[str, Declaration]:
    """The declared parameters of a module (instance or class) by field name, in their order."""
    return {f.name: f.metadata["declaration"] for f in dataclasses.fields(module) if "declaration" in f.metadata}


def sections(plant: Any) -> dict[str, Any]:
    """The sections of a plant by name: its own parts, and those of its mechanism; of a machine (``smajax.machines``), its parts."""
    parts = {}
    for owner in (plant, plant.mechanism) if hasattr(plant, "mechanism") else (plant,):
        for field in dataclasses.fields(owner):
            part = getattr(owner, field.name)
            if isinstance(part, eqx.Module) and declarations(part):
                parts.setdefault(field.name, part)
    return parts | {f"effects.{e.key}": e for e in getattr(plant, "effects", ())}


def declared(plant: Any) -> dict[str, Declaration]:
    """All parameter names of a plant with their declarations, ties included."""
    table = {f"{section}.{key}": d for section, part in sections(plant).items() for key, d in declarations(part).items()}
    if hasattr(plant, "sensor"):
        table.update({f"sensor.{name}": d for name, d in plant.sensor.declarations().items()})
    for tie, members in TIES.items():
        if all(m in table for m in members):
            table[tie] = dataclasses.replace(table[members[0]], meaning=table[members[0]].meaning.replace(" of austenite", ""))
    return table


def declaration(plant: Any, name: str) -> Declaration:
    """The declaration of one parameter; an unknown name is refused with the nearest one."""
    table = declared(plant)
    if name not in table:
        raise InputError(f"there is no parameter '{name}' in this plant{nearest(name, table)}")
    return table[name]


def _leaf(plant: Any, name: str) -> Any:
    section, key = name.rsplit(".", 1)
    if section.startswith("effects."):
        return getattr(next(e for e in plant.effects if e.key == section[8:]), key)
    if section == "sensor":
        return plant.sensor.leaf(key)
    if any(f.name == section for f in dataclasses.fields(plant)):
        return getattr(getattr(plant, section), key)
    return getattr(getattr(plant.mechanism, section), key)


def get(plant: Any, name: str) -> jax.Array:
    """The value of a parameter in its internal unit, a scalar. Of a tie, the first member's; of a start value left to the plant, NaN."""
    declaration(plant, name)
    value = _leaf(plant, TIES.get(name, (name,))[0])
    return jnp.asarray(jnp.nan) if value is None else value


def replace(plant: Any, values: Mapping[str, Any]) -> Any:
    """The plant with the named parameters set (scalars in internal units, arrays under ``jax.vmap``); works under ``jax.jit``.

    Names are applied in order, so a tie first and one of its members after it gives the member its own value.
    """
    for name, value in values.items():
        for member in TIES.get(name, (name,)):
            plant = eqx.tree_at(lambda p, m=member: _leaf(p, m), plant, jnp.asarray(value, jnp.float64), is_leaf=lambda x: x is None)
    return plant


def expand(names: Iterable[str]) -> list[str]:
    """The leaves' names behind a list of parameter names: ties replaced by their members."""
    return [member for name in names for member in TIES.get(name, (name,))]
