"""Responses of input-output models at all rows of a recording."""

import diffrax as dfx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.laws.bouc_wen import BoucWen
from smajax.laws.bouc_wen_curve import CURVE_GRID


def compute_response(
    model: AbstractInputOutputModel,
    time: Float[Array, " rows"],
    values: Float[Array, " rows"],
    *,
    evenly_spaced: bool = False,
) -> Float[Array, " rows"]:
    """Compute the outputs of an input-output model at all rows.

    The curve of a Bouc-Wen model is integrated here with the fifth-order rule of tsitouras2011: its slope depends on
    the coordinate only, so all steps are taken at once.

    Args:
        model: The model.
        time: Times of the rows, s.
        values: Inputs at the rows.
        evenly_spaced: Whether the rows are known to be equally spaced, as far as the model needs that.

    Raises:
        InputError: The model is in discrete time, and the rows are not equally spaced.

    Source: tsitouras2011.
    """
    if not isinstance(model, BoucWen):
        return model.even_response(time, values) if evenly_spaced else model.response(time, values)
    rule = dfx.Tsit5.tableau
    start, size = jnp.asarray(CURVE_GRID[:-1, None]), jnp.asarray(np.diff(CURVE_GRID))
    stages = start + jnp.asarray(np.append(0.0, rule.c))[None, :] * size[:, None]
    lengths = jnp.cumsum(size * (jax.vmap(jax.vmap(model.curve_slope))(stages) @ jnp.asarray(rule.b_sol)))
    return model.response_along_curve(jnp.append(0.0, lengths), values)
