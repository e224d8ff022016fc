"""What is wrong with the class of an effect: what would make it fail later, or do nothing without a word."""

from typing import Any

from smajax.parameters import declarations
from smajax.plant.effects.base import (
    AbstractEffect,
    DriveEffect,
    HeatEffect,
    MaterialEffect,
    MechanismEffect,
    SensorEffect,
)

_STAGE_CLASSES = (DriveEffect, HeatEffect, MaterialEffect, MechanismEffect, SensorEffect)
# A parameter of this name needs no default: it is set to the largest recorded current
# (``smajax.diagnosis.effect_parameters``).
_CURRENT_SCALE = "reference"


def effect_problems(name: str, cls: type[AbstractEffect]) -> list[str]:
    """Return all that is wrong with the class of an effect, each with its cure.

    Args:
        name: The name under which it is registered.
        cls: The class.

    Returns:
        The problems in words; empty if there is none.
    """
    if not any(issubclass(cls, stage) for stage in _STAGE_CLASSES):
        return [f"it has no stage: derive it from one of {', '.join(c.__name__ for c in _STAGE_CLASSES)}"]
    return [
        *_key_problems(name, cls),
        *_parameter_problems(cls),
        *_typical_problems(cls),
        *_shapes_problems(cls),
        *_flag_problems(cls),
    ]


def _key_problems(name: str, cls: type[AbstractEffect]) -> list[str]:
    if getattr(cls, "key", None) == name:
        return []
    reason = "its key is not its name" if hasattr(cls, "key") else "it has no key"
    return [f'{reason}: write key = "{name}" in the body of the class']


def _parameter_problems(cls: type[AbstractEffect]) -> list[str]:
    declared = declarations(cls)
    problems = [
        f"its parameter '{key}' has no default: give one as the fifth argument of smajax.parameter"
        for key, declaration in declared.items()
        if declaration.default is None and key != _CURRENT_SCALE
    ]
    strength = declared.get("strength")
    if strength is None and "strength" in getattr(cls, "__abstractvars__", ()):
        return problems  # smajax.plant.registry.class_problem reports what is not defined at all
    if strength is None:
        cure = "strength: jax.Array = smajax.parameter(UNIT, MEANING, LOWER, UPPER, 0.0)"
        return [f"its strength has no declaration: write {cure}", *problems]
    if not strength.lower <= 0.0 <= strength.upper or strength.default not in (0.0, None):
        problems.append("a strength of 0 has to be possible and its default, since the effect is absent there")
    return problems


def _typical_problems(cls: type[AbstractEffect]) -> list[str]:
    typical: Any = getattr(cls, "typical", None)
    if isinstance(typical, int | float) and typical != 0.0:
        return []
    return ["it has no usual strength: write typical = ... in the body of the class, a number that is not 0"]


def _shapes_problems(cls: type[AbstractEffect]) -> list[str]:
    declared, shapes = declarations(cls), cls.shapes
    try:
        names = [field for field, values in shapes if isinstance(field, str) and [float(value) for value in values]]
        complete = len(names) == len(shapes)
    except (TypeError, ValueError):
        names, complete = [], False
    if not complete:
        return ['its shapes have another form: write them like shapes = (("onset", (0.01, 0.02)),)']
    return [
        f"its shapes name '{field}', which is no declared parameter: correct the name"
        for field in names
        if field not in declared
    ]


def _stage(cls: type[AbstractEffect]) -> type[AbstractEffect]:
    """The base class of the effect's stage."""
    return next(stage for stage in _STAGE_CLASSES if issubclass(cls, stage))


def _overrides(cls: type[AbstractEffect], hook: str) -> bool:
    """Whether a class, or one between it and the base class of its stage, defines a hook."""
    return getattr(cls, hook, None) is not getattr(_stage(cls), hook, None)


def _flag_problems(cls: type[AbstractEffect]) -> list[str]:
    """Hooks that are not called without a class attribute, and class attributes that do nothing without their hook."""
    problems = []
    if issubclass(cls, MechanismEffect):
        if _overrides(cls, "drag") and not cls.has_drag:
            cure = "write has_drag = True in the body of the class"
            problems.append(f"it defines drag, which is called only with has_drag: {cure}")
        if cls.has_drag and not _overrides(cls, "drag"):
            problems.append("it has has_drag = True and no drag: define drag, or leave has_drag out")
        if cls.has_drag and "drag" not in cls.needs:
            cure = 'write needs = ("drag",) in the body of the class'
            problems.append(f"it has a drag, which not every rig can have: {cure}")
    if cls.other_channels and not (_overrides(cls, "displacement") or _overrides(cls, "reading")):
        cure = "leave other_channels out, or define displacement of a MechanismEffect or reading of a SensorEffect"
        problems.append(f"it has other_channels, which only displacement and reading use: {cure}")
    return problems
