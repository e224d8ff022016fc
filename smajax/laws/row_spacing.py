"""Spacing of rows: models in discrete time need equally spaced ones."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from smajax.errors import InputError

# Rows are equally spaced up to this share of the step: rounding of the times.
_ROUNDING = 1e-6


def is_evenly_spaced(time: Any) -> bool:
    """Return whether rows are equally spaced, up to rounding; false for traced times, whose values are unknown.

    Args:
        time: Times of the rows (rows,), s.
    """
    return not isinstance(time, Tracer) and float(_largest_deviation(np.asarray(time), np)) <= _ROUNDING


def refuse_uneven_rows(time: Any, values: jax.Array, name: str) -> jax.Array:
    """Return the inputs of a model whose rows are equally spaced.

    Args:
        time: Times of the rows (rows,), s.
        values: Inputs (rows,).
        name: Name of the model, for the message.

    Returns:
        The inputs; NaN where traced times turn out to be unequally spaced, so that no wrong output is returned.

    Raises:
        InputError: The times are known and not equally spaced.
    """
    if isinstance(time, Tracer):
        return jnp.where(_largest_deviation(time, jnp) <= _ROUNDING, values, jnp.nan)
    if is_evenly_spaced(time):
        return values
    gaps = np.diff(np.asarray(time))
    raise InputError(
        f"{name} is a model in discrete time and needs equally spaced rows: resample them (Recording.resample); these "
        f"are {gaps.min():.4g} to {gaps.max():.4g} s apart"
    )


def _largest_deviation(time: Any, library: Any) -> Any:
    """Largest deviation of a step from the mean one, as a share of it; 0 for fewer than three rows."""
    if len(time) < 3:
        return library.zeros(())
    mean = (time[-1] - time[0]) / (len(time) - 1)
    return library.max(library.abs(library.diff(time) - mean)) / mean
