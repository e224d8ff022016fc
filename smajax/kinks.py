"""The larger and the smaller of two numbers, a number held between two ends, the largest of many: with derivatives that programs keep.

``jnp.maximum`` and its like find the side whose derivative counts by asking which one equals the result. A compiled program may compute a
side twice, with the product in it rounded and (as a fused multiply-add) not rounded, so that neither equals it, and the derivative is lost
without a word. Here the comparison itself picks the side. At a tie both sides count half; what is no number stays none.
"""

import jax
import jax.numpy as jnp
from jax.typing import ArrayLike

from smajax import jax_options  # noqa: F401


@jax.custom_jvp
def larger(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """The larger of two floating-point numbers, element by element."""
    return jnp.maximum(a, b)


@jax.custom_jvp
def smaller(a: ArrayLike, b: ArrayLike) -> jax.Array:
    """The smaller of two floating-point numbers, element by element."""
    return jnp.minimum(a, b)


def _mixed(above: jax.Array, below: jax.Array, first: jax.Array, second: jax.Array) -> jax.Array:
    """The tangent of the side that counts, or half of each."""
    return jnp.where(above, first, jnp.where(below, second, 0.5 * first + 0.5 * second))


@larger.defjvp
def _larger_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    (a, b), (first, second) = primals, tangents
    return jnp.maximum(a, b), _mixed(a > b, b > a, first, second)


@smaller.defjvp
def _smaller_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    (a, b), (first, second) = primals, tangents
    return jnp.minimum(a, b), _mixed(a < b, b < a, first, second)


def within(value: ArrayLike, lower: ArrayLike, upper: ArrayLike) -> jax.Array:
    """The value, or the end that it is beyond; one of two ends that cross is the upper one."""
    return smaller(larger(value, lower), upper)


def largest(values: jax.Array, axis: int | None = None) -> jax.Array:
    """The largest value along an axis, or of all; of several that are, the first counts."""
    values, axis = (jnp.ravel(values), 0) if axis is None else (values, axis)
    place = jax.lax.stop_gradient(jnp.argmax(values, axis=axis, keepdims=True))
    return jnp.squeeze(jnp.take_along_axis(values, place, axis=axis), axis)


def swing(values: jax.Array) -> jax.Array:
    """The largest value less the smallest one, of all."""
    return largest(values) + largest(-values)
