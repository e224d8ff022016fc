"""Tangents of functions and of implicitly defined solutions (implicit function theorem)."""

from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.dense import combine, inverse, solve_dense
from smajax.numerics.derivative_order import first_order_only, nondifferentiable


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
    return state - combine(state_per_unknown, change)


def implicit_jvp_from_jacobian(
    jacobian: Float[Array, "unknowns unknowns"],
    step_residual: Callable[..., Any],
    end: Float[Array, " unknowns"],
    primals: tuple[Any, ...],
    tangents: tuple[Any, ...],
) -> Float[Array, " entries"]:
    """Compute ``implicit_jvp`` with a given Jacobian dr/dz: by one tangent in all other arguments and one in z.

    Args:
        jacobian: The Jacobian at the solution, shape ``(unknowns, unknowns)``.
        step_residual: As in ``implicit_jvp``.
        end: The solution z, shape ``(unknowns,)``.
        primals: The other arguments p.
        tangents: Tangents of ``primals``, with ``None`` for zero.

    Returns:
        The tangent of the flat state.
    """
    residual, state = jvp(lambda *primals: step_residual(end, *primals), primals, tangents)
    # Not a product of matrices: a batch of them would be left to a library, which no kernel may call.
    change = -jnp.sum(inverse(jacobian) * residual[None], axis=1)
    return state + jvp(lambda z: step_residual(z, *primals)[1], (end,), (change,))


@eqx.filter_custom_jvp
def implicit_root(
    residual: Callable[..., Any], search: Callable[..., Any], arguments: tuple[Any, ...], name: str
) -> Float[Array, " unknowns"]:
    """Search for a root z of ``residual(z, *arguments)``; differentiable once in the arguments, in both modes.

    The search is not differentiated: dz = -(dr/dz)^-1 (dr/dp) dp, with p the arguments.

    Args:
        residual: Function of the root, shape ``(unknowns,)``, and of the arguments; it must not capture traced values.
        search: Function of the arguments that returns the root; it must not capture traced values.
        arguments: Pytrees.
        name: Name of the function for the message of a second derivative.

    Returns:
        The root.

    Raises:
        DerivativeError: When a second derivative is taken.
    """
    return search(*arguments)


@implicit_root.def_jvp
def _implicit_root_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[Any, ...]:
    residual, search, arguments, name = primals
    arguments = nondifferentiable(arguments, first_order_only(name))
    root = search(*arguments)
    return root, implicit_jvp(lambda z, *p: (residual(z, *p), z), root, arguments, tangents[2])
