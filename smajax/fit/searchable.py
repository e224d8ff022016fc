"""What a search needs of a problem, and the two functions of it that are compiled: each is one program, whoever searches."""

from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np


class Searchable(eqx.Module):
    """Base class of the problems: a weighted residual as a function of one vector of ``p`` numbers of order one, and where to search it.

    ``data.measured`` has a leading axis of recordings: each look at a point simulates all of them.
    """

    data: eqx.AbstractVar[Any]

    @property
    def size(self) -> int:
        """Length of the residual."""
        return self.data.measured.size

    @property
    def nominal(self) -> np.ndarray:
        """Where a search starts, shape ``(p,)``."""
        raise NotImplementedError

    @property
    def box(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector, each of shape ``(p,)``."""
        raise NotImplementedError

    def search_box(self) -> tuple[np.ndarray, np.ndarray]:
        """A finite box inside the bounds from which starts are drawn and populations bred, each of shape ``(p,)``."""
        return self.box

    def residual(self, vector: jax.Array) -> jax.Array:
        """Model minus measurement over the noise, shape ``(size,)``; zero where nothing was measured."""
        raise NotImplementedError


def residual(vector: jax.Array, problem: Searchable) -> jax.Array:
    """The weighted residual at a point, shape ``(size,)``."""
    return problem.residual(vector)


@eqx.filter_jit
def costs(problem: Searchable, vectors: jax.Array) -> jax.Array:
    """Sums of squares at ``m`` points, shape ``(m,)``, as one batch."""

    def single(vector: jax.Array) -> jax.Array:
        return jnp.sum(problem.residual(vector) ** 2)

    if vectors.shape[0] == 1:  # compiles and runs faster without a batch
        return single(vectors[0])[None]
    return jax.vmap(single)(vectors)
