"""Gains by name: what of a controller can be tuned, in which unit, and between which bounds."""

from collections.abc import Mapping
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp

from smajax.control.controller import AbstractController
from smajax.errors import InputError, nearest
from smajax.parameters import Declaration, declarations

FIXED = ("lower", "upper")  # limits of the actuator: they are the rig's


def gains(controller: AbstractController) -> dict[str, Declaration]:
    """The gains of a controller and of the PID within it, with their declarations; limits of the output are none."""
    found: dict[str, Declaration] = {}
    for part in _parts(controller):
        found |= {name: d for name, d in declarations(part).items() if name not in FIXED}
    return found


def gain(controller: AbstractController, name: str) -> jax.Array:
    """The value of a gain in internal units. Raises ``InputError`` for a name that it has not."""
    return getattr(_owner(controller, name), name)


def with_gains(controller: AbstractController, values: Mapping[str, Any]) -> Any:
    """The controller with other gains (scalars in internal units); works under ``jax.jit``."""
    for name, value in values.items():
        controller = eqx.tree_at(lambda c, n=name: getattr(_owner(c, n), n), controller, jnp.asarray(value, jnp.float64))
    return controller


def unit_of(name: str, controller: AbstractController, command: str, channel: str) -> str:
    """The unit of a gain, ``command`` and ``channel`` being the internal units of these, as in ``A/m/s``."""
    unit = gains(controller)[name].unit
    plain = {"u": "1", "u/y": "1/y", "u/y/s": "1/y/s", "u s/y": "s/y"}
    return (plain.get(unit, unit) if command == "1" else unit.replace("u", command)).replace("y", channel)


def _parts(controller: AbstractController) -> list[Any]:
    return [controller] if controller.inner is controller else [controller, controller.inner]


def _owner(controller: AbstractController, name: str) -> Any:
    for part in _parts(controller):
        if name in declarations(part):
            return part
    raise InputError(f"the controller has no gain '{name}'{nearest(name, gains(controller))}: it has {', '.join(gains(controller))}")
