"""The registry of the effects: those of the files of this folder, and those that users and packages add."""

import importlib
import pkgutil
from collections.abc import Iterable, Mapping

from smajax.parameters import declarations
from smajax.plant.effects.base import (
    AbstractEffect,
    DriveEffect,
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    SensorEffect,
)
from smajax.plant.registry import Registry

_PACKAGE = __name__.rpartition(".")[0]
_STAGE_CLASSES = (DriveEffect, HeatEffect, MaterialEffect, MechanismEffect, SensorEffect)
# A parameter of this name needs no default: it is set to the largest recorded current
# (``smajax.diagnosis.effect_parameters``).
_CURRENT_SCALE = "reference"


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
    """Return what is wrong with the class of an effect, with the cure; an empty text if nothing is.

    Args:
        name: The name under which it is registered.
        cls: The class.
    """
    if not issubclass(cls, _STAGE_CLASSES):
        return f"it has no stage: derive it from one of {', '.join(c.__name__ for c in _STAGE_CLASSES)}"
    if getattr(cls, "key", name) != name or not hasattr(cls, "key"):
        return f'its key is not its name: write key = "{name}" in the body of the class'
    declared = declarations(cls)
    if "strength" not in declared:
        return (
            "its strength has no declaration: write strength: jax.Array = parameter(UNIT, MEANING, LOWER, UPPER, 0.0)"
        )
    for key, declaration in declared.items():
        if declaration.default is None and key != _CURRENT_SCALE:
            return f"its parameter '{key}' has no default: give one as the fifth argument of parameter"
    if not declared["strength"].lower <= 0.0 <= declared["strength"].upper or declared["strength"].default != 0.0:
        return "a strength of 0 has to be possible and its default, since the effect is absent there"
    if not isinstance(getattr(cls, "typical", None), int | float) or cls.typical == 0.0:
        return "it has no usual strength: write typical = ... in the body of the class, a number that is not 0"
    unknown = [shape for shape, _ in cls.shapes if shape not in declared]
    return f"its shapes name '{unknown[0]}', which is no declared parameter: correct the name" if unknown else ""


EFFECTS = Registry("effect", AbstractEffect, shipped_effects, effect_problem)
