"""Physical effects that a plant may have in addition to its five stages; the diagnosis searches among them.

``catalogue`` lists all effects by key: those of the modules of this folder, where a new effect is a new file with a
subclass of the base class of its stage, and those that ``smajax.register`` or an installed package adds (``registry``).
``base`` has the base classes with their hooks, ``class_check`` what they demand of a class, ``memory`` dynamics that
several effects share, and ``skip_at_zero`` compile-time machinery. ``CAPABILITIES`` has the words of
``AbstractEffect.needs``. The classes are importable from here by name: ``smajax.plant.effects.Coating``.
"""

from collections.abc import Mapping
from typing import Any

from smajax.plant.capabilities import CAPABILITIES
from smajax.plant.effects.base import (
    AbstractEffect,
    DriveEffect,
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    SensorEffect,
    StageContext,
    ThermalNode,
    WireState,
)
from smajax.plant.effects.registry import EFFECTS

__all__ = [
    "CAPABILITIES",
    "AbstractEffect",
    "DriveEffect",
    "HeatEffect",
    "MaterialEffect",
    "MechanismEffect",
    "SensorEffect",
    "StageContext",
    "ThermalNode",
    "WireState",
    "catalogue",
]


def catalogue() -> Mapping[str, type[AbstractEffect]]:
    """Return all effects by key."""
    return EFFECTS


def __getattr__(name: str) -> Any:
    """Return the class of an effect by its name; the modules of the effects are imported when one is asked for."""
    if name[:1].isupper():  # a class; a submodule must not import all the others
        for effect in EFFECTS.loaded.values():
            if effect.__name__ == name:
                return effect
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")


def __dir__() -> list[str]:
    """Return the names of the base classes and of all effects."""
    return sorted([*__all__, *(effect.__name__ for effect in EFFECTS.loaded.values())])
