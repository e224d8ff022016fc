"""Spacing of rows: models in discrete time need equally spaced ones."""

from typing import Any

import equinox as eqx
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
    """Return the inputs of a model, with an error where its rows are not equally spaced.

    Args:
        time: Times of the rows (rows,), s.
        values: Inputs (rows,). Traced ones carry the error to run time.
        name: Name of the model, for the message.

    Raises:
        InputError: The times are known and not equally spaced.
    """
    sentence = f"{name} is a model in discrete time and needs equally spaced rows: resample them (Recording.resample)"
    if isinstance(time, Tracer):
        return eqx.error_if(values, ~(_largest_deviation(time, jnp) <= _ROUNDING), sentence)
    if not is_evenly_spaced(time):
        gaps = np.diff(np.asarray(time))
        raise InputError(f"{sentence}; these are {gaps.min():.4g} to {gaps.max():.4g} s apart")
    return values


def _largest_deviation(time: Any, library: Any) -> Any:
    """Largest deviation of a step from the mean one, as a share of it; 0 for fewer than three rows."""
    if len(time) < 3:
        return library.zeros(())
    mean = (time[-1] - time[0]) / (len(time) - 1)
    return library.max(library.abs(library.diff(time) - mean)) / mean
