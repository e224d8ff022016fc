"""Elastica: a slender cantilever under large bending, without the assumption of small slopes.

A moment M at the tip bends the cantilever upwards, and a force F at the tip pulls it down, across the undeformed axis.
With the slope theta at the arc length s from the clamp:

    E I theta'(s) = M - F (x(L) - x(s)),    theta(0) = 0,    x' = cos(theta),    y' = sin(theta)

Collocation at Chebyshev points gives a small dense system of equations in the curvature theta'. The solution is
continued from no load to the whole load. Each load step is predicted along the tangent and solved by Newton's method;
it is halved if Newton's method fails or converges to another branch. A last Newton step at the solution carries the
derivatives.
"""

from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

# Collocation points; at 40 the tip agrees with shooting within 1e-9 (tests/unit/actuators/test_soft_bending.py).
_POINTS = 40
# Newton iterations of a load step; chosen by trial, enough from a prediction within ``_MAX_CHANGE``.
_ITERATIONS = 6
# Largest number of load steps tried; chosen by trial.
_MAX_STEPS = 100
# First load step, as a share of the load; chosen by trial.
_FIRST_STEP = 1.0 / 8.0
# Smallest load step: if a smaller one is needed, the beam counts as buckled; chosen by trial.
_SMALLEST_STEP = 1e-6
# Largest slope in rad by which a solution may differ from its prediction, so that it stays on the branch; chosen by
# trial.
_MAX_CHANGE = 0.1
# Largest residual of a solved step, relative to 1 plus the dimensionless loads: above rounding, below the collocation
# error.
_TOLERANCE = 1e-10
# Largest of the last three Chebyshev coefficients over the largest one, up to which the curvature counts as resolved;
# chosen by trial.
_RESOLVED = 1e-5


class BentShape(NamedTuple):
    """Tip and clamp of a bent cantilever, all scalars.

    Attributes:
        x: Coordinate of the tip along the undeformed axis, m.
        y: Coordinate of the tip across the undeformed axis, m.
        slope: Slope at the tip, rad.
        clamp_curvature: Curvature at the clamp, 1/m.
        shortening: L - x, m, computed without cancellation.
    """

    x: jax.Array
    y: jax.Array
    slope: jax.Array
    clamp_curvature: jax.Array
    shortening: jax.Array


_CHEBYSHEV_POINTS = -np.cos(np.pi * np.arange(_POINTS) / (_POINTS - 1))
# Matrix from values at the points to Chebyshev coefficients.
_TO_COEFFICIENTS = np.linalg.inv(np.polynomial.chebyshev.chebvander(_CHEBYSHEV_POINTS, _POINTS - 1))


def _integration_matrix() -> np.ndarray:
    """Integrals from 0 to each point of the unit interval, from values at the points."""
    bases = [np.polynomial.chebyshev.chebint(row, lbnd=-1.0) for row in np.eye(_POINTS)]
    integrals = np.column_stack([np.polynomial.chebyshev.chebval(_CHEBYSHEV_POINTS, basis) for basis in bases])
    return 0.5 * integrals @ _TO_COEFFICIENTS


_INTEGRAL = _integration_matrix()


def solve_elastica(
    force: Float[Array, ""], moment: Float[Array, ""], length: Float[Array, ""], rigidity: Float[Array, ""]
) -> BentShape:
    """Solve for the shape of a cantilever under a tip force and an opposing tip moment; differentiable once.

    The solution is the one that is reached when both loads grow from 0 in proportion.

    Args:
        force: Force F at the tip, N, across the undeformed axis.
        moment: Moment M at the tip, N m.
        length: Length L of the cantilever, m.
        rigidity: Bending rigidity E I, N m^2.

    Returns:
        Tip and clamp of the bent cantilever. NaN if the cantilever buckles before the whole load, or if it bends within
        too short a part of its length to be resolved.
    """
    pull, turn = force * length**2 / rigidity, moment * length / rigidity
    solution = _continued_solution(*jax.lax.stop_gradient((pull, turn)))
    inverse, _ = _inverse_and_sign(jax.lax.stop_gradient(jax.jacfwd(_residual)(solution, pull, turn)))
    curvature = solution - inverse @ _residual(solution, pull, turn)
    theta = _INTEGRAL @ curvature
    x, y, shortening = (
        length * (_INTEGRAL @ f)[-1] for f in (jnp.cos(theta), jnp.sin(theta), 2.0 * jnp.sin(0.5 * theta) ** 2)
    )
    return BentShape(x, y, theta[-1], curvature[0] / length, shortening)


def _residual(curvature: jax.Array, pull: jax.Array, turn: jax.Array) -> jax.Array:
    """Residual of the moment balance at each point, in units of 1 / L."""
    x = _INTEGRAL @ jnp.cos(_INTEGRAL @ curvature)
    return curvature - (turn - pull * (x[-1] - x))


def _inverse_and_sign(matrix: jax.Array) -> tuple[jax.Array, jax.Array]:
    """Inverse of a small matrix, and the sign of its determinant, by elimination with row exchanges.

    LAPACK is avoided: two compiled programs that call it at the same time may block each other for ever.
    """
    size = len(matrix)

    def eliminate(k: jax.Array, state: tuple[jax.Array, jax.Array]) -> tuple[jax.Array, jax.Array]:
        """Eliminate column ``k`` of the rows, with the largest pivot."""
        rows, sign = state
        candidates = jnp.where(jnp.arange(size) >= k, jnp.abs(rows[:, k]), -1.0)
        best = jnp.argmax(candidates)
        pivot, other = rows[best], rows[k]
        rows = rows.at[best].set(other).at[k].set(pivot)
        sign = sign * jnp.sign(pivot[k]) * jnp.where(best == k, 1.0, -1.0)
        scaled = pivot / pivot[k]
        factors = rows[:, k].at[k].set(0.0)
        return (rows - jnp.outer(factors, scaled)).at[k].set(scaled), sign

    start = jnp.concatenate([matrix, jnp.eye(size)], axis=1), jnp.ones(())
    rows, sign = jax.lax.fori_loop(0, size, eliminate, start)
    return rows[:, size:], sign


def _continued_solution(pull: jax.Array, turn: jax.Array) -> jax.Array:
    """Curvature at the points under the whole load, by continuation from no load; NaN if that is not reached."""
    scale = 1.0 + jnp.abs(pull) + jnp.abs(turn)

    def residual(curvature: jax.Array, share: jax.Array) -> jax.Array:
        return _residual(curvature, share * pull, share * turn)

    def continues(state: tuple[jax.Array, ...]) -> jax.Array:
        share, _, step, count = state
        return (share < 1.0) & (step > _SMALLEST_STEP) & (count < _MAX_STEPS)

    def load_step(state: tuple[jax.Array, ...]) -> tuple[jax.Array, ...]:
        """Increase the share of the load, or shorten the step where the solution is not accepted."""
        share, curvature, step, count = state
        next_share = jnp.minimum(share + step, 1.0)
        inverse, _ = _inverse_and_sign(jax.jacfwd(residual)(curvature, share))
        predicted = curvature - (next_share - share) * inverse @ jax.jacfwd(residual, 1)(curvature, share)
        solution = jax.lax.fori_loop(
            0,
            _ITERATIONS,
            lambda _, c: c - _inverse_and_sign(jax.jacfwd(residual)(c, next_share))[0] @ residual(c, next_share),
            predicted,
        )
        # The determinant is positive without load; if its sign has changed, the cantilever has buckled.
        is_stable = _inverse_and_sign(jax.jacfwd(residual)(solution, next_share))[1] > 0.0
        is_solved = jnp.max(jnp.abs(residual(solution, next_share))) < _TOLERANCE * scale
        accepted = is_stable & is_solved & (jnp.max(jnp.abs(_INTEGRAL @ (solution - predicted))) < _MAX_CHANGE)
        return (
            jnp.where(accepted, next_share, share),
            jnp.where(accepted, solution, curvature),
            jnp.where(accepted, 2.0, 0.5) * step,
            count + 1,
        )

    start = (jnp.zeros(()), jnp.zeros(_POINTS), jnp.asarray(_FIRST_STEP), jnp.asarray(0))
    share, curvature, _, _ = jax.lax.while_loop(continues, load_step, start)
    coefficients = jnp.abs(_TO_COEFFICIENTS @ curvature)
    is_resolved = jnp.max(coefficients[-3:]) <= _RESOLVED * jnp.max(coefficients)
    return jnp.where((share >= 1.0) & is_resolved, curvature, jnp.nan)
