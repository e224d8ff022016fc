"""The end of a step: its balances solved by Newton's method with a Jacobian of at most five columns. Not differentiable.

The first unknowns are the wires' temperatures in K, the rest stresses in Pa; the balances are in the same units. Each search gives the end
and whether it failed. Balances have kinks, where a transformation begins or ends and where friction turns around.
"""

from collections.abc import Callable
from typing import Any

import jax
import jax.numpy as jnp

_ITERATIONS = 72
# A last Newton step follows the loop, so the loop may stop where that step's error, quadratic in these, is below rounding of any recording.
_TEMPERATURE_TOLERANCE = 1e-3
_STRESS_TOLERANCE = 1e3
_SHORT = 0.05  # of Newton's step: as short a one shows the other side of a kink
_LESS = 1e-4  # of what is left: as much elsewhere, such as on the other side of a kink, is no gain (Armijo's condition)
_TURN = 12  # iterations
_FRICTION = 0.01  # times the tolerances, where there is dry friction

Residual = Callable[[jax.Array], jax.Array]
Found = tuple[jax.Array, jax.Array]


def once(residual: Residual, guess: jax.Array, wires: int) -> Found:
    """One Newton step."""
    change = _newton(residual, guess)[2]
    return guess + change, ~jnp.all(jnp.isfinite(change))


def solve(residual: Residual, guess: jax.Array, wires: int) -> Found:
    """Newton's method with halving.

    A step is taken if it lessens what is left of the balances or, since near a kink no step along Newton's direction may do so, if what it
    leaves asks for a shorter step by the Jacobian at its start (natural monotonicity: Deuflhard 2004, section 3.3). From a kink itself,
    such as rest, where the Jacobian may be that of the wrong side, even a short step does neither, and is taken to see the other side.
    Steps that ask for ever shorter ones may still go round in a circle, over the two kinks of a narrow transformation: every other turn of
    ``_TURN`` iterations only the balances count.
    """
    scale = _scale(guess, wires)

    def unsolved(carry: tuple) -> jax.Array:
        _, _, change, _, _, count = carry
        return (count == 0) | ((_norm(change, scale) > 1.0) & (count < _ITERATIONS))

    def iterate(carry: tuple) -> tuple:
        z, error, change, slope, fraction, count = carry
        trial = z + fraction * change
        value, later, new = _newton(residual, trial)
        left, shorter = _norm(value, scale), _norm(linear(slope, value), scale) <= (1.0 - 0.25 * fraction) * _norm(change, scale)
        falls = left <= jnp.maximum(1.0, (1.0 - _LESS * fraction) * error)  # within the tolerances, rounding may raise it
        better = (shorter & _loose(count)) | falls | (fraction < _SHORT)
        taken = (trial, left, new, later, jnp.asarray(1.0))
        kept = (z, error, change, slope, 0.5 * fraction)
        return (*jax.tree.map(lambda a, b: jnp.where(better, a, b), taken, kept), count + 1)

    size = guess.shape[0]
    start = (guess, jnp.asarray(jnp.inf), jnp.zeros(size), jnp.eye(size), jnp.asarray(1.0), 0)
    z, _, change, _, _, count = jax.lax.while_loop(unsolved, iterate, start)
    return z + change, (count >= _ITERATIONS) | ~jnp.all(jnp.isfinite(change))


def solve_with_friction(residual: Residual, guess: jax.Array, wires: int) -> Found:
    """The same where there is dry friction: the last unknown is a drag, or a stress against which it works.

    Its equation increases with it, but from flat (sliding) to steep (sticking) and back, so that Newton's steps go to and fro: it is kept
    between the largest value known to be too small and the smallest known to be too large.
    """
    size, most = guess.shape[0], 3 * _ITERATIONS
    scale = _FRICTION * _scale(guess, wires)

    def unsolved(carry: tuple) -> jax.Array:
        _, _, change, _, open_, count, *_ = carry
        return (count == 0) | (((_norm(change, scale) > 1.0) | open_) & (count < most))

    def iterate(carry: tuple) -> tuple:
        z, error, change, first, open_, count, fraction, (low, high) = carry
        trial = z + fraction * change
        value, slope, new = _newton(residual, trial)
        # What the last equation leaves says on which side the answer lies only where the others hold: else they come first.
        others = _norm(value[:-1], scale[:-1])
        settled = others <= 1.0 / _FRICTION
        low = jnp.where(settled & (value[-1] <= 0.0), trial[-1], low)
        high = jnp.where(settled & (value[-1] >= 0.0), trial[-1], high)
        halved = 0.5 * (low + high) - trial[-1]
        outside = (trial[-1] + new[-1] <= low) | (trial[-1] + new[-1] >= high)
        outside &= jnp.isfinite(halved)
        last, along = jnp.arange(size) == size - 1, jnp.where(settled, halved, 0.0)
        alone = jnp.where(last[:, None], last[None, :] * 1.0, slope)
        held = -linear(alone, jnp.where(last, -along, value))
        new = jnp.where(outside | ~settled, held, new)
        # A halved step may be short without an answer near.
        waiting = (outside & (high - low > scale[-1])) | ~settled
        # Only while the last one stands still do the others have to leave less from step to step, or to ask for shorter ones: so much
        # less that they do not go to and fro over a kink.
        asked = _norm(linear(first, jnp.where(last, 0.0, value)), scale) <= (1.0 - 0.25 * fraction) * _norm(change, scale)
        better = settled | (asked & _loose(count)) | (others <= (1.0 - 0.1 * fraction) * error) | (fraction < _SHORT)
        left = jnp.where(settled, jnp.inf, others)
        return (
            jnp.where(better, trial, z),
            jnp.where(better, left, error),
            jnp.where(better, new, change),
            jnp.where(better, alone, first),
            jnp.where(better, waiting, open_),
            count + 1,
            jnp.where(better, 1.0, 0.5 * fraction),
            (low, high),
        )

    ends = (jnp.asarray(-jnp.inf), jnp.asarray(jnp.inf))
    start = (guess, jnp.asarray(jnp.inf), jnp.zeros(size), jnp.eye(size), jnp.asarray(False), 0, jnp.asarray(1.0), ends)
    z, _, change, _, _, count, *_ = jax.lax.while_loop(unsolved, iterate, start)
    return z + change, (count >= most) | ~jnp.all(jnp.isfinite(change))


def _loose(count: jax.Array) -> jax.Array:
    """Whether a step may be judged by what it asks for next: in every other turn."""
    return jax.lax.rem(count, 2 * _TURN) < _TURN


def _newton(residual: Residual, z: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Value and Jacobian at ``z``, and the step that they ask for."""
    value, push = jax.linearize(residual, z)
    slope: Any = jax.vmap(push, out_axes=-1)(jnp.eye(z.shape[0]))
    return value, slope, -linear(slope, value)


def _scale(guess: jax.Array, wires: int) -> jax.Array:
    return jnp.where(jnp.arange(guess.shape[0]) < wires, _TEMPERATURE_TOLERANCE, _STRESS_TOLERANCE)


def _norm(value: jax.Array, scale: jax.Array) -> jax.Array:
    return jnp.max(jnp.abs(value) / scale)


def linear(matrix: jax.Array, right: jax.Array) -> jax.Array:
    """Solves a system of up to five equations by elimination without pivoting, which its positive diagonal allows."""
    size = right.shape[0]
    rows = [[matrix[i, j] for j in range(size)] + [right[i]] for i in range(size)]
    for k in range(size):
        for i in range(k + 1, size):
            factor = rows[i][k] / rows[k][k]
            rows[i] = [a - factor * b for a, b in zip(rows[i], rows[k], strict=True)]
    answer = [right[0]] * size
    for i in reversed(range(size)):
        answer[i] = (rows[i][size] - sum(rows[i][j] * answer[j] for j in range(i + 1, size))) / rows[i][i]
    return jnp.stack(answer)
