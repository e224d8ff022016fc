"""Maximum, minimum, clip and their like, with derivatives that compiled programs keep.

``jnp.maximum`` and its like find the side whose derivative counts by comparing each side with the result. A compiled
program may compute a side twice, once with a product in it rounded and once (as a fused multiply-add) not rounded, so
that neither side equals the result and the derivative is silently lost. Here the comparison of the two sides itself
selects the derivative. At a tie both sides count half; NaN stays NaN.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from smajax.numerics import jax_setup as jax_setup


@jax.custom_jvp
def maximum(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """Return the larger of two floating-point numbers, elementwise."""
    return jnp.maximum(a, b)


@jax.custom_jvp
def minimum(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """Return the smaller of two floating-point numbers, elementwise."""
    return jnp.minimum(a, b)


def _selected(a_counts: ArrayLike, b_counts: ArrayLike, a_dot: ArrayLike, b_dot: ArrayLike) -> jax.Array:
    """The tangent of the side that counts, or half of each at a tie."""
    return jnp.where(a_counts, a_dot, jnp.where(b_counts, b_dot, 0.5 * a_dot + 0.5 * b_dot))


@maximum.defjvp
def _maximum_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    (a, b), (a_dot, b_dot) = primals, tangents
    return jnp.maximum(a, b), _selected(a > b, b > a, a_dot, b_dot)


@minimum.defjvp
def _minimum_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    (a, b), (a_dot, b_dot) = primals, tangents
    return jnp.minimum(a, b), _selected(a < b, b < a, a_dot, b_dot)


def clip(value: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> jax.Array:
    """Limit a value to ``lower`` .. ``upper``, elementwise; where the bounds cross, the result is ``upper``."""
    return minimum(maximum(value, lower), upper)


def largest(values: jax.Array, axis: int | None = None) -> jax.Array:
    """Return the largest value along an axis, or of all; among equal ones the first has the derivative.

    Args:
        values: The values, of any shape.
        axis: The axis, or ``None`` for all values.
    """
    values, axis = (jnp.ravel(values), 0) if axis is None else (values, axis)
    index = jax.lax.stop_gradient(jnp.argmax(values, axis=axis, keepdims=True))
    return jnp.squeeze(jnp.take_along_axis(values, index, axis=axis), axis)


def peak_to_peak(values: jax.Array) -> jax.Array:
    """Return the largest of all values less the smallest one."""
    return largest(values) + largest(-values)
