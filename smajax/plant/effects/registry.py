"""The registry of the effects: those of the files of this folder, and those that users and packages add."""

import importlib
import pkgutil
from collections.abc import Iterable, Mapping

from smajax.plant.effects.base import AbstractEffect
from smajax.plant.effects.class_check import effect_problems
from smajax.plant.registry import Registry

_PACKAGE = __name__.rpartition(".")[0]


def effects_by_key(classes: Iterable[type[AbstractEffect]]) -> dict[str, type[AbstractEffect]]:
    """Return effects by key, in the order of their keys.

    Args:
        classes: Classes of effects.

    Raises:
        ValueError: If two of them have one key.
    """
    effects: dict[str, type[AbstractEffect]] = {}
    for cls in classes:
        if cls.key in effects:
            first, second = (f"{effect.__module__}.{effect.__qualname__}" for effect in (effects[cls.key], cls))
            raise ValueError(f"two effects have the key '{cls.key}', {first} and {second}: rename one of them")
        effects[cls.key] = cls
    return dict(sorted(effects.items()))


def shipped_effects() -> Mapping[str, type[AbstractEffect]]:
    """Return the effects of the modules of this folder by key."""
    path = importlib.import_module(_PACKAGE).__path__
    names = [module.name for module in pkgutil.iter_modules(path) if module.name != "base"]
    modules = [importlib.import_module(f"{_PACKAGE}.{name}") for name in names]
    return effects_by_key(
        effect
        for module in modules
        for effect in vars(module).values()
        if isinstance(effect, type) and issubclass(effect, AbstractEffect) and effect.__module__ == module.__name__
    )


def effect_problem(name: str, cls: type[AbstractEffect]) -> str:
    """Return all that is wrong with the class of an effect, with the cures; an empty text if nothing is.

    Args:
        name: The name under which it is registered.
        cls: The class.
    """
    return "; ".join(effect_problems(name, cls, EFFECTS.names))


EFFECTS = Registry("effect", AbstractEffect, shipped_effects, effect_problem)
