"""Gains by name: what of a controller, or of the whole loop around it, can be tuned, in which unit, and between which bounds."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.control.rollout import Loop
from smajax.errors import InputError, nearest
from smajax.parameters import Declaration, declarations

FIXED = ("lower", "upper")  # limits of the actuator: they are the rig's


def gains(owner: AbstractController | Loop) -> dict[str, Declaration]:
    """The gains of a controller and of the PID within it, with their declarations; limits of the output are none.

    A loop of two wires has their co-contraction, too.
    """
    found: dict[str, Declaration] = {}
    for part in _parts(owner):
        found |= {name: d for name, d in declarations(part).items() if name not in FIXED}
    return found


def gain(owner: AbstractController | Loop, name: str) -> jax.Array:
    """The value of a gain in internal units. Raises ``InputError`` for a name that it has not."""
    return getattr(_part(owner, name), name)


def with_gains(owner: AbstractController | Loop, values: Mapping[str, Any]) -> Any:
    """The controller or loop with other gains (scalars in internal units); works under ``jax.jit``."""
    for name, value in values.items():
        owner = eqx.tree_at(lambda o, n=name: getattr(_part(o, n), n), owner, jnp.asarray(value, jnp.float64))
    return owner


def unit_of(name: str, owner: AbstractController | Loop, command: str, channel: str) -> str:
    """The unit of a gain, ``command`` and ``channel`` being the internal units of these, as in ``A/m/s``."""
    unit = gains(owner)[name].unit
    plain = {"u": "1", "u/y": "1/y", "u/y/s": "1/y/s", "u s/y": "s/y"}
    return (plain.get(unit, unit) if command == "1" else unit.replace("u", command)).replace("y", channel)


def _parts(owner: AbstractController | Loop) -> list[Any]:
    if isinstance(owner, Loop):
        return [*_parts(owner.controller), *([owner.allocation] if owner.allocation.wires > 1 else [])]
    return [owner] if owner.inner is owner else [owner, owner.inner]


def _part(owner: AbstractController | Loop, name: str) -> Any:
    for part in _parts(owner):
        if name in declarations(part):
            return part
    raise InputError(f"the controller has no gain '{name}'{nearest(name, gains(owner))}: it has {', '.join(gains(owner))}")
