"""What is wrong with the class of an effect: what would make it fail later, or do nothing without a word."""

import dataclasses
import difflib
import inspect
from collections.abc import Collection
from typing import Any

from smajax.errors import suggestion
from smajax.parameters import declarations
from smajax.plant.capabilities import CAPABILITIES, CHANNEL_NAMES, RIG_CAPABILITIES
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
# Hooks that do nothing alone: they serve the other ones.
_MEMORY_HOOKS = ("initial_memory", "update_memory", "begin_step")
# Similarity (difflib's ratio, 0 to 1) from which a name counts as a misspelt hook: "shfit" has 0.8, and a helper such
# as heat_power has 0.67; tests/unit/plant/test_effect_classes.py holds it.
_MISSPELT_SIMILARITY = 0.8


def effect_problems(name: str, cls: type[AbstractEffect], effects: Collection[str]) -> list[str]:
    """Return all that is wrong with the class of an effect, each with its cure.

    Args:
        name: The name under which it is registered.
        cls: The class.
        effects: Names of the effects that are known.

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
        *_hook_problems(cls),
        *_word_problems(cls, effects),
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
        if cls.has_drag and "drag" not in (cls.needs or ()):
            cure = 'write needs = ("drag",) in the body of the class'
            problems.append(f"it has a drag, which not every rig can have: {cure}")
    if cls.other_channels and not (_overrides(cls, "displacement") or _overrides(cls, "reading")):
        cure = "leave other_channels out, or define displacement of a MechanismEffect or reading of a SensorEffect"
        problems.append(f"it has other_channels, which only displacement and reading use: {cure}")
    return problems


def _public_hooks(stage: type[AbstractEffect]) -> list[str]:
    """Names of the methods of a base class that an effect may override."""
    return [name for name, _ in inspect.getmembers(stage, inspect.isfunction) if not name.startswith("_")]


def _hook_problems(cls: type[AbstractEffect]) -> list[str]:
    """Misspelt hooks, hooks of another stage, hooks with other parameters, and a class that overrides none."""
    stage = _stage(cls)
    overridden = [hook for hook in _public_hooks(stage) if _overrides(cls, hook)]
    problems = [*_name_problems(cls), *(_parameter_list_problem(cls, hook) for hook in overridden)]
    problems = [problem for problem in problems if problem]
    acting = [hook for hook in _public_hooks(stage) if hook not in _MEMORY_HOOKS]
    if not problems and not set(acting) & set(overridden) and not cls.no_mean_effect:
        own = ", ".join(sorted(_own_names(cls)))
        hint = next((text for name in own.split(", ") if (text := suggestion(name, acting))), "")
        problems.append(f"it does nothing, since it defines no hook of {stage.__name__}{hint}: {_choice(acting)}")
    return problems


def _choice(hooks: list[str]) -> str:
    return f"define {hooks[0]}" if len(hooks) == 1 else f"define one of {', '.join(hooks)}"


def _own_names(cls: type[AbstractEffect]) -> set[str]:
    """Public names in the body of a class, and of its base classes below that of its stage, without its fields."""
    below = [base for base in cls.__mro__ if base not in _stage(cls).__mro__]
    fields = {field.name for field in dataclasses.fields(cls)}
    return {name for base in below for name in vars(base) if not name.startswith("_")} - fields


def _name_problems(cls: type[AbstractEffect]) -> list[str]:
    """Names that are not used: hooks of other stages, and those that are similar to a hook or a class attribute."""
    stage, problems = _stage(cls), []
    attributes = {name for base in stage.__mro__ for name in inspect.get_annotations(base)} | set(dir(stage))
    known = [name for name in attributes if not name.startswith("_")]
    for name in sorted(_own_names(cls) - attributes):
        others = [other.__name__ for other in _STAGE_CLASSES if name in _public_hooks(other)]
        if others:
            problems.append(
                f"it defines {name}, a hook of {others[0]} and not of {stage.__name__}: derive it from that"
            )
        elif similar := difflib.get_close_matches(name.lower(), known, n=1, cutoff=_MISSPELT_SIMILARITY):
            hint = f"did you mean '{similar[0]}'?"
            cure = "correct the name, or begin it with an underscore"
            problems.append(f"it defines {name}, which is not used ({hint}): {cure}")
    return problems


def _parameter_list_problem(cls: type[AbstractEffect], hook: str) -> str:
    """What is wrong with the parameters of a hook, which is called without keywords; empty if nothing is."""
    own, expected = getattr(cls, hook), list(inspect.signature(getattr(_stage(cls), hook)).parameters)
    cure = f"write def {hook}({', '.join(expected)})"
    if not callable(own):
        return f"its {hook} is not a method: {cure}"
    signature = inspect.signature(own)
    try:
        signature.bind(*expected)
    except TypeError:
        return f"its {hook}({', '.join(signature.parameters)}) has other parameters than the hook: {cure}"
    if any(name in expected and expected.index(name) != i for i, name in enumerate(signature.parameters)):
        return f"its {hook}({', '.join(signature.parameters)}) has the parameters in another order: {cure}"
    return ""


def _word_problems(cls: type[AbstractEffect], effects: Collection[str]) -> list[str]:
    """Words of class attributes that do not exist: capabilities, effects and channels."""
    channels = "a channel such as temperature, or current_2 of two wires"
    rules: tuple[tuple[str, str, Collection[str], str], ...] = (
        ("needs", "a capability of rigs", CAPABILITIES, f"{', '.join(RIG_CAPABILITIES)}, CHANNEL or CHANNEL observed"),
        ("excluded_by", "a capability of rigs", CAPABILITIES, ", ".join(RIG_CAPABILITIES)),
        ("confused_with", "an effect", effects, "an effect of sma.effects.catalogue(), and register that one first"),
        ("other_channels", "a channel", CHANNEL_NAMES, channels),
    )
    problems = []
    for attribute, kind, words, cure in rules:
        values: Any = getattr(cls, attribute)
        if not isinstance(values, tuple | list):
            example = values if isinstance(values, str) else "WORD"
            problems.append(f'its {attribute} is not a tuple: write {attribute} = ("{example}",)')
            continue
        for word in values:
            if word not in words:
                hint = suggestion(str(word), words)
                problems.append(f"its {attribute} has '{word}', which is not {kind}{hint}: name {cure}")
    if issubclass(cls, SensorEffect) and cls.channel and cls.channel not in CHANNEL_NAMES:
        hint = suggestion(cls.channel, CHANNEL_NAMES)
        problems.append(f"its channel '{cls.channel}' is not a channel{hint}: name {channels}")
    return problems
