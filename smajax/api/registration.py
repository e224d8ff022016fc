"""Registration of own materials, mechanisms, effects and controllers under names of their own."""

from typing import Any, Literal

from smajax.errors import InputError, suggestion

KINDS = ("material", "mechanism", "effect", "controller")


def register(kind: Literal["material", "mechanism", "effect", "controller"], name: str, cls: type[Any]) -> None:
    """Register a class, so that rig files and controller files, fits, diagnoses and sweeps know it by a name.

    A material is selected by ``model = "NAME"`` under ``[fit]`` of a rig file, a mechanism by ``kind = "NAME"`` under
    ``[rig]``, an effect by a section ``[effects.NAME]``, and a controller by ``kind = "NAME"`` of a controller file. A
    diagnosis tries a registered effect like a shipped one. The classes derive from ``AbstractMaterial``,
    ``AbstractMechanism``, a base class of an effect such as ``HeatEffect``, or ``AbstractController``.

    An effect must have the declared parameter ``strength`` with the default 0, the class attributes ``key`` (its name)
    and ``typical`` (a usual strength), and a hook of its base class. ``help(smajax.effects.AbstractEffect)`` lists the
    other attributes, such as ``source``, ``needs`` and ``confused_with``, and has a complete example.

    An installed package can offer its classes without this call, as entry points of the groups ``smajax.materials``,
    ``smajax.mechanisms``, ``smajax.effects`` and ``smajax.controllers``.

    Args:
        kind: What the class is.
        name: The name, in small letters with hyphens: ``my-law``.
        cls: The class, not an instance of it.

    Raises:
        InputError: If the kind is unknown, the name is taken or has another form, or the class cannot be used; the
            message says all that it lacks.
    """
    # Imported here, since each of them takes as long as all of JAX.
    if kind == "material":
        from smajax.plant.materials.registry import MATERIALS as registry
    elif kind == "mechanism":
        from smajax.plant.mechanisms.registry import MECHANISMS as registry
    elif kind == "effect":
        from smajax.plant.effects.registry import EFFECTS as registry
    elif kind == "controller":
        from smajax.control.controllers import register_controller

        return register_controller(name, cls)
    else:
        raise InputError(f"'{kind}' cannot be registered{suggestion(str(kind), KINDS)}: give one of {', '.join(KINDS)}")
    return registry.register(name, cls)
