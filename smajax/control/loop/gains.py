"""Gains by name: the tunable parameters of a controller or of a closed loop, with units and bounds."""

from collections.abc import Mapping
from typing import Any, TypeVar

import equinox as eqx
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.control.controllers.base import AbstractController
from smajax.control.loop.closed_loop import ClosedLoop
from smajax.errors import InputError, suggestion
from smajax.parameters import Declaration, declarations

# Limits of the actuator, which are given by the rig and are not tuned.
_NOT_TUNED = ("lower", "upper")

_Owner = TypeVar("_Owner", bound=AbstractController | ClosedLoop)


def gains(owner: AbstractController | ClosedLoop) -> dict[str, Declaration]:
    """Return the declarations of the gains by name; the limits of the output are not among them.

    Args:
        owner: A controller or a closed loop; the co-contraction is a gain of a loop of two wires.
    """
    declared: dict[str, Declaration] = {}
    for part in _parts(owner):
        declared |= {name: d for name, d in declarations(part).items() if name not in _NOT_TUNED}
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
        InputError: if there is no gain of that name.
    """
    for name, value in values.items():
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
    unit = gains(owner)[name].unit
    dimensionless = {"u": "1", "u/y": "1/y", "u/y/s": "1/y/s", "u s/y": "s/y"}
    return (dimensionless.get(unit, unit) if command == "1" else unit.replace("u", command)).replace("y", channel)


def _parts(owner: AbstractController | ClosedLoop) -> list[Any]:
    """The modules that declare the gains."""
    if isinstance(owner, ClosedLoop):
        return [*_parts(owner.controller), *([owner.allocation] if owner.allocation.wires > 1 else [])]
    return [owner] if owner.inner is owner else [owner, owner.inner]


def _part(owner: AbstractController | ClosedLoop, name: str) -> Any:
    """The module that declares a gain."""
    for part in _parts(owner):
        if name in declarations(part):
            return part
    raise InputError(
        f"the controller has no gain '{name}'{suggestion(name, gains(owner))}: it has {', '.join(gains(owner))}"
    )
