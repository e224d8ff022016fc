"""Quantities of a controller file as numbers and arrays."""

from typing import Any

import jax.numpy as jnp

from smajax.files.toml import quantity_at


def float_arrays(*values: float) -> tuple[Any, ...]:
    """Return numbers as scalar arrays of double precision."""
    return tuple(jnp.asarray(value, jnp.float64) for value in values)


def optional_quantity(value: Any, unit: str, place: str) -> float:
    """Return a quantity of 0 or more in a unit.

    Args:
        value: The quantity with its unit, as in the file; ``None`` for 0.
        unit: Unit of the result.
        place: Section and key, for the error message.

    Raises:
        InputError: if the value is not a quantity of 0 or more in such a unit.
    """
    return 0.0 if value is None else quantity_at(value, unit, place, least=0.0)
