"""A slender cantilever that bends far: the elastica, without the assumption of small slopes.

A tip moment M bends it up, a force F at the tip pulls down, across the undeformed axis:

    E I theta'(s) = M - F (x(L) - x(s)),    theta(0) = 0,    x' = cos(theta),    y' = sin(theta)

Collocation at Chebyshev points makes it a small dense system in the curvature, which Newton's method solves while the load grows in steps;
a last step from the solution carries the derivatives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

_POINTS, _LOADS, _ITERATIONS = 24, 6, 5


class Bent(NamedTuple):
    """Where a cantilever's tip comes to: coordinates along and across the undeformed axis (m), slope (rad); and the curvature at the clamp
    (1/m)."""

    x: jax.Array
    y: jax.Array
    slope: jax.Array
    clamp_curvature: jax.Array


def _integration() -> np.ndarray:
    """Integrals from 0 to each point, of values at the points (Chebyshev points of the unit interval, both ends among them)."""
    points = -np.cos(np.pi * np.arange(_POINTS) / (_POINTS - 1))
    values = np.polynomial.chebyshev.chebvander(points, _POINTS - 1)
    bases = [np.polynomial.chebyshev.chebint(row, lbnd=-1.0) for row in np.eye(_POINTS)]
    integrals = np.column_stack([np.polynomial.chebyshev.chebval(points, basis) for basis in bases])
    return 0.5 * integrals @ np.linalg.inv(values)


_INTEGRAL = _integration()


def bend(force: jax.Array, moment: jax.Array, length: jax.Array, rigidity: jax.Array) -> Bent:
    """The cantilever under a tip force (N) and a tip moment (N m) that oppose each other; scalars, differentiable once.

    Holds for slopes of up to about a right angle; NaN, or another branch, where the load would curl the beam up.
    """
    pull, turn = force * length**2 / rigidity, moment * length / rigidity

    def left(curvature: jax.Array, share: jax.Array | float) -> jax.Array:
        """What is left of the balance at each point, in units of 1 / L, under a share of the load."""
        x = _INTEGRAL @ jnp.cos(_INTEGRAL @ curvature)
        return curvature - share * (turn - pull * (x[-1] - x))

    def closer(curvature: jax.Array, share: jax.Array | float) -> jax.Array:
        return curvature - jnp.linalg.solve(jax.jacfwd(left)(curvature, share), left(curvature, share))

    def load(curvature: jax.Array, share: jax.Array) -> tuple[jax.Array, None]:
        return jax.lax.fori_loop(0, _ITERATIONS, lambda _, c: closer(c, share), curvature), None

    found = jax.lax.stop_gradient(jax.lax.scan(load, jnp.zeros(_POINTS), (jnp.arange(_LOADS) + 1.0) / _LOADS)[0])
    slope_of = jax.lax.stop_gradient(jax.jacfwd(left)(found, 1.0))
    curvature = found - jnp.linalg.solve(slope_of, left(found, 1.0))
    theta = _INTEGRAL @ curvature
    x, y = (length * (_INTEGRAL @ f(theta))[-1] for f in (jnp.cos, jnp.sin))
    return Bent(x, y, theta[-1], curvature[0] / length)
