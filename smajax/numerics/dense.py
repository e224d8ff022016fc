"""Small dense linear systems."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Number of equations up to which elimination by scalars compiles fast: that of a plant without cells.
_UNROLLED = 5


def solve_dense(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve a small system of equations by elimination without pivoting.

    The systems of this package have positive diagonals, for which that is stable enough. The elimination is unrolled:
    it is compiled into the loop over time steps, which a call of LAPACK is not. Up to ``_UNROLLED`` equations every
    entry is a scalar; beyond, whole rows are eliminated at once (Gauss-Jordan), which compiles faster.

    Args:
        matrix: The matrix.
        right: The right-hand side.

    Returns:
        The solution.
    """
    size = right.shape[0]
    if size > _UNROLLED:
        return _eliminate(jnp.concatenate([matrix, right[:, None]], axis=1))[:, -1]
    rows = [[matrix[i, j] for j in range(size)] + [right[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    solution = [right[0]] * size
    for i in reversed(range(size)):
        solution[i] = (rows[i][size] - sum(rows[i][j] * solution[j] for j in range(i + 1, size))) / rows[i][i]
    return jnp.stack(solution)


def _eliminate(table: jax.Array) -> jax.Array:
    """Gauss-Jordan elimination without pivoting of the columns of unknowns in front of those of right-hand sides."""
    size = table.shape[0]
    rows = jnp.arange(size)

    def eliminate(k: jax.Array, table: jax.Array) -> jax.Array:
        pivot = table[k] / table[k, k]
        factor = jnp.where(rows == k, 0.0, table[:, k])
        return jnp.where((rows == k)[:, None], pivot[None], table - factor[:, None] * pivot[None])

    return jax.lax.fori_loop(0, size, eliminate, table)


def inverse(matrix: Float[Array, "n n"]) -> Float[Array, "n n"]:
    """Compute the inverse of a matrix as ``solve_dense`` would, for several right-hand sides.

    Args:
        matrix: The matrix.
    """
    size = matrix.shape[0]
    return _eliminate(jnp.concatenate([matrix, jnp.eye(size)], axis=1))[:, size:]


def combine(columns: Float[Array, "*shape n"], weights: Float[Array, " n"]) -> Float[Array, "*shape"]:
    """Compute the sum of columns with weights, for as few columns as ``solve_dense`` has unknowns.

    Args:
        columns: The columns, along the last axis.
        weights: Their weights.
    """
    if weights.shape[0] > _UNROLLED:
        # Not a product of matrices: a batch of them would be left to a library, which no kernel may call.
        return jnp.sum(columns * weights.reshape((1,) * (columns.ndim - 1) + weights.shape), axis=-1)
    total: Any = sum(columns[..., i] * weights[i] for i in range(weights.shape[0]))
    return total
