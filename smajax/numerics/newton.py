"""Newton's method for the equations of one time step, with few unknowns. The searches are not differentiable.

The first ``wires`` unknowns are temperatures in K, the others stresses in Pa; the residual has the same units. Each
search returns the solution and whether it failed. Residuals have nonsmooth points: where a transformation starts or
ends, and where friction reverses.
"""

from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
from jaxtyping import Array, Bool, Float

from smajax.numerics.dense import solve_dense

# Chosen by trial, many times the number that a usual step needs; tests/unit/simulation/test_simulation.py holds it.
_MAX_ITERATIONS = 72
# K. A last Newton step follows the loop, so the loop may end when the error of that step, quadratic in the tolerance,
# is below the rounding of any recording.
_TEMPERATURE_TOLERANCE = 1e-3
# Pa, for the same reason.
_STRESS_TOLERANCE = 1e3
# Shortest fraction of Newton's step: it reaches the other side of a nonsmooth point and is always accepted. Chosen by
# trial.
_SHORTEST_FRACTION = 0.05
# Smallest relative decrease of the residual, per full step, that counts as a decrease: Armijo's condition (armijo1966)
# with the usual constant.
_SUFFICIENT_DECREASE = 1e-4
# Iterations after which natural monotonicity is switched on or off. Chosen by trial, so that no search cycles.
_TURN = 12
# Share by which the next step has to be shorter, per fraction of a step taken: the restricted test of deuflhard2004,
# section 3.3.
_SHORTENING = 0.25
# Factor on the tolerances with dry friction, where the last step must not cross a nonsmooth point. Chosen by trial.
_FRICTION_TOLERANCE = 0.01
# Factor on ``_MAX_ITERATIONS`` with dry friction, where steps are halved more often. Chosen by trial.
_FRICTION_ITERATIONS = 3
# Smallest relative decrease of the residual of the other equations, per full step, with dry friction: large enough that
# the search does not oscillate across a nonsmooth point. Chosen by trial.
_FRICTION_DECREASE = 0.1

Residual = Callable[[jax.Array], jax.Array]
Solution = tuple[Float[Array, " unknowns"], Bool[Array, ""]]


def single_step(residual: Residual, guess: Float[Array, " unknowns"], wires: int) -> Solution:
    """Take one Newton step, for equations that are nearly linear.

    Args:
        residual: Function from the unknowns to the residual, both of shape ``(unknowns,)``.
        guess: Unknowns at the start.
        wires: Number of temperatures among the unknowns.

    Returns:
        The unknowns after the step, and whether they are not finite.
    """
    change = newton_step(residual, guess)[2]
    return guess + change, ~jnp.all(jnp.isfinite(change))


def solve(residual: Residual, guess: Float[Array, " unknowns"], wires: int) -> Solution:
    """Solve by Newton's method with step halving.

    A step is accepted in three cases:

    - It decreases the residual (Armijo's condition).
    - Natural monotonicity holds: with the Jacobian at its start, the next step would be shorter. Near a nonsmooth point
      there may be no step along Newton's direction that decreases the residual.
    - It is a short fraction of Newton's step. At a nonsmooth point, such as the state at rest, the Jacobian may be that
      of the wrong side; a short step reaches the other side.

    Natural monotonicity alone may cycle over the two nonsmooth points of a narrow transformation: it is switched off
    for every second ``_TURN`` iterations.

    Source: armijo1966; deuflhard2004, section 3.3.

    Args:
        residual: Function from the unknowns to the residual, both of shape ``(unknowns,)``.
        guess: Unknowns at the start.
        wires: Number of temperatures among the unknowns.

    Returns:
        The solution, and whether the search failed.
    """
    scale = _tolerances(guess, wires)

    def unsolved(carry: tuple[Any, ...]) -> jax.Array:
        _, _, change, _, _, count = carry
        return (count == 0) | ((_norm(change, scale) > 1.0) & (count < _MAX_ITERATIONS))

    def iterate(carry: tuple[Any, ...]) -> tuple[Any, ...]:
        """Try the damped Newton step, and shorten it if it is not accepted."""
        z, error, change, jacobian, fraction, count = carry
        trial = z + fraction * change
        value, trial_jacobian, trial_change = newton_step(residual, trial)
        trial_error = _norm(value, scale)
        shorter = _norm(solve_dense(jacobian, value), scale) <= (1.0 - _SHORTENING * fraction) * _norm(change, scale)
        # Within the tolerances, rounding may raise the residual.
        falls = trial_error <= jnp.maximum(1.0, (1.0 - _SUFFICIENT_DECREASE * fraction) * error)
        accepted = (shorter & _natural_turn(count)) | falls | (fraction < _SHORTEST_FRACTION)
        next_point = (trial, trial_error, trial_change, trial_jacobian, jnp.asarray(1.0))
        same_point = (z, error, change, jacobian, 0.5 * fraction)
        return (*jax.tree.map(lambda a, b: jnp.where(accepted, a, b), next_point, same_point), count + 1)

    size = guess.shape[0]
    start = (guess, jnp.asarray(jnp.inf), jnp.zeros(size), jnp.eye(size), jnp.asarray(1.0), 0)
    z, _, change, _, _, count = jax.lax.while_loop(unsolved, iterate, start)
    return z + change, (count >= _MAX_ITERATIONS) | ~jnp.all(jnp.isfinite(change))


class _FrictionSearch(NamedTuple):
    """One iterate of ``solve_with_friction``."""

    z: jax.Array
    error: jax.Array  # of all equations but the last one while these are not solved, else infinite
    change: jax.Array
    jacobian: jax.Array
    waiting: jax.Array  # whether the search continues although the change is short
    count: Any
    fraction: jax.Array
    low: jax.Array  # bracket of the last unknown
    high: jax.Array


def solve_with_friction(residual: Residual, guess: Float[Array, " unknowns"], wires: int) -> Solution:
    """Solve equations with dry friction: Newton's method with a bracket of the last unknown.

    The last unknown is a drag, or a stress that a drag opposes. Its equation increases with it, but changes from flat
    (sliding) to steep (sticking) and back, so that Newton's steps oscillate. Therefore it is bracketed between the
    largest value that was too small and the smallest value that was too large. A Newton step that would leave the
    bracket is replaced by bisection.

    Args:
        residual: Function from the unknowns to the residual, both of shape ``(unknowns,)``.
        guess: Unknowns at the start.
        wires: Number of temperatures among the unknowns.

    Returns:
        The solution, and whether the search failed.
    """
    size, max_iterations = guess.shape[0], _FRICTION_ITERATIONS * _MAX_ITERATIONS
    scale = _FRICTION_TOLERANCE * _tolerances(guess, wires)

    def unsolved(search: _FrictionSearch) -> jax.Array:
        going = (_norm(search.change, scale) > 1.0) | search.waiting
        return (search.count == 0) | (going & (search.count < max_iterations))

    start = _FrictionSearch(
        guess,
        jnp.asarray(jnp.inf),
        jnp.zeros(size),
        jnp.eye(size),
        jnp.asarray(False),
        0,
        jnp.asarray(1.0),
        jnp.asarray(-jnp.inf),
        jnp.asarray(jnp.inf),
    )
    end = jax.lax.while_loop(unsolved, lambda search: _iterate_with_friction(residual, search, scale), start)
    return end.z + end.change, (end.count >= max_iterations) | ~jnp.all(jnp.isfinite(end.change))


def _iterate_with_friction(residual: Residual, search: _FrictionSearch, scale: jax.Array) -> _FrictionSearch:
    """One iteration of ``solve_with_friction``: bracket, step, acceptance."""
    last = jnp.arange(scale.shape[0]) == scale.shape[0] - 1
    trial = search.z + search.fraction * search.change
    value, jacobian, change = newton_step(residual, trial)
    # The sign of the last equation shows the side of the solution only if the other equations hold; otherwise those are
    # solved first.
    others = _norm(value[:-1], scale[:-1])
    settled = others <= 1.0 / _FRICTION_TOLERANCE
    low = jnp.where(settled & (value[-1] <= 0.0), trial[-1], search.low)
    high = jnp.where(settled & (value[-1] >= 0.0), trial[-1], search.high)
    # Bisection if Newton's step would leave the bracket; while the others are not settled, the last unknown is fixed.
    bisection = 0.5 * (low + high) - trial[-1]
    outside = (trial[-1] + change[-1] <= low) | (trial[-1] + change[-1] >= high)
    outside &= jnp.isfinite(bisection)
    last_change = jnp.where(settled, bisection, 0.0)
    fixed_last = jnp.where(last[:, None], last[None, :] * 1.0, jacobian)
    fixed_change = -solve_dense(fixed_last, jnp.where(last, -last_change, value))
    change = jnp.where(outside | ~settled, fixed_change, change)
    # A bisected step may be short without a solution nearby.
    waiting = (outside & (high - low > scale[-1])) | ~settled
    # While the last unknown is fixed, the residual of the others has to decrease from step to step, or the steps have
    # to become shorter.
    next_length = _norm(solve_dense(search.jacobian, jnp.where(last, 0.0, value)), scale)
    shorter = next_length <= (1.0 - _SHORTENING * search.fraction) * _norm(search.change, scale)
    falls = others <= (1.0 - _FRICTION_DECREASE * search.fraction) * search.error
    accepted = settled | (shorter & _natural_turn(search.count)) | falls | (search.fraction < _SHORTEST_FRACTION)
    return _FrictionSearch(
        jnp.where(accepted, trial, search.z),
        jnp.where(accepted, jnp.where(settled, jnp.inf, others), search.error),
        jnp.where(accepted, change, search.change),
        jnp.where(accepted, fixed_last, search.jacobian),
        jnp.where(accepted, waiting, search.waiting),
        search.count + 1,
        jnp.where(accepted, 1.0, 0.5 * search.fraction),
        low,
        high,
    )


def _natural_turn(count: jax.Array) -> jax.Array:
    """Whether natural monotonicity counts in an iteration: in every second turn of ``_TURN`` iterations."""
    return jax.lax.rem(count, 2 * _TURN) < _TURN


def newton_step(
    residual: Residual, z: Float[Array, " unknowns"]
) -> tuple[Float[Array, " unknowns"], Float[Array, "unknowns unknowns"], Float[Array, " unknowns"]]:
    """Compute residual and Jacobian at ``z``, and Newton's step from there.

    Args:
        residual: Function from the unknowns to the residual, both of shape ``(unknowns,)``.
        z: The unknowns.
    """
    value, jacobian_product = jax.linearize(residual, z)
    jacobian: Any = jax.vmap(jacobian_product, out_axes=-1)(jnp.eye(z.shape[0]))
    return value, jacobian, -solve_dense(jacobian, value)


def polish(residual: Residual, z: Float[Array, " unknowns"], steps: int) -> Float[Array, " unknowns"]:
    """Take Newton steps, which are differentiable: from a root, k of them make derivatives up to order 2^k - 1 exact.

    Args:
        residual: Function from the unknowns to the residual, both of shape ``(unknowns,)``.
        z: Unknowns near a root.
        steps: Number of steps.
    """

    def advance(z: jax.Array, _: Any) -> tuple[jax.Array, None]:
        return z + newton_step(residual, z)[2], None

    return jax.lax.scan(advance, z, None, length=steps)[0]


def _tolerances(guess: jax.Array, wires: int) -> jax.Array:
    """The tolerance of each unknown and its equation, in K or Pa."""
    return jnp.where(jnp.arange(guess.shape[0]) < wires, _TEMPERATURE_TOLERANCE, _STRESS_TOLERANCE)


def _norm(value: jax.Array, scale: jax.Array) -> jax.Array:
    """The largest entry in multiples of its tolerance."""
    return jnp.max(jnp.abs(value) / scale)
