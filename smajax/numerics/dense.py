"""Small dense linear systems."""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Number of equations up to which elimination by scalars compiles fast; chosen by trial.
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
        return _solve_by_rows(matrix, right)
    rows = [[matrix[i, j] for j in range(size)] + [right[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    solution = [right[0]] * size
    for i in reversed(range(size)):
        solution[i] = (rows[i][size] - sum(rows[i][j] * solution[j] for j in range(i + 1, size))) / rows[i][i]
    return jnp.stack(solution)


def _solve_by_rows(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Solve a system by Gauss-Jordan elimination without pivoting, one vector operation for each unknown."""
    table = jnp.concatenate([matrix, right[:, None]], axis=1)
    rows = jnp.arange(right.shape[0])
    for k in range(right.shape[0]):
        pivot = table[k] / table[k, k]
        factor = jnp.where(rows == k, 0.0, table[:, k])
        table = jnp.where((rows == k)[:, None], pivot, table - factor[:, None] * pivot)
    return table[:, -1]


def combine(columns: Float[Array, "*shape n"], weights: Float[Array, " n"]) -> Float[Array, "*shape"]:
    """Compute the sum of columns with weights, for as few columns as ``solve_dense`` has unknowns.

    Args:
        columns: The columns, along the last axis.
        weights: Their weights.
    """
    if weights.shape[0] > _UNROLLED:
        return columns @ weights
    total: Any = sum(columns[..., i] * weights[i] for i in range(weights.shape[0]))
    return total
