"""Declarations of parameters, and ties between them; nothing here needs JAX, so that files are checked without it."""

import dataclasses
import math
from collections.abc import Iterable, Mapping
from typing import Any

from smajax.channels import CHANNELS, channel_of

# The first of each pair has to be below the second: otherwise a transformation has no width, or the wire of a coil does
# not fit inside it.
ORDERED_PAIRS: tuple[tuple[str, str], ...] = (
    ("material.austenite_start", "material.austenite_finish"),
    ("material.martensite_finish", "material.martensite_start"),
    ("material.detwinning_start_stress", "material.detwinning_finish_stress"),
    ("wire.diameter", "wire.coil_diameter"),
)
TIES: Mapping[str, tuple[str, ...]] = {
    "heat.capacity": ("heat.capacity_austenite", "heat.capacity_martensite"),
    "material.thermal_expansion": ("material.thermal_expansion_austenite", "material.thermal_expansion_martensite"),
}


@dataclasses.dataclass(frozen=True)
class Declaration:
    """Properties of a parameter that do not depend on data.

    Attributes:
        unit: Internal unit, such as ``"Pa"``.
        meaning: Meaning in a few words, for messages and reports.
        lower: Lower bound of the values for which the equations hold.
        upper: Upper bound of the values for which the equations hold.
        default: Default value; ``None`` for a required parameter, NaN for one that the plant derives from others.
        whole: Whether the parameter is a count. The equations take any number; files give whole numbers and sweeps
            sample whole numbers, while a fitted value may be any number.
    """

    unit: str
    meaning: str
    lower: float
    upper: float
    default: float | None
    whole: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class ClassTable:
    """What files and messages need of a class with parameters, where the class itself is not loaded.

    Attributes:
        name: Name of the class.
        declarations: Declarations by field name, in the order of the fields.
        attributes: Other attributes of the class by name.
    """

    name: str
    declarations: Mapping[str, Declaration]
    attributes: Mapping[str, Any] = dataclasses.field(default_factory=dict)

    def __getattr__(self, name: str) -> Any:
        """Return an attribute of the class."""
        try:
            return self.attributes[name]
        except KeyError:
            raise AttributeError(f"the table of {self.name} has no attribute '{name}'") from None


def declarations(module: Any) -> dict[str, Declaration]:
    """Return the declared parameters of a module by field name, in the order of the fields.

    Args:
        module: A module, as an instance or a class, or the table of a class.
    """
    if isinstance(module, ClassTable):
        return dict(module.declarations)
    return {f.name: f.metadata["declaration"] for f in dataclasses.fields(module) if "declaration" in f.metadata}


def sensor_declarations(channels: Iterable[str]) -> dict[str, Declaration]:
    """Return the declarations of the gains and offsets of sensors by key, such as ``angle_gain``.

    Args:
        channels: Names of the observed channels.
    """
    table = {}
    for channel in channels:
        unit = CHANNELS[channel_of(channel) or channel].unit
        table[f"{channel}_gain"] = Declaration("1", f"gain of the {channel} sensor", 0.1, 10.0, 1.0)
        offset_unit = "K" if unit == "degC" else unit
        table[f"{channel}_offset"] = Declaration(
            offset_unit, f"offset of the {channel} sensor", -math.inf, math.inf, 0.0
        )
    return table


def tie_declarations(table: Mapping[str, Declaration]) -> dict[str, Declaration]:
    """Return the declarations of the ties all of whose members are declared, by name.

    Args:
        table: Declarations of the members by name.
    """
    ties = {tie: table[members[0]] for tie, members in TIES.items() if all(member in table for member in members)}
    return {tie: dataclasses.replace(d, meaning=d.meaning.replace(" of austenite", "")) for tie, d in ties.items()}


def expand(names: Iterable[str]) -> list[str]:
    """Return parameter names with ties replaced by their members, in the same order."""
    return [member for name in names for member in TIES.get(name, (name,))]


def by_leaf(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return values by leaf: a tie sets its members, and a value of the member itself has precedence.

    Args:
        values: Values by name of a parameter or a tie.
    """
    of_ties = {member: value for name, value in values.items() for member in TIES.get(name, ())}
    return of_ties | {name: value for name, value in values.items() if name not in TIES}
