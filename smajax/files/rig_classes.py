"""The classes that a rig file selects: those that are loaded, or the shipped tables of them.

The checks of a rig file are the same for both. A command checks its files under ``without_classes`` before JAX is
loaded, so that a mistake is reported at once, in the sentence of the full check.
"""

import importlib.metadata
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from contextvars import ContextVar

from smajax.files.class_tables import RigClasses, shipped_tables

_uses_tables: ContextVar[bool] = ContextVar("uses_tables", default=False)
# Modules of the registries, by the last part of the group of entry points under which installed packages offer classes.
_REGISTRIES = {
    "mechanisms": "smajax.plant.mechanisms.registry",
    "materials": "smajax.plant.materials.registry",
    "effects": "smajax.plant.effects.registry",
    "controllers": "smajax.control.controllers.registry",
}


def rig_classes() -> RigClasses:
    """Return the classes; under ``without_classes`` the shipped tables."""
    if _uses_tables.get():
        return shipped_tables()
    from smajax.files.loaded_classes import LOADED_CLASSES

    return LOADED_CLASSES


def uses_tables() -> bool:
    """Return whether the shipped tables stand for the classes."""
    return _uses_tables.get()


@contextmanager
def without_classes() -> Iterator[None]:
    """Let the shipped tables stand for the classes, so that no class is loaded."""
    token = _uses_tables.set(True)
    try:
        yield
    finally:
        _uses_tables.reset(token)


def has_installed_classes() -> bool:
    """Return whether an installed package provides classes by entry points, which no shipped table lists."""
    return any(importlib.metadata.entry_points(group=f"smajax.{kind}") for kind in _REGISTRIES)


def has_registered_classes() -> bool:
    """Return whether classes were registered in this process, which no shipped table lists."""
    loaded = {kind: sys.modules[module] for kind, module in _REGISTRIES.items() if module in sys.modules}
    return any(getattr(module, kind.upper()).is_extended for kind, module in loaded.items())
