"""Tangents of functions and of implicitly defined solutions (implicit function theorem)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.dense import solve_dense


def jvp(function: Callable[..., Any], primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> Any:
    """Compute the tangent of ``function(*primals)``.

    Args:
        function: Function of pytrees.
        primals: Its arguments.
        tangents: Tangents of the arguments, of the same structure; a leaf ``None`` is a tangent of zero.

    Returns:
        The tangent of the result, with arrays of zeros in place of symbolic zeros.
    """
    value, tangent = eqx.filter_jvp(function, primals, tangents)
    return jax.tree.map(lambda v, t: jnp.zeros_like(v) if t is None else t, value, tangent, is_leaf=lambda x: x is None)


def implicit_jvp(
    step_residual: Callable[..., Any],
    end: Float[Array, " unknowns"],
    primals: tuple[Any, ...],
    tangents: tuple[Any, ...],
) -> Float[Array, " entries"]:
    """Compute the tangent of the state at the end of a step, where the step's residual r is zero.

    The end z solves r(z, p) = 0, with p the other arguments; the state at the end is s(z, p). Then

        ds = (ds/dp) dp - (ds/dz) (dr/dz)^-1 (dr/dp) dp

    Args:
        step_residual: ``step_residual(end, *primals)`` gives the residual, shape ``(unknowns,)``, and the flat state,
            shape ``(entries,)``.
        end: The solution z, shape ``(unknowns,)``.
        primals: The other arguments p.
        tangents: Tangents of ``primals``, with ``None`` for zero.

    Returns:
        The tangent of the flat state.
    """
    jacobian, state_per_unknown = jax.jacfwd(lambda z: step_residual(z, *primals))(end)
    residual, state = jvp(lambda *primals: step_residual(end, *primals), primals, tangents)
    change = solve_dense(jacobian, residual)
    return state - sum(state_per_unknown[:, i] * change[i] for i in range(len(end)))
