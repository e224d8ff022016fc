"""Compile-time machinery: a computation whose results are stored before they are used.

XLA fuses elementwise operations on a CPU, and computes a value again in each fused loop that uses it. For scalars the
compiler removes the repetition, for arrays it does not: a step of a plant with cells would evaluate the kinetics of its
grains many times. The body of a loop is compiled separately, and its results are stored once. The loop here has
one iteration, of which the compiler does not know.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool


def separately(always: Bool[Array, ""], function: Callable[..., Any], *arguments: Any) -> Any:
    """Compute ``function(*arguments)`` apart from what uses the result; it has no reverse mode.

    Args:
        always: A condition that holds, and that the compiler does not know to hold.
        function: The function.
        *arguments: Its arguments, pytrees.

    Returns:
        The result; NaN if the condition does not hold.
    """
    shapes = jax.eval_shape(function, *arguments)

    undefined = jax.tree.map(lambda shape: jnp.full(shape.shape, jnp.nan, shape.dtype), shapes)
    start: Any = (always, undefined)
    return jax.lax.while_loop(lambda carry: carry[0], lambda _: (False, function(*arguments)), start)[1]
