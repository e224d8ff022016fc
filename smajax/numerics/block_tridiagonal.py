"""Symmetric linear systems on a grid of cells coupled to their four neighbours: factored once, solved repeatedly.

With the cells of a row in one block, the matrix is block tridiagonal, and its off-diagonal blocks -U_i are diagonal.
Block elimination, row by row, inverts the Schur complement of each diagonal block D_i once:

    S_i = (D_i - U_(i-1) S_(i-1) U_(i-1))^-1

A solution is then a sweep down the rows and a sweep up, with two products by S_i per row. It is differentiated by the
implicit function theorem: its tangent and its cotangent are solutions of the same system, with the same factors.

For speed, ``_product`` has its own batching rule, and ``invert_positive_definite`` replaces LAPACK (see there).
"""

from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

# Largest number of vectors whose products with one matrix are computed one by one, which a CPU does faster than one
# product of matrices. A Jacobian with respect to that many parameters has that many vectors. Chosen by trial;
# tests/unit/actuators/test_cross_section.py holds the values.
_MAX_SEPARATE_PRODUCTS = 16


@jax.custom_batching.custom_vmap
def _product(symmetric: jax.Array, vector: jax.Array) -> jax.Array:
    """A symmetric matrix times a vector, as a sum of columns: on a CPU faster than a product of matrices."""
    return jnp.sum(symmetric * vector[:, None], axis=0)


@_product.def_vmap
def _product_batch(size: int, batched: list[Any], symmetric: jax.Array, vector: jax.Array) -> tuple[jax.Array, bool]:
    """Products of a batch; those of one matrix with few vectors are computed one by one."""
    if batched[0]:
        vector = vector if batched[1] else jnp.broadcast_to(vector, (size, *vector.shape))
        return jnp.einsum("bij,bj->bi", symmetric, vector), True
    if size > _MAX_SEPARATE_PRODUCTS:
        return vector @ symmetric, True
    return jnp.stack([_product(symmetric, row) for row in vector]), True


def invert_positive_definite(matrix: Float[Array, "c c"]) -> Float[Array, "c c"]:
    """Invert a symmetric positive definite matrix by the sweep operator, one pivot after the other.

    LAPACK would distribute such a small matrix over threads that wait for each other; on a busy machine they wait
    for much longer than they compute.

    Args:
        matrix: The matrix, shape ``(c, c)``.

    Returns:
        The inverse, shape ``(c, c)``.
    """

    def sweep(k: jax.Array, matrix: jax.Array) -> jax.Array:
        column = matrix[:, k]
        row = column / column[k]
        pivot = jnp.arange(len(matrix)) == k
        swept = matrix - column[:, None] * row[None, :]
        swept = jnp.where(pivot[:, None], row[None, :], jnp.where(pivot[None, :], row[:, None], swept))
        return jnp.where(pivot[:, None] & pivot[None, :], -1.0 / column[k], swept)

    return -jax.lax.fori_loop(0, len(matrix), sweep, matrix)


class FivePointMatrix(NamedTuple):
    """Symmetric matrix over a grid of ``r`` rows of ``c`` cells, where each cell is coupled to its four neighbours.

    Attributes:
        diagonal: The diagonal, shape ``(r, c)``.
        along_rows: Couplings of neighbours in a row, shape ``(r, c - 1)``; the entries are their negatives.
        across_rows: Couplings of neighbours in a column, shape ``(r - 1, c)``; the entries are their negatives.
    """

    diagonal: jax.Array
    along_rows: jax.Array
    across_rows: jax.Array

    def apply(self, x: Float[Array, "r c"]) -> Float[Array, "r c"]:
        """Multiply the matrix with a vector.

        Args:
            x: The vector on the grid, shape ``(r, c)``.
        """
        product = self.diagonal * x
        product = product.at[:, 1:].add(-self.along_rows * x[:, :-1]).at[:, :-1].add(-self.along_rows * x[:, 1:])
        return product.at[1:].add(-self.across_rows * x[:-1]).at[:-1].add(-self.across_rows * x[1:])

    def factor(self) -> Float[Array, "r c c"]:
        """Compute the inverses S_i of the block elimination, without derivatives: ``solve`` does not need them."""
        cells = self.diagonal.shape[1]
        constant = jax.lax.stop_gradient(self)
        above = jnp.concatenate([jnp.zeros((1, cells)), constant.across_rows])

        def eliminate(inverse: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
            diagonal, along_row, coupling = row
            block = jnp.diag(diagonal) - jnp.diag(along_row, 1) - jnp.diag(along_row, -1)
            inverse = invert_positive_definite(block - coupling[:, None] * inverse * coupling[None, :])
            return inverse, inverse

        rows = (constant.diagonal, constant.along_rows, above)
        return jax.lax.scan(eliminate, jnp.zeros((cells, cells)), rows)[1]

    def solve(self, factors: Float[Array, "r c c"], right: Float[Array, "r c"]) -> Float[Array, "r c"]:
        """Solve the linear system; differentiable in the matrix and the right-hand side.

        Args:
            factors: The result of ``factor``, shape ``(r, c, c)``.
            right: The right-hand side, shape ``(r, c)``.

        Returns:
            The solution, shape ``(r, c)``.
        """
        across_rows = jax.lax.stop_gradient(self.across_rows)
        zero = jnp.zeros((1, right.shape[1]))

        def substitute(right: jax.Array) -> jax.Array:
            def down(eliminated: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
                inverse, right, coupling = row
                eliminated = _product(inverse, right + coupling * eliminated)
                return eliminated, eliminated

            def up(x: jax.Array, row: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
                inverse, eliminated, coupling = row
                x = eliminated + _product(inverse, coupling * x)
                return x, x

            _, eliminated = jax.lax.scan(down, zero[0], (factors, right, jnp.concatenate([zero, across_rows])))
            couplings = jnp.concatenate([across_rows, zero])
            return jax.lax.scan(up, zero[0], (factors, eliminated, couplings), reverse=True)[1]

        return jax.lax.custom_linear_solve(self.apply, right, lambda _, b: substitute(b), symmetric=True)
