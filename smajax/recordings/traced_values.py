"""Refusal of values that JAX traces: a recording holds numbers, and the derivatives are taken in the simulation."""

import sys

from smajax.errors import InputError


def is_tracing_error(error: Exception) -> bool:
    """Return whether JAX raised an error because a traced value was to become a number.

    JAX is not imported here: without it nothing is traced.

    Args:
        error: The error.
    """
    jax = sys.modules.get("jax")
    return jax is not None and isinstance(error, jax.errors.JAXTypeError)


def traced_values_error(place: str) -> InputError:
    """Return the error for a column of traced values.

    Args:
        place: Name of the recording and its column, for the message.
    """
    return InputError(
        f"{place}: the values are traced by JAX, and a recording is not: make the inputs by discretise() outside of "
        "the traced function, and in it take Inputs.scale() or replace their before, after and sample_signals"
    )
