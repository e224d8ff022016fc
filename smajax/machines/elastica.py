"""A slender cantilever that bends far: the elastica, without the assumption of small slopes.

A tip moment M bends it up, a force F at the tip pulls down, across the undeformed axis:

    E I theta'(s) = M - F (x(L) - x(s)),    theta(0) = 0,    x' = cos(theta),    y' = sin(theta)

Collocation at Chebyshev points makes it a small dense system in the curvature. It is followed from no load to the whole one, in steps that
Newton's method solves from where the tangent points to; a step that is not solved, or leads elsewhere, is halved. A last step from the
solution carries the derivatives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

_POINTS, _ITERATIONS, _TRIES = 40, 6, 100
_FIRST, _LEAST = 1.0 / 8.0, 1e-6
# How far from the tangent a step may lead, in rad; what may be left of the balance beside its terms; how small the last terms have to be.
_NEAR, _LEFT, _RESOLVED = 0.1, 1e-10, 1e-5


class Bent(NamedTuple):
    """Where a cantilever's tip comes to: coordinates along and across the undeformed axis (m), slope (rad); the curvature at the clamp
    (1/m), and how far the tip came back along the axis (m), which is precise where it is small."""

    x: jax.Array
    y: jax.Array
    slope: jax.Array
    clamp_curvature: jax.Array
    shortening: jax.Array


_CHEBYSHEV = -np.cos(np.pi * np.arange(_POINTS) / (_POINTS - 1))
_TERMS = np.linalg.inv(np.polynomial.chebyshev.chebvander(_CHEBYSHEV, _POINTS - 1))


def _integration() -> np.ndarray:
    """Integrals from 0 to each point, of values at the points (Chebyshev points of the unit interval, both ends among them)."""
    bases = [np.polynomial.chebyshev.chebint(row, lbnd=-1.0) for row in np.eye(_POINTS)]
    integrals = np.column_stack([np.polynomial.chebyshev.chebval(_CHEBYSHEV, basis) for basis in bases])
    return 0.5 * integrals @ _TERMS


_INTEGRAL = _integration()


def bend(force: jax.Array, moment: jax.Array, length: jax.Array, rigidity: jax.Array) -> Bent:
    """The cantilever under a tip force (N) and a tip moment (N m) that oppose each other; scalars, differentiable once.

    It is the bend that comes of loads growing together. NaN where there is none: where it would give way on the way to the whole load, or
    bends within too short a part of its length.
    """
    pull, turn = force * length**2 / rigidity, moment * length / rigidity
    found = _followed(*jax.lax.stop_gradient((pull, turn)))
    inverse, _ = _inverted(jax.lax.stop_gradient(jax.jacfwd(_left)(found, pull, turn)))
    curvature = found - inverse @ _left(found, pull, turn)
    theta = _INTEGRAL @ curvature
    x, y, back = (length * (_INTEGRAL @ f)[-1] for f in (jnp.cos(theta), jnp.sin(theta), 2.0 * jnp.sin(0.5 * theta) ** 2))
    return Bent(x, y, theta[-1], curvature[0] / length, back)


def _left(curvature: jax.Array, pull: jax.Array, turn: jax.Array) -> jax.Array:
    """What is left of the balance at each point, in units of 1 / L."""
    x = _INTEGRAL @ jnp.cos(_INTEGRAL @ curvature)
    return curvature - (turn - pull * (x[-1] - x))


def _inverted(matrix: jax.Array) -> tuple[jax.Array, jax.Array]:
    """The inverse of a small matrix, and the sign of its determinant, by elimination with row exchanges.

    Of programs that call LAPACK, two at once may wait for each other for ever.
    """
    size = len(matrix)

    def eliminate(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        rows, sign = state
        below = jnp.where(jnp.arange(size) >= k, jnp.abs(rows[:, k]), -1.0)
        best = jnp.argmax(below)
        pivot, other = rows[best], rows[k]
        rows = rows.at[best].set(other).at[k].set(pivot)
        sign = sign * jnp.sign(pivot[k]) * jnp.where(best == k, 1.0, -1.0)
        scaled = pivot / pivot[k]
        factors = rows[:, k].at[k].set(0.0)
        return (rows - jnp.outer(factors, scaled)).at[k].set(scaled), sign

    start = jnp.concatenate([matrix, jnp.eye(size)], axis=1), jnp.ones(())
    rows, sign = jax.lax.fori_loop(0, size, eliminate, start)
    return rows[:, size:], sign


def _followed(pull: jax.Array, turn: jax.Array) -> jax.Array:
    """The curvature under the whole load, NaN where it is not reached."""
    size = 1.0 + jnp.abs(pull) + jnp.abs(turn)

    def left(curvature: jax.Array, share: jax.Array) -> jax.Array:
        return _left(curvature, share * pull, share * turn)

    def further(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        share, curvature, step, tries = state
        ahead = jnp.minimum(share + step, 1.0)
        inverse, _ = _inverted(jax.jacfwd(left)(curvature, share))
        guess = curvature - (ahead - share) * inverse @ jax.jacfwd(left, 1)(curvature, share)
        found = jax.lax.fori_loop(0, _ITERATIONS, lambda _, c: c - _inverted(jax.jacfwd(left)(c, ahead))[0] @ left(c, ahead), guess)
        # Where a determinant that was positive without load has changed its sign, the bend has given way.
        holds = _inverted(jax.jacfwd(left)(found, ahead))[1] > 0.0
        solved = jnp.max(jnp.abs(left(found, ahead))) < _LEFT * size
        good = holds & solved & (jnp.max(jnp.abs(_INTEGRAL @ (found - guess))) < _NEAR)
        return jnp.where(good, ahead, share), jnp.where(good, found, curvature), jnp.where(good, 2.0, 0.5) * step, tries + 1

    def goes_on(state: tuple[jax.Array, ...]) -> jax.Array:
        share, _, step, tries = state
        return (share < 1.0) & (step > _LEAST) & (tries < _TRIES)

    start = (jnp.zeros(()), jnp.zeros(_POINTS), jnp.asarray(_FIRST), jnp.asarray(0))
    share, curvature, _, _ = jax.lax.while_loop(goes_on, further, start)
    terms = jnp.abs(_TERMS @ curvature)
    resolved = jnp.max(terms[-3:]) <= _RESOLVED * jnp.max(terms)
    return jnp.where((share >= 1.0) & resolved, curvature, jnp.nan)
