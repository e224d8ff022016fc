"""Tables of the classes that a rig file selects, without the classes: ``data/classes.json``, which smajax ships.

The classes of stages and effects need JAX, which takes longer to load than a file takes to check. The tables have what
the checks of a rig file need of each class. ``python -m docs.generate.class_tables`` writes them from the classes, and
a test compares the two.
"""

import functools
import json
import math
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, fields
from typing import Any

from smajax.parameters.definitions import ClassTable, Declaration, declarations
from smajax.recordings.datasets import data_path

_FILE = "classes.json"
# In place of NaN, which JSON does not have: the default of a parameter that the plant derives from others.
_DERIVED = "derived"
_MECHANISM_ATTRIBUTES = ("wires", "coordinate", "prescribed", "extra_channels")


@dataclass(frozen=True)
class RigClasses:
    """The classes that a rig file selects, or their tables.

    Attributes:
        mechanisms: Mechanisms by kind of rig.
        materials: Material laws by name.
        drives: Drives by their control.
        effects: Effects by key.
        actuators: Actuators by kind.
        parts: Other parts of a plant by the name of their class.
    """

    mechanisms: Mapping[str, Any]
    materials: Mapping[str, Any]
    drives: Mapping[str, Any]
    effects: Mapping[str, Any]
    actuators: Mapping[str, Any]
    parts: Mapping[str, Any]


class LazyMapping(Mapping[str, Any]):
    """Mapping whose content is loaded when it is first needed."""

    def __init__(self, load: Callable[[], Mapping[str, Any]]):
        """Keep the function that returns the content.

        Args:
            load: The function.
        """
        self._load = functools.cache(load)

    def __getitem__(self, key: str) -> Any:
        """Return the value of a key."""
        return self._load()[key]

    def __iter__(self) -> Iterator[str]:
        """Iterate over the keys."""
        return iter(self._load())

    def __len__(self) -> int:
        """Return the number of keys."""
        return len(self._load())


@functools.cache
def shipped_document() -> Mapping[str, Any]:
    """Return the content of the shipped file."""
    return json.loads(data_path(_FILE).read_text("utf-8"))


@functools.cache
def shipped_tables() -> RigClasses:
    """Return the tables of the shipped classes."""
    document = shipped_document()
    tables = {name: _class_table(name, entry) for name, entry in document["classes"].items()}
    for table in tables.values():
        own: Any = table.attributes
        if "sections" in own:
            own["rig_sections"] = functools.partial(dict, {key: tables[cls] for key, cls in own["sections"].items()})
        if "wire_class" in own:
            own["wire_class"] = tables[own["wire_class"]]
    groups = {f.name: {key: tables[name] for key, name in document[f.name].items()} for f in fields(RigClasses)}
    return RigClasses(**groups)


def classes_document(classes: RigClasses) -> dict[str, Any]:
    """Return what ``shipped_tables`` reads, of the classes.

    Args:
        classes: The shipped classes.
    """
    groups = {field.name: getattr(classes, field.name) for field in fields(RigClasses)}
    own = [cls for group in groups.values() for cls in group.values()]
    sections = [part for cls in own if hasattr(cls, "rig_sections") for part in cls.rig_sections().values()]
    entries = {_name(cls): _entry(cls) for cls in (*own, *sections)}
    return {**{name: _names(group) for name, group in groups.items()}, "classes": dict(sorted(entries.items()))}


def _name(cls: Any) -> str:
    return f"{cls.__module__}.{cls.__qualname__}"


def _names(group: Mapping[str, Any]) -> dict[str, str]:
    return {key: _name(cls) for key, cls in group.items()}


def _entry(cls: Any) -> dict[str, Any]:
    """Return the entry of a class in the document."""
    entry: dict[str, Any] = {"parameters": {name: _parameter(d) for name, d in declarations(cls).items()}}
    if hasattr(cls, "rig_sections"):
        entry["sections"] = _names(cls.rig_sections())
    if hasattr(cls, "wire_class"):  # a mechanism
        entry |= {name: getattr(cls, name) for name in _MECHANISM_ATTRIBUTES}
        entry["wire_class"] = _name(cls.wire_class)
    if hasattr(cls, "control"):  # a drive
        entry["control"] = cls.control
    if hasattr(cls, "surroundings"):  # an effect on the heat
        entry["surroundings"] = cls.surroundings
    return entry


def _parameter(declaration: Declaration) -> dict[str, Any]:
    entry: dict[str, Any] = {"unit": declaration.unit, "meaning": declaration.meaning}
    bounds = {"lower": declaration.lower, "upper": declaration.upper}
    entry |= {name: bound for name, bound in bounds.items() if math.isfinite(bound)}
    if declaration.default is not None:
        entry["default"] = _DERIVED if math.isnan(declaration.default) else declaration.default
    return entry | ({"whole": True} if declaration.whole else {})


def _class_table(name: str, entry: Mapping[str, Any]) -> ClassTable:
    """Return the table of a class from its entry; ``_parameter`` in reverse."""
    table = {}
    for key, values in entry["parameters"].items():
        default = math.nan if values.get("default") == _DERIVED else values.get("default")
        bounds = values.get("lower", -math.inf), values.get("upper", math.inf)
        table[key] = Declaration(values["unit"], values["meaning"], *bounds, default, values.get("whole", False))
    attributes = {key: value for key, value in entry.items() if key != "parameters"}
    return ClassTable(name, table, attributes)
