"""Motion along the curve of a Bouc-Wen model: the part of its evaluation that is optimised for speed.

While the input is monotonic, v = sgn(dx) w moves along one curve (see ``smajax.laws.bouc_wen``). The coordinate of the
curve is v for v < 0 and -log(1 - v) for v >= 0, where v approaches 1 asymptotically. There the path length rho |x| is
linear in the coordinate: a jump of the input is as exact as a small step, and |w| <= 1 holds by construction. Cubic
Hermite pieces give the path length at a coordinate and the coordinate at a path length. What this buys over integrating
the differential equation row by row: no steps within a row, and a tangent that costs one look-up a row (``_move_jvp``).
"""

from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.numerics.nonsmooth import clip, maximum

# The coordinate at which 1 - v is a rounding error: exp(-36) is 2e-16.
_END = 36.0
# Number of pieces below coordinate 0; chosen by trial, tests/unit/laws/test_hysteresis.py holds it (w within 1e-6).
_PIECES_BELOW = 112
# Number of pieces above coordinate 0; chosen by trial, the same test holds it.
_PIECES_ABOVE = 108
# Denser around 0, where |v|^n with n below 2 is least smooth, and at -1, where the curvature for a large n is largest.
_GRID_BELOW = -0.5 * (1.0 + np.cos(np.pi * np.arange(_PIECES_BELOW) / _PIECES_BELOW))
# Coordinates of the ends of the pieces.
CURVE_GRID = np.concatenate([_GRID_BELOW, _END * np.linspace(0.0, 1.0, _PIECES_ABOVE + 1) ** 3])


def level_at(coordinate: Float[Array, "..."]) -> Float[Array, "..."]:
    """Compute v at a coordinate of the curve: the coordinate itself below 0, 1 - exp(-coordinate) above.

    Args:
        coordinate: Coordinate of the curve.
    """
    return jnp.where(coordinate < 0.0, coordinate, -jnp.expm1(-maximum(coordinate, 0.0)))


def _coordinate_of(level: jax.Array) -> jax.Array:
    gap = maximum(1.0 - maximum(level, 0.0), np.exp(-_END))
    return jnp.where(level < 0.0, maximum(level, -1.0), -jnp.log(gap))


def hermite_pieces(knots: Any, values: Any, slopes: Float[Array, " knots"]) -> Float[Array, "pieces 6"]:
    """Compute the coefficients of cubic Hermite pieces between knots.

    Args:
        knots: Arguments at the knots, rising, shape ``(m,)``.
        values: Values at the knots, shape ``(m,)``.
        slopes: Derivatives at the knots, shape ``(m,)``.

    Returns:
        For each piece its first knot, width, first value, rise, and the slopes at both ends, shape ``(m - 1, 6)``.
    """
    knots, values = jnp.asarray(knots), jnp.asarray(values)
    return jnp.stack([knots[:-1], jnp.diff(knots), values[:-1], jnp.diff(values), slopes[:-1], slopes[1:]], axis=1)


def _piece_index(at: jax.Array, pieces: jax.Array) -> jax.Array:
    return jnp.sum(at >= pieces[1:, 0])


def _interpolate(at: jax.Array, piece: jax.Array) -> jax.Array:
    knot, width, value, rise, slope, next_slope = piece
    share = (at - knot) / width
    bend = (1.0 - share) * (slope * width - rise) - share * (next_slope * width - rise)
    return value + share * rise + share * (1.0 - share) * bend


def _path_length(
    w: jax.Array, sign: jax.Array, piece: jax.Array, rho: jax.Array, end: jax.Array, change: jax.Array
) -> jax.Array:
    """Path length of w along the curve after a change of the input, at most ``end``."""
    return clip(_interpolate(_coordinate_of(sign * w), piece) + rho * jnp.abs(change), 0.0, end)


def _new_w(w: jax.Array, sign: jax.Array, length: jax.Array, piece: jax.Array, change: jax.Array) -> jax.Array:
    coordinate = clip(_interpolate(length, piece), CURVE_GRID[0], CURVE_GRID[-1])
    return jnp.where(change == 0.0, w, sign * level_at(coordinate))


def _scan(
    first: jax.Array, curve: tuple[Any, ...], rho: jax.Array, end: jax.Array, changes: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """w after each of k changes of the input, shape ``(k,)``, and the indices of the pieces used, shape ``(k, 2)``."""

    def advance(w: jax.Array, change: jax.Array) -> tuple[jax.Array, tuple[jax.Array, jax.Array]]:
        sign = jnp.where(change < 0.0, -1.0, 1.0)
        start = _piece_index(_coordinate_of(sign * w), curve[0])
        length = _path_length(w, sign, curve[0][start], rho, end, change)
        stop = _piece_index(length, curve[1])
        w = _new_w(w, sign, length, curve[1][stop], change)
        return w, (w, jnp.stack([start, stop]))

    return jax.lax.scan(advance, first, changes)[1]


@jax.custom_jvp
def move_along_curve(
    first: Float[Array, ""],
    curve: tuple[Any, ...],
    rho: Float[Array, ""],
    end: Float[Array, ""],
    changes: Float[Array, " changes"],
) -> Float[Array, " changes"]:
    """Compute the hysteretic state w after each change of the input.

    Args:
        first: w before the first change.
        curve: Pieces (``hermite_pieces``) of the path length over the coordinate, and of the coordinate over the path
            length.
        rho: Path length per input.
        end: Path length of the whole curve.
        changes: Changes of the input, shape ``(k,)``.

    Returns:
        w after each change, shape ``(k,)``.
    """
    return _scan(first, curve, rho, end, changes)[0]


@move_along_curve.defjvp
def _move_jvp(primals: tuple[Any, ...], tangents: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
    """Tangent along the pieces that were used, which are selected for all steps at once.

    Selected within the loop, the tangent of each step would cost a sum over all pieces, or a scattered sum in reverse
    mode; the latter is wrong if XLA compiles the loop around it as one function.
    """
    rows = _scan(*primals)[1]

    def repeat(
        first: jax.Array, curve: tuple[Any, ...], rho: jax.Array, end: jax.Array, changes: jax.Array
    ) -> jax.Array:
        def advance(w: jax.Array, step: tuple[Any, ...]) -> tuple[jax.Array, jax.Array]:
            change, start, stop = step
            sign = jnp.where(change < 0.0, -1.0, 1.0)
            w = _new_w(w, sign, _path_length(w, sign, start, rho, end, change), stop, change)
            return w, w

        return jax.lax.scan(advance, first, (changes, curve[0][rows[:, 0]], curve[1][rows[:, 1]]))[1]

    return jax.jvp(repeat, primals, tangents)
