"""Symmetric systems on a grid of cells, each coupled to its four neighbours: factored by rows of cells, solved again and again.

With the cells of a row in one block, the matrix is block tridiagonal and its off-diagonal blocks are diagonal. Eliminated row by row, the
blocks that remain, D_i - U_(i-1) S_(i-1) U_(i-1), are inverted once (S_i); each solution is then a sweep down the rows and one up, two
products with S_i a row. A solution is differentiated by the implicit function theorem: its tangent and its cotangent are solutions of the
same system, which the same factors give.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp

_FEW = 16  # tangents of as many parameters


@jax.custom_batching.custom_vmap
def _product(symmetric: jax.Array, vector: jax.Array) -> jax.Array:
    """A symmetric matrix times a vector, as a sum of columns: on a CPU faster than a product of matrices."""
    return jnp.sum(symmetric * vector[:, None], axis=0)


@_product.def_vmap
def _product_batch(size: int, batched: list, symmetric: jax.Array, vector: jax.Array) -> tuple[jax.Array, bool]:
    """Of a few vectors with one matrix one by one, which a CPU does faster than all together; else as products."""
    if batched[0]:
        vector = vector if batched[1] else jnp.broadcast_to(vector, (size, *vector.shape))
        return jnp.einsum("bij,bj->bi", symmetric, vector), True
    if size > _FEW:
        return vector @ symmetric, True
    return jnp.stack([_product(symmetric, one) for one in vector]), True


def inverted(positive: jax.Array) -> jax.Array:
    """The inverse of a symmetric positive definite matrix, ``(c, c)``, by sweeping one pivot after the other.

    LAPACK's would share so small a matrix among threads that wait for each other, on a busy machine a hundred times as long as they work.
    """

    def sweep(k: jax.Array, matrix: jax.Array) -> jax.Array:
        column = matrix[:, k]
        row = column / column[k]
        here = jnp.arange(len(matrix)) == k
        swept = matrix - column[:, None] * row[None, :]
        swept = jnp.where(here[:, None], row[None, :], jnp.where(here[None, :], row[:, None], swept))
        return jnp.where(here[:, None] & here[None, :], -1.0 / column[k], swept)

    return -jax.lax.fori_loop(0, len(positive), sweep, positive)


class FivePoint(NamedTuple):
    """A symmetric matrix over ``r`` rows of ``c`` cells: the diagonal ``(r, c)``, and the couplings within rows ``(r, c - 1)`` and between
    them ``(r - 1, c)``, which stand in the matrix with a minus."""

    diagonal: jax.Array
    within: jax.Array
    between: jax.Array

    def apply(self, x: jax.Array) -> jax.Array:
        """The product with ``x``, both of shape ``(r, c)``."""
        product = self.diagonal * x
        product = product.at[:, 1:].add(-self.within * x[:, :-1]).at[:, :-1].add(-self.within * x[:, 1:])
        return product.at[1:].add(-self.between * x[:-1]).at[:-1].add(-self.between * x[1:])

    def factor(self) -> jax.Array:
        """The inverses S_i of the eliminated rows, shape ``(r, c, c)``, without derivatives, which no solution needs of them."""
        cells = self.diagonal.shape[1]
        fixed = jax.lax.stop_gradient(self)
        above = jnp.concatenate([jnp.zeros((1, cells)), fixed.between])

        def eliminate(inverse: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
            diagonal, within, coupling = row
            block = jnp.diag(diagonal) - jnp.diag(within, 1) - jnp.diag(within, -1)
            inverse = inverted(block - coupling[:, None] * inverse * coupling[None, :])
            return inverse, inverse

        return jax.lax.scan(eliminate, jnp.zeros((cells, cells)), (fixed.diagonal, fixed.within, above))[1]

    def solve(self, factors: jax.Array, right: jax.Array) -> jax.Array:
        """The solution for a right-hand side, both of shape ``(r, c)``; differentiable in matrix and right-hand side."""
        between = jax.lax.stop_gradient(self.between)
        zero = jnp.zeros((1, right.shape[1]))

        def sweep(right: jax.Array) -> jax.Array:
            def down(known: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
                inverse, right, coupling = row
                known = _product(inverse, right + coupling * known)
                return known, known

            def up(x: jax.Array, row: tuple) -> tuple[jax.Array, jax.Array]:
                inverse, known, coupling = row
                x = known + _product(inverse, coupling * x)
                return x, x

            _, known = jax.lax.scan(down, zero[0], (factors, right, jnp.concatenate([zero, between])))
            return jax.lax.scan(up, zero[0], (factors, known, jnp.concatenate([between, zero])), reverse=True)[1]

        return jax.lax.custom_linear_solve(self.apply, right, lambda _, b: sweep(b), symmetric=True)
