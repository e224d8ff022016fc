"""Maximum, minimum, clip and similar functions, with derivatives that are reliable in compiled programs.

``jnp.maximum`` and similar functions select the side whose derivative counts by comparing each side with the result. A
compiled program may compute a side twice, once with a rounded product and once with a fused multiply-add, so that
neither side equals the result and the derivative is silently 0. Here the comparison of the two sides selects the
derivative. At a tie the derivative is the mean of both sides; NaN stays NaN.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike


@jax.custom_jvp
def maximum(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """Compute the larger of two values, elementwise.

    Args:
        a: Floating-point values.
        b: Floating-point values that broadcast with ``a``.
    """
    return jnp.maximum(a, b)


@jax.custom_jvp
def minimum(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """Compute the smaller of two values, elementwise.

    Args:
        a: Floating-point values.
        b: Floating-point values that broadcast with ``a``.
    """
    return jnp.minimum(a, b)


def _selected(a_counts: ArrayLike, b_counts: ArrayLike, a_dot: ArrayLike, b_dot: ArrayLike) -> jax.Array:
    """The tangent of the side that counts, or half of each at a tie."""
    return jnp.where(a_counts, a_dot, jnp.where(b_counts, b_dot, 0.5 * a_dot + 0.5 * b_dot))


@maximum.defjvp
def _maximum_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    (a, b), (a_dot, b_dot) = primals, tangents
    return jnp.maximum(a, b), _selected(a > b, b > a, a_dot, b_dot)


@minimum.defjvp
def _minimum_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    (a, b), (a_dot, b_dot) = primals, tangents
    return jnp.minimum(a, b), _selected(a < b, b < a, a_dot, b_dot)


def clip(value: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> jax.Array:
    """Limit values to an interval, elementwise.

    Args:
        value: The values.
        lower: Lower bound.
        upper: Upper bound; it is the result if it is below the lower bound.
    """
    return minimum(maximum(value, lower), upper)


def largest(values: jax.Array, axis: int | None = None) -> jax.Array:
    """Compute the largest value along an axis; among equal values the first one has the derivative.

    Args:
        values: The values, of any shape.
        axis: The axis; ``None`` for the largest of all values.
    """
    values, axis = (jnp.ravel(values), 0) if axis is None else (values, axis)
    index = jax.lax.stop_gradient(jnp.argmax(values, axis=axis, keepdims=True))
    return jnp.squeeze(jnp.take_along_axis(values, index, axis=axis), axis)


def peak_to_peak(values: jax.Array) -> jax.Array:
    """Compute the range of values: the largest of all less the smallest."""
    return largest(values) + largest(-values)
