"""The smooth hardening of Lagoudas' law, and its inverse.

    h(xi; n, m) = (1 + xi^n - (1 - xi)^m) / 2        (Lagoudas et al. 2012, without its constants)

rises from 0 to 1 with the martensite fraction; exponents of 1 make it a straight line (the polynomial hardening of Boyd and Lagoudas 1996),
smaller ones let a transformation begin and end gradually. A material asks the other way round: which fraction has hardened by a share.
"""

import jax
import jax.numpy as jnp

from smajax.kinks import larger, smaller

# Enough for an error below 2e-9 at exponents down to 0.01.
_STEPS = 6
# Of log x: the error that a step of this size leaves is its square.
_SETTLED = 1e-8
_LEAST = 1e-300


def hardening(fraction: jax.Array, n: jax.Array, m: jax.Array) -> jax.Array:
    """Share of its hardening that a transformation has gone through at a martensite fraction of 0..1."""
    return 0.5 * (1.0 + _power(fraction, n) - _power(1.0 - fraction, m))


def _power(base: jax.Array, exponent: jax.Array) -> jax.Array:
    """base^exponent for a base of 0..1, by logarithms, which compile to faster code than the library's power."""
    return jnp.where(base > 0.0, jnp.exp(exponent * jnp.log(larger(base, _LEAST))), 0.0)


@jax.custom_jvp
def hardened(share: jax.Array, n: jax.Array, m: jax.Array) -> jax.Array:
    """The martensite fraction at which ``hardening`` is ``share``; below 0 it is 0, above 1 it is 1. Elementwise; n and m in 0.01..1."""
    lower, near, small = _solve(share, n, m)
    return jnp.where(lower, small, 1.0 - small) * near + jnp.where(share >= 1.0, 1.0, 0.0)


@hardened.defjvp
def _hardened_jvp(primals: tuple, tangents: tuple) -> tuple[jax.Array, jax.Array]:
    """By the implicit function theorem."""
    share, n, m = primals
    lower, near, small = _solve(share, n, m)
    small = larger(small, _LEAST)
    fraction, rest = jnp.where(lower, small, 1.0 - small), jnp.where(lower, 1.0 - small, small)
    logs = jnp.log(fraction), jnp.log(rest)
    grown, left = jnp.exp(n * logs[0]), jnp.exp(m * logs[1])
    slope = 0.5 * (n * grown / fraction + m * left / rest)
    moved = tangents[0] - 0.5 * (tangents[1] * grown * logs[0] - tangents[2] * left * logs[1])
    value = jnp.where(lower, small, 1.0 - small) * near + jnp.where(share >= 1.0, 1.0, 0.0)
    return value, jnp.where(near, moved / slope, 0.0)


def _solve(share: jax.Array, n: jax.Array, m: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Whether the fraction is below a half, whether it is between 0 and 1, and its distance from the nearer of these.

    The half above mirrors the half below: 1 - h(xi; n, m) = h(1 - xi; m, n). In u = log x the function is convex and rising, so that
    Newton's method from above, x^n <= 2 share, comes down to the root and never passes it.
    """
    near = (share > 0.0) & (share < 1.0)
    share = jnp.where(near, share, 0.5)
    lower = share < hardening(jnp.asarray(0.5), n, m)
    target, a, b = jnp.where(lower, share, 1.0 - share), jnp.where(lower, n, m), jnp.where(lower, m, n)
    top = jnp.log(0.5)

    def newton(carry: tuple) -> tuple:
        u, _, count = carry
        x, w = jnp.exp(u), jnp.exp(a * u)
        rest = jnp.exp(b * jnp.log1p(-x))
        slope = 0.5 * (a * w + b * rest / (1.0 - x) * x)
        new = smaller(u - (0.5 * (1.0 + w - rest) - target) / larger(slope, _LEAST), top)
        return new, near & (jnp.abs(new - u) > _SETTLED), count + 1

    # Most steps of a wire lie outside its transformations: there the loop has no turns.
    first = smaller(jnp.log(2.0 * target) / a, top), near, 0
    u, *_ = jax.lax.while_loop(lambda carry: jnp.any(carry[1]) & (carry[2] < _STEPS), newton, first)
    return lower, near, jnp.exp(u)
