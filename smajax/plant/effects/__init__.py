"""Physical effects that a plant may have in addition to its five stages; the diagnosis searches among them.

``catalogue`` lists all effects by key. It collects them from the modules of this folder: a new effect is a new file
with a subclass of the base class of its stage. ``base`` has the base classes with their hooks, ``memory`` dynamics that
several effects share, and ``skip_at_zero`` compile-time machinery.
"""

import importlib
import pkgutil
from collections.abc import Mapping
from functools import cache

from smajax.plant.effects.base import AbstractEffect


@cache
def catalogue() -> Mapping[str, type[AbstractEffect]]:
    """Return all effects by key, in the order of their keys."""
    effects: dict[str, type[AbstractEffect]] = {}
    for name in (module.name for module in pkgutil.iter_modules(__path__) if module.name != "base"):
        module = importlib.import_module(f"{__name__}.{name}")
        for effect in vars(module).values():
            if isinstance(effect, type) and issubclass(effect, AbstractEffect) and effect.__module__ == module.__name__:
                effects[effect.key] = effect
    return dict(sorted(effects.items()))
