"""Small dense linear systems."""

import jax.numpy as jnp
from jaxtyping import Array, Float


def solve_dense(matrix: Float[Array, "n n"], right: Float[Array, " n"]) -> Float[Array, " n"]:
    """Solve a system of up to five equations by Gaussian elimination without pivoting.

    The systems of this package have positive diagonals, for which that is stable enough. The elimination is unrolled:
    it is compiled into the loop over time steps, which a call of LAPACK is not.

    Args:
        matrix: The matrix.
        right: The right-hand side.

    Returns:
        The solution.
    """
    size = right.shape[0]
    rows = [[matrix[i, j] for j in range(size)] + [right[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    solution = [right[0]] * size
    for i in reversed(range(size)):
        solution[i] = (rows[i][size] - sum(rows[i][j] * solution[j] for j in range(i + 1, size))) / rows[i][i]
    return jnp.stack(solution)
