"""The interface between a fit problem and a search, and the two functions of a problem that are compiled."""

import abc
import functools
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.fitting.compilation import SEARCH_OPTIONS, vmap_unless_single
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.numerics.stored_programs import stored
from smajax.parameters import CheckedModule


class AbstractFitProblem(CheckedModule):
    """A weighted residual as a function of one vector of ``p`` numbers of order one, with bounds.

    Attributes:
        data: Recordings; ``data.measured`` has a leading axis of recordings, and each evaluation simulates all of them.
    """

    data: eqx.AbstractVar[Any]

    @property
    def size(self) -> int:
        """Length of the residual."""
        return self.data.measured.size

    @property
    @abc.abstractmethod
    def nominal(self) -> np.ndarray:
        """The vector at which a search starts, shape ``(p,)``."""

    @property
    @abc.abstractmethod
    def bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Lower and upper bounds of the vector, each of shape ``(p,)``."""

    def search_bounds(self) -> tuple[np.ndarray, np.ndarray]:
        """Return finite bounds within ``bounds``, each of shape ``(p,)``, for random starts and populations."""
        return self.bounds

    @abc.abstractmethod
    def residual(self, vector: Float[Array, " p"]) -> Float[Array, " size"]:
        """Return measurement minus model over the noise, shape ``(size,)``; zero where nothing was measured."""


def residual(vector: Float[Array, " p"], problem: AbstractFitProblem) -> Float[Array, " size"]:
    """Return the weighted residual of a problem, with the arguments in the order that a solver needs.

    Args:
        vector: The problem's vector (p,).
        problem: The problem.

    Returns:
        Measurement minus model over the noise (size,).
    """
    return problem.residual(vector)


compiled_residual: Callable[[Float[Array, " p"], AbstractFitProblem], Float[Array, " size"]] = jit_with_kernels(
    residual, compiler_options=SEARCH_OPTIONS
)
"""``residual``, compiled with the options of the searches' programs."""


@functools.partial(stored, compiler_options=SEARCH_OPTIONS)
def costs(problem: AbstractFitProblem, vectors: Float[Array, "m p"]) -> Float[Array, " m"]:
    """Compute the sums of squares of the residual at several vectors, as one batch.

    Args:
        problem: The problem.
        vectors: Vectors (m, p).

    Returns:
        The costs (m,); NaN or infinite where the residual is.
    """

    def cost(vector: Float[Array, " p"]) -> Float[Array, ""]:
        return jnp.sum(problem.residual(vector) ** 2)

    return vmap_unless_single(cost, vectors.shape[0], vectors)
