"""Gains by name: the tunable parameters of a controller or of a closed loop, with units and bounds."""

import dataclasses
import re
from collections.abc import Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.errors import InputError, suggestion
from smajax.parameters import declarations
from smajax.parameters.checks import check_value
from smajax.parameters.definitions import Declaration

# Limits of the actuator, which are given by the rig and are not tuned.
_NOT_TUNED = ("lower", "upper")

_Owner = TypeVar("_Owner", bound=AbstractController | ClosedLoop)


def gains(owner: AbstractController | ClosedLoop) -> dict[str, Declaration]:
    """Return the declarations of the gains by name; the limits of the output are not among them.

    Args:
        owner: A controller or a closed loop; the co-contraction is a gain of a loop of two wires.

    Raises:
        InputError: if two parts of a controller declare a gain of the same name.
    """
    declared: dict[str, Declaration] = {}
    for part in _parts(owner):
        for name, declaration in declarations(part).items():
            if name in _NOT_TUNED:
                continue
            if name in declared:
                raise InputError(f"two parts of the {_name(owner)} declare the gain '{name}': rename one of them")
            declared[name] = declaration
    return declared


def gain(owner: AbstractController | ClosedLoop, name: str) -> Float[Array, ""]:
    """Return the value of a gain in internal units.

    Args:
        owner: The controller or closed loop.
        name: Name of the gain.

    Raises:
        InputError: if there is no gain of that name.
    """
    return getattr(_part(owner, name), name)


def with_gains(owner: _Owner, values: Mapping[str, Any]) -> _Owner:
    """Return the controller or closed loop with other gains; works under ``jax.jit``.

    Args:
        owner: The controller or closed loop.
        values: New gains by name, scalars in internal units; gains that are not named stay.

    Raises:
        InputError: if there is no gain of that name, or a value that is not traced is outside of its bounds.
    """
    for name, value in values.items():
        check_value(name, value, declarations(_part(owner, name))[name])
        owner = eqx.tree_at(lambda o, n=name: getattr(_part(o, n), n), owner, jnp.asarray(value, jnp.float64))
    return owner


def unit_of(name: str, owner: AbstractController | ClosedLoop, command: str, channel: str) -> str:
    """Return the unit of a gain, as in ``A/m/s``.

    Args:
        name: Name of the gain, one of ``gains(owner)``.
        owner: The controller or closed loop.
        command: Internal unit of the command.
        channel: Internal unit of the channel.
    """
    unit = re.sub(r"\bu\b", command, gains(owner)[name].unit)
    if command == "1":
        unit = re.sub(r"/1\b|^1 (?=\S)", "", unit)
    return re.sub(r"\by\b", channel, unit)


def _parts(owner: Any) -> list[Any]:
    """The modules that declare the gains: a controller and the modules in it, and the allocation to two wires."""
    if isinstance(owner, ClosedLoop):
        return [*_parts(owner.controller), *([owner.allocation] if owner.wires > 1 else [])]
    inner = (getattr(owner, field.name) for field in dataclasses.fields(owner))
    return [owner, *(part for module in inner if isinstance(module, eqx.Module) for part in _parts(module))]


def _name(owner: AbstractController | ClosedLoop) -> str:
    return type(owner.controller if isinstance(owner, ClosedLoop) else owner).__name__


def _part(owner: AbstractController | ClosedLoop, name: str) -> Any:
    """The module that declares a gain."""
    for part in _parts(owner):
        if name in declarations(part):
            return part
    raise InputError(
        f"the controller has no gain '{name}'{suggestion(name, gains(owner))}: it has {', '.join(gains(owner))}"
    )
