"""What the functions of this room take, in words for their messages; numbers and arrays."""

from typing import Any

import jax
import jax.numpy as jnp

from smajax.arguments import check_type
from smajax.errors import InputError
from smajax.numerics.precision import require_double
from smajax.parameters import declarations, sections
from smajax.plant.plant import Plant

A_PLANT = "a Plant, such as rig.plant of a rig from read_rig"
A_RECORDING = (
    "a Recording, such as read_recording(...) or rig.read(..., observed=False) of a file or of a table in memory"
)
A_STATE = "the state that init returns, or the first result of step"


def as_array(function: str, argument: str, value: Any, takes: str) -> jax.Array:
    """Return numbers as an array of float64.

    Args:
        function: Name of the function, for the message.
        argument: Name of the argument.
        value: Its value: numbers, an array, or what JAX traces.
        takes: What the function takes, in words.

    Raises:
        InputError: If it is anything else, such as text or ``None``.
    """
    try:
        return jnp.asarray(value, jnp.float64)
    except (TypeError, ValueError):
        raise InputError(f"{function}: {argument} is of type {type(value).__name__}: give {takes}") from None


def check_plant(function: str, plant: Any) -> None:
    """Check that an argument is a single plant in double precision.

    Args:
        function: Name of the function, for the message.
        plant: The plant.

    Raises:
        InputError: If it is of another type or of single precision, or a parameter is an array of several values.
    """
    check_type(function, "plant", plant, Plant, A_PLANT)
    require_double(plant=plant)
    for section, part in sections(plant).items():
        for key in declarations(part):
            if shape := jnp.shape(getattr(part, key) if getattr(part, key) is not None else 0.0):
                raise InputError(
                    f"{function}: {section}.{key} has shape {shape}: give one number, and map over several values by "
                    "jax.vmap"
                )
