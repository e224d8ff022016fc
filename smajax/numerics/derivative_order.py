"""Functions with derivatives of first order only: a second derivative raises, in place of a silent wrong number.

The tangent of an implicit solution is computed at the solved values, which the search for them does not differentiate.
Differentiated once more, such a tangent would lack the motion of the solution, without a word. ``nondifferentiable``
marks the values that a tangent is computed at; ``once_differentiable`` makes a function whose tangent is marked so.
``forward_mode_only`` marks results that have no derivative in reverse mode.
"""

from collections.abc import Callable
from typing import Any, TypeVar

import equinox as eqx
import jax
import jax.extend.core
from jax.interpreters import ad, batching, mlir

from smajax.errors import DerivativeError

Tree = TypeVar("Tree")


def _identity(name: str) -> jax.extend.core.Primitive:
    """Return the identity of arrays as a primitive, without derivatives; it takes the message of an error."""
    primitive = jax.extend.core.Primitive(name)
    primitive.multiple_results = True
    primitive.def_impl(lambda *leaves, message: list(leaves))
    primitive.def_abstract_eval(lambda *leaves, message: list(leaves))
    mlir.register_lowering(primitive, lambda ctx, *leaves, message: leaves)
    batching.primitive_batchers[primitive] = lambda leaves, axes, message: (
        primitive.bind(*leaves, message=message),
        axes,
    )
    return primitive


def _refuse(*arguments: Any, message: str) -> tuple[Any, ...]:
    raise DerivativeError(message)


def _forward_only_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...], *, message: str) -> tuple[Any, ...]:
    instantiated = [ad.instantiate_zeros(tangent) for tangent in tangents]
    return tuple(_forward_only.bind(*leaves, message=message) for leaves in (primals, instantiated))


# ``jax.custom_jvp`` is not enough: reverse mode through a scan inlines what its rule computes, so that a second
# derivative would not raise.
_marked = _identity("smajax_nondifferentiable")
ad.primitive_jvps[_marked] = _refuse
_forward_only = _identity("smajax_forward_mode_only")
ad.primitive_jvps[_forward_only] = _forward_only_jvp
ad.primitive_transposes[_forward_only] = _refuse


def nondifferentiable(tree: Tree, message: str) -> Tree:
    """Return the values unchanged; whoever differentiates a result in them, in either mode, gets an error.

    Args:
        tree: Any pytree; only its floating-point arrays are marked.
        message: The sentence of the error (``first_order_only``).

    Raises:
        DerivativeError: When the result is differentiated.
    """
    return _bind(_marked, tree, message)


def forward_mode_only(tree: Tree, message: str) -> Tree:
    """Return the values unchanged; whoever differentiates a result in them in reverse mode gets an error.

    Args:
        tree: Any pytree; only its floating-point arrays are marked.
        message: The sentence of the error.

    Raises:
        DerivativeError: When the result is differentiated in reverse mode.
    """
    return _bind(_forward_only, tree, message)


def _bind(primitive: jax.extend.core.Primitive, tree: Tree, message: str) -> Tree:
    """Apply the primitive to the floating-point arrays of a pytree."""
    numbers, others = eqx.partition(tree, eqx.is_inexact_array)
    leaves, structure = jax.tree.flatten(numbers)
    if not leaves:
        return tree
    return eqx.combine(jax.tree.unflatten(structure, primitive.bind(*leaves, message=message)), others)


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
