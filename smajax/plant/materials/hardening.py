"""Smooth hardening of Lagoudas' law, and its inverse.

    h(xi; n, m) = (1 + xi^n - (1 - xi)^m) / 2

h rises from 0 to 1 with the martensite fraction xi. Exponents of 1 make it linear (the polynomial hardening of
boyd1996); with smaller ones a transformation starts and finishes gradually. The law uses the inverse: the fraction at
which the hardening has a given value.

Source: lagoudas2012, the hardening function without its constants.
"""

from typing import Any

import jax
import jax.numpy as jnp
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import maximum, minimum

# Gives an error below 2e-9 at exponents down to 0.01; tests/unit/plant/test_lagoudas.py holds it.
_MAX_ITERATIONS = 6
# Tolerance of log x. Newton's method converges quadratically: after a step of this size the error is its square, 1e-16.
_TOLERANCE = 1e-8
# Keeps logarithms and quotients finite at 0; near the smallest double-precision number, so it changes no other value.
_TINY = 1e-300


def hardening(fraction: Float[Array, "..."], n: Float[Array, "..."], m: Float[Array, "..."]) -> Float[Array, "..."]:
    """Compute the hardening h(xi; n, m) = (1 + xi^n - (1 - xi)^m) / 2, from 0 to 1.

    Args:
        fraction: Martensite fraction xi, 0 to 1.
        n: Exponent at xi = 0.
        m: Exponent at xi = 1.
    """
    return 0.5 * (1.0 + _power(fraction, n) - _power(1.0 - fraction, m))


def _power(base: jax.Array, exponent: jax.Array) -> jax.Array:
    """base^exponent for a base of 0..1, by logarithms, which compile to faster code than the library's power."""
    return jnp.where(base > 0.0, jnp.exp(exponent * jnp.log(maximum(base, _TINY))), 0.0)


@jax.custom_jvp
def inverse_hardening(
    share: Float[Array, "..."], n: Float[Array, "..."], m: Float[Array, "..."]
) -> Float[Array, "..."]:
    """Compute the martensite fraction xi at which the hardening h(xi; n, m) is ``share``, elementwise.

    Args:
        share: Value of the hardening.
        n: Exponent at xi = 0, 0.01 to 1.
        m: Exponent at xi = 1, 0.01 to 1.

    Returns:
        The fraction: 0 for a share below 0, 1 for a share above 1.
    """
    lower_half, inside, distance = _solve(share, n, m)
    return jnp.where(lower_half, distance, 1.0 - distance) * inside + jnp.where(share >= 1.0, 1.0, 0.0)


@inverse_hardening.defjvp
def _inverse_hardening_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    """Tangent by the implicit function theorem."""
    share, n, m = primals
    share_dot, n_dot, m_dot = tangents
    lower_half, inside, distance = _solve(share, n, m)
    distance = maximum(distance, _TINY)
    fraction = jnp.where(lower_half, distance, 1.0 - distance)
    austenite = jnp.where(lower_half, 1.0 - distance, distance)
    log_fraction, log_austenite = jnp.log(fraction), jnp.log(austenite)
    fraction_power, austenite_power = jnp.exp(n * log_fraction), jnp.exp(m * log_austenite)
    slope = 0.5 * (n * fraction_power / fraction + m * austenite_power / austenite)
    moved = share_dot - 0.5 * (n_dot * fraction_power * log_fraction - m_dot * austenite_power * log_austenite)
    value = jnp.where(lower_half, distance, 1.0 - distance) * inside + jnp.where(share >= 1.0, 1.0, 0.0)
    return value, jnp.where(inside, moved / slope, 0.0)


def _solve(share: jax.Array, n: jax.Array, m: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Whether the fraction is below a half, whether it is between 0 and 1, and its distance from the nearer of these.

    The upper half mirrors the lower one: 1 - h(xi; n, m) = h(1 - xi; m, n). As a function of u = log x, h is convex and
    increasing, so Newton's method from above, x^n <= 2 share, descends monotonically to the root.
    """
    inside = (share > 0.0) & (share < 1.0)
    share = jnp.where(inside, share, 0.5)
    lower_half = share < hardening(jnp.asarray(0.5), n, m)
    target = jnp.where(lower_half, share, 1.0 - share)
    a, b = jnp.where(lower_half, n, m), jnp.where(lower_half, m, n)
    top = jnp.log(0.5)

    def iterate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        u, _, count = carry
        x, x_power = jnp.exp(u), jnp.exp(a * u)
        rest_power = jnp.exp(b * jnp.log1p(-x))
        slope = 0.5 * (a * x_power + b * rest_power / (1.0 - x) * x)
        new = minimum(u - (0.5 * (1.0 + x_power - rest_power) - target) / maximum(slope, _TINY), top)
        return new, inside & (jnp.abs(new - u) > _TOLERANCE), count + 1

    # Most steps of a wire are outside its transformations, where the loop has no iterations.
    start = minimum(jnp.log(2.0 * target) / a, top), inside, 0
    u, *_ = jax.lax.while_loop(lambda carry: jnp.any(carry[1]) & (carry[2] < _MAX_ITERATIONS), iterate, start)
    return lower_half, inside, jnp.exp(u)
