"""Bounded Levenberg-Marquardt as an optimistix least-squares solver.

Each step solves the normal equations, damped in proportion to their diagonal, for the parameters that are free to move:

    (J' J + lambda diag(J' J)) d = -J' r

A parameter at a bound beyond which the cost falls stays there; the rest of the step is cut to the bounds. Residual and
Jacobian are evaluated together at the trial point, because with forward tangents the pair costs less than two
residuals. A trial that does not lower the cost raises the damping, by more for each rejected trial in a row. A
parameter whose two bounds are equal is fixed, so that profiles and nested models need no new compiled program.

The solver runs under ``optimistix.least_squares``; ``smajax.fitting.multi_start`` drives it step by step from several
starts.

With ``secant_updates`` the Jacobian is updated from the residuals of accepted trials while it predicts well (Broyden's
rank-one update), and computed again where it does not, after several updates, and before a search ends.

Source: marquardt1963 (scaled damping), nielsen1999 (reduction of the damping by the gain ratio), broyden1965 (updates).
"""

import enum
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import optimistix as optx
from jax.flatten_util import ravel_pytree
from jaxtyping import Array, Float

# All damping constants were chosen by trial on fits of rigs; tests/unit/fitting/test_fit.py holds the ends of the
# search.
_INITIAL_DAMPING = 1e-3
# Least factor by which an accepted trial reduces the damping (nielsen1999 has 1/3).
_MIN_REDUCTION = 0.1
# A rejected trial multiplies the damping by this.
_REJECTION_FACTOR = 5.0
# A rejected trial also multiplies it by this, once for each rejection in a row before it.
_REPEATED_REJECTION_FACTOR = 3.0
# Least damping, so that it can be raised again.
_MIN_DAMPING = 1e-12
# Beyond this damping a step is below rounding and the search has stalled.
_MAX_DAMPING = 1e12
# Least diagonal as a share of the largest, so that a parameter without effect leaves the matrix regular.
_MIN_DIAGONAL = 1e-12
# Keeps the matrix regular where no parameter has an effect.
_TINY = 1e-300
# This number of small decreases of the cost in a row ends the search.
_SMALL_DECREASES = 2
# A predicted decrease below this share of the relative tolerance ends it at once.
_PREDICTED_SHARE = 1e-2
# Largest number of updates of a Jacobian before it is computed again, and least share of the predicted decrease that an
# accepted trial reaches for an update. Chosen by trial on fits of cells and grains.
_MOST_UPDATES = 4
_LEAST_GAIN = 0.3


class SolverStatus(enum.IntEnum):
    """Why a search from one start ended; ``text`` says it in words."""

    running = 0
    converged = 1
    stalled = 2
    failed = 3
    steps = 4
    interrupted = 5
    diverged = 6
    not_stationary = 7

    @property
    def text(self) -> str:
        """The reason in words, for messages and reports."""
        return {
            SolverStatus.running: "still running",
            SolverStatus.converged: "the cost falls by less than its tolerance",
            SolverStatus.stalled: "no step lowers the cost any more",
            SolverStatus.failed: "the simulation fails at the start point: see its result code",
            SolverStatus.steps: "the number of steps ran out before the cost settled: allow more, or start nearer",
            SolverStatus.interrupted: "interrupted; the best point so far is kept",
            SolverStatus.diverged: "the solver ended far above its best point, which is kept and is no minimum: start "
            "nearer, or give a solver with damping or a trust region",
            SolverStatus.not_stationary: "the solver ended at a point where the cost still falls along its gradient, "
            "which is no minimum: start nearer, give it smaller tolerances, or leave solver out",
        }[self]


class LMState(NamedTuple):
    """State of one search.

    Attributes:
        trial: Trial point (p,), flat.
        residual: Residual at the best point (m,).
        jacobian: Jacobian there (m, p).
        cost: Sum of squares there.
        damping: Damping lambda.
        predicted: Decrease of the cost that the linear model predicts for the trial.
        small_decreases: Number of small decreases in a row.
        rejections: Number of rejected trials in a row.
        updates: Number of updates since the Jacobian was computed.
        refresh: Whether the trial point is the best point again, to compute the Jacobian there.
        steps: Number of steps so far.
        status: Value of ``SolverStatus``.
        aux: Auxiliary output of the function at the best point.
    """

    trial: jax.Array
    residual: jax.Array
    jacobian: jax.Array
    cost: jax.Array
    damping: jax.Array
    predicted: jax.Array
    small_decreases: jax.Array
    rejections: jax.Array
    updates: jax.Array
    refresh: jax.Array
    steps: jax.Array
    status: jax.Array
    aux: Any


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver[Any, Any, Any, Any]):
    """Levenberg-Marquardt within bounds, as an optimistix least-squares solver.

        solver = BoundedLevenbergMarquardt(rtol=1e-9, lower=0.0, upper=jnp.array([1.0, 2.0]))
        solution = optimistix.least_squares(residual, solver, y0, args)

    A start outside the bounds is moved to them. A derivative of the solution by optimistix's ``ImplicitAdjoint`` holds
    only where no entry of the solution is at a bound.

    Attributes:
        rtol: Relative decrease of the cost; two smaller ones in a row end the search.
        lower: Lower bounds: one number, or a pytree of the unknown's structure.
        upper: Upper bounds likewise. Entries whose bounds are equal are fixed.
        atol: Not used; part of the optimistix interface.
        lazy_jacobian: Evaluate the Jacobian after the residual, and only at trials that are accepted. This is faster
            where the Jacobian costs several residuals, but not in a batch.
        secant_updates: Update the Jacobian instead of computing it at each accepted trial; needs ``lazy_jacobian``.
        norm: Not used; part of the optimistix interface.
    """

    rtol: Any = 1e-7  # under a compiled step a scalar array: with a Python number each value is compiled anew
    lower: Any = -jnp.inf
    upper: Any = jnp.inf
    atol: float = 0.0
    lazy_jacobian: bool = eqx.field(static=True, default=False)
    secant_updates: bool = eqx.field(static=True, default=False)
    norm: Callable[..., Any] = eqx.field(static=True, default=optx.max_norm)

    def init(
        self, fn: Callable[..., Any], y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any
    ) -> LMState:
        """Return a state in which nothing is evaluated yet; the first step evaluates and accepts the start point."""
        # Types are spelt out: a weakly typed start would compile the step twice.
        size, real, whole = sum(leaf.size for leaf in jax.tree.leaves(f_struct)), jnp.float64, jnp.int64
        lower, upper = self._bounds(y)
        start = jnp.clip(ravel_pytree(y)[0], lower, upper)
        return LMState(
            trial=start,
            residual=jnp.zeros(size, real),
            jacobian=jnp.zeros((size, start.shape[0]), real),
            cost=jnp.asarray(jnp.inf, real),
            damping=jnp.asarray(_INITIAL_DAMPING, real),
            predicted=jnp.zeros((), real),
            small_decreases=jnp.zeros((), whole),
            rejections=jnp.zeros((), whole),
            updates=jnp.zeros((), whole),
            refresh=jnp.zeros((), bool),
            steps=jnp.zeros((), whole),
            status=jnp.asarray(SolverStatus.running.value, whole),
            aux=jax.tree.map(lambda leaf: jnp.zeros(leaf.shape, leaf.dtype), aux_struct),
        )

    def step(
        self, fn: Callable[..., Any], y: Any, args: Any, options: Any, state: LMState, tags: Any
    ) -> tuple[Any, LMState, Any]:
        """Evaluate the trial point, accept or reject it, and propose the next one.

        Args:
            fn: Function of ``y`` and ``args`` that returns the residual and an auxiliary output.
            y: Best point so far.
            args: The arguments of ``fn``.
            options: Not used.
            state: State of the search.
            tags: Not used.

        Returns:
            The best point, the state, and the auxiliary output there.
        """
        (lower, upper), (point, unravel) = self._bounds(y), ravel_pytree(y)
        residual, jacobian, cost, aux, updates = self._evaluate(lambda v: fn(unravel(v), args), point, state)
        finite = jnp.isfinite(cost) & jnp.all(jnp.isfinite(jacobian))
        accept = finite & ((cost < state.cost) | state.refresh)
        first = state.steps == 0
        decrease = state.cost - cost
        # A trial that fails with an updated Jacobian says nothing about the damping.
        stale = ~accept & (state.updates > 0)
        damping = jnp.where(stale | state.refresh, state.damping, _next_damping(state, decrease, accept, first))
        small = accept & (decrease <= self.rtol * state.cost) & ~first & ~state.refresh
        moved = accept & ~state.refresh
        small_decreases = jnp.where(small, state.small_decreases + 1, jnp.where(moved, 0, state.small_decreases))
        point = jnp.where(accept, state.trial, point)
        residual = jnp.where(accept, residual, state.residual)
        jacobian = jnp.where(accept, jacobian, state.jacobian)
        cost = jnp.where(accept, cost, state.cost)
        updates = jnp.where(accept, updates, state.updates)
        aux = jax.tree.map(lambda new, old: jnp.where(accept, new, old), aux, state.aux)
        trial, predicted = _propose(point, residual, jacobian, damping, lower, upper)
        still = (predicted >= 0) & (predicted <= self.rtol * _PREDICTED_SHARE * cost)
        converged = (small_decreases >= _SMALL_DECREASES) | (still & ~first) | (first & (predicted == 0))
        refresh = stale | (converged & (updates > 0))
        status = jnp.select(
            [first & ~finite, converged & ~refresh, damping > _MAX_DAMPING],
            [SolverStatus.failed.value, SolverStatus.converged.value, SolverStatus.stalled.value],
            SolverStatus.running.value,
        ).astype(jnp.int64)
        state = LMState(
            trial=jnp.where(refresh, point, trial),
            residual=residual,
            jacobian=jacobian,
            cost=cost,
            damping=jnp.maximum(damping, _MIN_DAMPING),
            predicted=predicted,
            small_decreases=jnp.where(refresh, jnp.minimum(small_decreases, _SMALL_DECREASES - 1), small_decreases),
            rejections=jnp.where(accept | stale, 0, state.rejections + 1),
            updates=updates,
            refresh=refresh,
            steps=state.steps + 1,
            status=status,
            aux=aux,
        )
        return unravel(point), state, aux

    def _bounds(self, y: Any) -> tuple[Float[Array, " p"], Float[Array, " p"]]:
        """Lower and upper bounds of the flat unknown."""

        def flat(bound: Any) -> jax.Array:
            if jax.tree.structure(bound) != jax.tree.structure(y):
                bound = jax.tree.map(lambda _: bound, y)
            return ravel_pytree(jax.tree.map(lambda leaf, b: jnp.broadcast_to(b, jnp.shape(leaf)), y, bound))[0]

        return flat(self.lower), flat(self.upper)

    def _evaluate(
        self, fn: Callable[..., Any], point: jax.Array, state: LMState
    ) -> tuple[jax.Array, jax.Array, jax.Array, Any, jax.Array]:
        """Residual, Jacobian, cost and auxiliary output at the trial point, and the number of the Jacobian's updates.

        Args:
            fn: The function of the flat unknown.
            point: The best point.
            state: State of the search.
        """

        def with_value(v: jax.Array) -> tuple[jax.Array, tuple[jax.Array, Any]]:
            output, aux = fn(v)
            r = ravel_pytree(output)[0]
            return r, (r, aux)

        derivative = jax.jacfwd(with_value, has_aux=True)
        if not self.lazy_jacobian:
            jacobian, (residual, aux) = derivative(state.trial)
            return residual, jacobian, jnp.sum(residual**2), aux, state.updates
        residual, (_, aux) = with_value(state.trial)
        cost = jnp.sum(residual**2)
        if not self.secant_updates:
            jacobian = jax.lax.cond(
                cost < state.cost, lambda v: derivative(v)[0], lambda _: state.jacobian, state.trial
            )
            return residual, jacobian, cost, aux, state.updates
        predicts = state.cost - cost >= _LEAST_GAIN * state.predicted
        is_update = predicts & (state.updates < _MOST_UPDATES) & (state.steps > 0) & ~state.refresh
        needed = state.refresh | ((cost < state.cost) & ~is_update)
        updated = _broyden_update(state.jacobian, state.trial - point, residual - state.residual)
        jacobian = jax.lax.cond(needed, lambda v: derivative(v)[0], lambda _: updated, state.trial)
        return residual, jacobian, cost, aux, jnp.where(needed, 0, state.updates + 1)

    def terminate(
        self, fn: Callable[..., Any], y: Any, args: Any, options: Any, state: LMState, tags: Any
    ) -> tuple[Any, ...]:
        """Return whether the search has ended, and optimistix's result code."""
        done = (state.status == SolverStatus.converged) | (state.status == SolverStatus.stalled)
        failed = state.status == SolverStatus.failed
        result = optx.RESULTS.where(failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return done | failed, result

    def postprocess(
        self, fn: Callable[..., Any], y: Any, aux: Any, args: Any, options: Any, state: LMState, tags: Any, result: Any
    ) -> tuple[Any, ...]:
        """Return the solution as it is."""
        return y, aux, {}


def predicted_decrease(
    y: Float[Array, " p"],
    residual: Float[Array, " m"],
    jacobian: Float[Array, "m p"],
    lower: Float[Array, " p"],
    upper: Float[Array, " p"],
) -> tuple[Float[Array, ""], Float[Array, ""]]:
    """Return the decrease of the cost that the linear model predicts within the bounds, and the largest step to it.

    Both are 0 where the gradient, projected on the bounds, is 0.

    Args:
        y: The point.
        residual: Residual there.
        jacobian: Jacobian there.
        lower: Lower bounds.
        upper: Upper bounds.
    """
    trial, predicted = _propose(y, residual, jacobian, jnp.asarray(_INITIAL_DAMPING), lower, upper)
    return predicted, jnp.max(jnp.abs(trial - y), initial=0.0)


def _broyden_update(
    jacobian: Float[Array, "m p"], change: Float[Array, " p"], difference: Float[Array, " m"]
) -> Float[Array, "m p"]:
    """The Jacobian nearest to the given one that explains the difference of two residuals. Source: broyden1965.

    Args:
        jacobian: Jacobian at the first point.
        change: Second point minus the first.
        difference: Residual at the second point minus that at the first.
    """
    square = change @ change
    missing = difference - jacobian @ change
    return jacobian + jnp.outer(missing, change / jnp.where(square > 0, square, 1.0))


def _next_damping(state: LMState, decrease: jax.Array, accept: jax.Array, first: jax.Array) -> jax.Array:
    """Damping after a trial: reduced by the gain ratio if it was accepted, raised if not."""
    gain = decrease / jnp.where(state.predicted > 0, state.predicted, 1.0)
    reduced = state.damping * jnp.clip(1.0 - (2.0 * gain - 1.0) ** 3, _MIN_REDUCTION, 1.0)
    raised = _REJECTION_FACTOR * _REPEATED_REJECTION_FACTOR**state.rejections * state.damping
    return jnp.where(first, state.damping, jnp.where(accept, reduced, raised))


def _propose(
    y: Float[Array, " p"],
    residual: Float[Array, " m"],
    jacobian: Float[Array, "m p"],
    damping: Float[Array, ""],
    lower: Float[Array, " p"],
    upper: Float[Array, " p"],
) -> tuple[Float[Array, " p"], Float[Array, ""]]:
    """Next trial point within the bounds, and the decrease of the cost that the linear model predicts for it."""
    gradient = jacobian.T @ residual
    normal = jacobian.T @ jacobian
    fixed = ((y <= lower) & (gradient > 0)) | ((y >= upper) & (gradient < 0)) | (lower >= upper)

    diagonal = jnp.diag(normal)
    damped = normal + damping * jnp.diag(jnp.maximum(diagonal, _MIN_DIAGONAL * jnp.max(diagonal) + _TINY))

    def solve(right: jax.Array, fixed: jax.Array) -> jax.Array:
        matrix = jnp.where(fixed[:, None] | fixed[None, :], jnp.eye(y.shape[0]), damped)
        return jnp.where(fixed, 0.0, jnp.linalg.solve(matrix, jnp.where(fixed, 0.0, right)))

    # Parameters whose step leaves the bounds go to their bound; then the step of the others is solved for again.
    change = solve(-gradient, fixed)
    leaving = ~fixed & ((y + change < lower) | (y + change > upper))
    cut = jnp.where(leaving, jnp.clip(y + change, lower, upper) - y, 0.0)
    change = jnp.clip(y + cut + solve(-gradient - normal @ cut, fixed | leaving), lower, upper) - y
    predicted = -(2.0 * gradient @ change + change @ normal @ change)
    return y + change, predicted
