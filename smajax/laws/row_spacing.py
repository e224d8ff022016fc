"""Spacing of rows: models in discrete time need equally spaced ones."""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jax.core import Tracer

from smajax.errors import InputError

# A clock that jitters: a model in discrete time takes row k at k times the step. A row that is off by this share of the
# step has the output of an instant that is off by it, an error of at most 1 % of the output's change from row to row.
JITTER = 0.01
# Rounding of the times, as a share of the step: within it, a model in continuous time, exact on any rows, may take
# them for equally spaced.
ROUNDING = 1e-6


def is_evenly_spaced(time: Any, step: float | None = None, tolerance: float = JITTER) -> bool:
    """Return whether rows are equally spaced; false for traced times, whose values are unknown.

    Args:
        time: Times of the rows (rows,), s.
        step: Time between two rows, s; their mean if not given.
        tolerance: Largest deviation of a time between two rows from ``step``, as a share of it.
    """
    return not isinstance(time, Tracer) and float(_largest_deviation(np.asarray(time), np, step)) <= tolerance


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
        return jnp.where(_largest_deviation(time, jnp) <= JITTER, values, jnp.nan)
    if is_evenly_spaced(time):
        return values
    gaps = np.diff(np.asarray(time))
    raise InputError(
        f"{name} is a model in discrete time and needs equally spaced rows: resample them (Recording.resample); these "
        f"are {gaps.min():.4g} to {gaps.max():.4g} s apart"
    )


def _largest_deviation(time: Any, library: Any, step: float | None = None) -> Any:
    """Largest deviation from ``step``, or from the mean, as a share of it; 0 for fewer than two rows."""
    if len(time) < 2:
        return library.zeros(())
    expected = (time[-1] - time[0]) / (len(time) - 1) if step is None else step
    return library.max(library.abs(library.diff(time) - expected)) / expected
