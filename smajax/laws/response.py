"""Responses of input-output models at all rows of a recording."""

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.laws.base import AbstractInputOutputModel
from smajax.laws.bouc_wen import BoucWen
from smajax.laws.bouc_wen_curve import CURVE_GRID

# Gauss-Legendre points in a piece of the curve: path lengths within 1e-12 of those of 40 points, at n from 1.05 to 10.
_QUADRATURE_POINTS = 4


def compute_response(
    model: AbstractInputOutputModel,
    time: Float[Array, " rows"],
    values: Float[Array, " rows"],
    *,
    evenly_spaced: bool = False,
) -> Float[Array, " rows"]:
    """Compute the outputs of an input-output model at all rows.

    The path length along the curve of a Bouc-Wen model is integrated here by Gauss-Legendre quadrature over each piece
    of the curve: its slope depends on the coordinate only.

    Args:
        model: The model.
        time: Times of the rows, s.
        values: Inputs at the rows.
        evenly_spaced: Whether the rows are known to be equally spaced, as far as the model needs that.

    Raises:
        InputError: The model is in discrete time, and the rows are not equally spaced.
    """
    if not isinstance(model, BoucWen):
        return model.even_response(time, values) if evenly_spaced else model.response(time, values)
    points, weights = np.polynomial.legendre.leggauss(_QUADRATURE_POINTS)
    start, size = jnp.asarray(CURVE_GRID[:-1, None]), jnp.asarray(np.diff(CURVE_GRID))
    coordinates = start + jnp.asarray(0.5 * (1.0 + points))[None, :] * size[:, None]
    lengths = jnp.cumsum(0.5 * size * (jax.vmap(jax.vmap(model.curve_slope))(coordinates) @ jnp.asarray(weights)))
    return model.response_along_curve(jnp.append(0.0, lengths), values)
