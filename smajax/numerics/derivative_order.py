"""Functions with derivatives of first order only: a second derivative raises, in place of a silent wrong number.

The tangent of an implicit solution is computed at the solved values, which the search for them does not differentiate.
Differentiated once more, such a tangent would lack the motion of the solution, without a word. ``nondifferentiable``
marks the values that a tangent is computed at; ``once_differentiable`` makes a function whose tangent is marked so.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.extend.core
from jax.interpreters import ad, batching, mlir

from smajax.errors import DerivativeError

Tree = TypeVar("Tree")


# The identity as a separate primitive. ``jax.custom_jvp`` is not enough: reverse mode through a scan inlines what its
# rule computes, so that a second derivative would not raise.
_marked = jax.extend.core.Primitive("smajax_nondifferentiable")
_marked.multiple_results = True
_marked.def_impl(lambda *leaves, message: list(leaves))
_marked.def_abstract_eval(lambda *leaves, message: list(leaves))
mlir.register_lowering(_marked, lambda ctx, *leaves, message: leaves)
batching.primitive_batchers[_marked] = lambda leaves, axes, message: (_marked.bind(*leaves, message=message), axes)


def _refuse(primals: tuple[Any, ...], tangents: tuple[Any, ...], *, message: str) -> tuple[Any, ...]:
    raise DerivativeError(message)


ad.primitive_jvps[_marked] = _refuse


def nondifferentiable(tree: Tree, message: str) -> Tree:
    """Return the values unchanged; whoever differentiates a result in them, in either mode, gets an error.

    Args:
        tree: Any pytree; only its floating-point arrays are marked.
        message: The sentence of the error (``first_order_only``).

    Raises:
        DerivativeError: When the result is differentiated.
    """
    numbers, others = eqx.partition(tree, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten(numbers)
    return (
        eqx.combine(jax.tree.unflatten(structure, _marked.bind(*leaves, message=message)), others) if leaves else tree
    )


def first_order_only(name: str) -> str:
    """Return the sentence of the error for a second derivative.

    Args:
        name: Name of the function, such as ``simulate``.
    """
    return (
        f"{name} has derivatives of first order only: differentiate it once, and take finite differences of that "
        "derivative for a second order"
    )


def once_differentiable(name: str) -> Callable[[Callable[..., Any]], Callable[..., Any]]:
    """Return a decorator for functions whose first derivative is right, but not the derivative of that.

    Args:
        name: Name of the function for the message.

    Returns:
        The decorator. The function takes pytrees as positional arguments.
    """

    def decorate(function: Callable[..., Any]) -> Callable[..., Any]:
        wrapped = eqx.filter_custom_jvp(function)

        @wrapped.def_jvp
        def rule(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> Any:
            return eqx.filter_jvp(function, nondifferentiable(primals, first_order_only(name)), tangents)

        return wrapped

    return decorate
