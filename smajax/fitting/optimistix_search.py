"""Least-squares searches from several starts by any optimistix solver, step by step.

Bounds are met by a transformation to unbounded unknowns (``bound_transformation``). The best point so far is kept,
since not every solver lowers the cost in each step.
"""

import time
from collections.abc import Callable
from typing import Any

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx

from smajax.fitting.bound_transformation import BoundTransformation
from smajax.fitting.levenberg_marquardt import SolverStatus, predicted_decrease
from smajax.fitting.multi_start import MultiStartResult, linearise
from smajax.numerics.loop_kernels import jit_with_kernels
from smajax.progress import CallbackStop, stoppable

# A search that ends above its best cost by more than this share of it, which covers rounding, has not converged.
_COST_ROUNDING = 1e-9
# One that ends above its best cost by more than this share of it has diverged, as undamped solvers may; a smaller share
# is the end of a search whose last step was too long. Chosen by trial, tests/unit/fitting/test_solvers.py holds it.
_DIVERGED_SHARE = 0.01

# A search has ended at a minimum if the linear model there predicts a decrease of the cost by at most this share of it,
# which is a change of the RMSE by half of it; or, for residuals of 0, a step of at most this length in scaled units, in
# which parameters are of order one. Chosen by trial on fits of the shipped dead weight, between the shares at the
# minimum and those where BFGS ends elsewhere; tests/unit/fitting/test_solvers.py has both.
_STATIONARY_SHARE = 1e-4
_STATIONARY_STEP = 1e-6

# Statuses of a search whose solver has ended by itself.
_ENDED = (SolverStatus.converged, SolverStatus.stalled)

Residual = Callable[[jax.Array, Any], jax.Array]


class OptimistixSearch:
    """Searches from several starts that can be continued where they stopped, like ``MultiStartSolver``.

    Attributes:
        steps: Number of steps so far.
        simulations: Estimated number of evaluations of the residual so far: in each step of each search one by the
            solver, one at the point that it reaches, and a Jacobian, which counts as p. Rejected steps, which need no
            Jacobian, and steps of minimisers, which need a gradient instead, count the same.
    """

    def __init__(
        self,
        solver: optx.AbstractLeastSquaresSolver[Any, Any, Any, Any] | optx.AbstractMinimiser[Any, Any, Any],
        fn: Residual,
        args: Any,
        starts: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        size: int,
    ):
        """Place the searches at their starts.

        Args:
            solver: The solver; a minimiser gets half the sum of squares.
            fn: Residual function of a vector (p,) and ``args``, shape ``(size,)``.
            args: Second argument of ``fn``.
            starts: Start points (s, p).
            lower: Lower bounds (p,).
            upper: Upper bounds (p,).
            size: Length of the residual.
        """
        self._solver, self._args = solver, args
        inside = [BoundTransformation(start, lower, upper) for start in np.clip(starts, lower, upper)]
        self._fn = _Function(fn, isinstance(solver, optx.AbstractMinimiser))
        struct = jax.ShapeDtypeStruct(() if self._fn.is_cost else (size,), jnp.float64)
        self._points = [jnp.asarray(transformation.start) for transformation in inside]
        self._searches = [(transformation, args) for transformation in inside]
        self._states = [
            solver.init(self._fn, point, search, {}, struct, None, frozenset())
            for point, search in zip(self._points, self._searches, strict=True)
        ]
        self._best = [np.array(transformation.start) for transformation in inside]
        self._costs = np.full(len(starts), np.inf)
        self._statuses = [SolverStatus.running] * len(starts)
        self._wall_time, self._history = 0.0, []
        self.steps: int = 0
        self.simulations: int = 0
        self._interrupted = False

    def advance(self, steps: int = 100, progress: Callable[[int, float], object] | None = None) -> "OptimistixSearch":
        """Take at most ``steps`` more steps of each search.

        With ``progress``, Ctrl-C or a ``StopIteration`` of the callback ends the searches, and the best points are kept
        with the status ``interrupted``. Without it, Ctrl-C raises ``KeyboardInterrupt``, so that a caller that does not
        ask for the status cannot take these points for the ends of the searches.

        Args:
            steps: Number of steps.
            progress: Called after each step with its number and the best cost so far.

        Returns:
            This search.
        """
        began, last = time.perf_counter() - self._wall_time, self.steps + steps
        report = stoppable(progress or (lambda step, cost: None))
        try:
            while self.steps < last and SolverStatus.running in self._statuses:
                for k in np.flatnonzero([status is SolverStatus.running for status in self._statuses]):
                    self._advance_one(int(k))
                self.steps += 1
                self._wall_time = time.perf_counter() - began
                best = float(np.min(self._costs))
                self._history.append((self.simulations, self._wall_time, best))
                report(self.steps, best)
        except (CallbackStop, KeyboardInterrupt):
            if progress is None:
                raise
            self._interrupted = True
        return self

    def _advance_one(self, k: int) -> None:
        """One step of one search, and the cost at the point that it reaches."""
        point, self._states[k], done, unsuccessful, vector, cost = _step(
            self._solver, self._fn, self._points[k], self._searches[k], self._states[k]
        )
        self.simulations += 2 + point.shape[0]
        self._points[k] = point
        if float(cost) < self._costs[k]:
            self._costs[k], self._best[k] = float(cost), np.asarray(vector)
        if not np.isfinite(self._costs[k]):
            self._statuses[k] = SolverStatus.failed
        elif bool(unsuccessful) or bool(done):
            self._statuses[k] = _status_at_end(float(cost), self._costs[k], bool(unsuccessful))

    def result(self) -> MultiStartResult:
        """Return the best points of all searches, with the residual and its Jacobian there.

        A search whose solver has ended has the status ``not_stationary`` if its point is no minimum.
        """
        points = np.stack(self._best)
        ends = [linearise(self._fn.residual, jnp.asarray(point), self._args) for point in points]
        unfinished = SolverStatus.interrupted if self._interrupted else SolverStatus.steps
        statuses = [unfinished if s is SolverStatus.running else s for s in self._statuses]
        for k, (jacobian, residual) in enumerate(ends):
            if statuses[k] in _ENDED and not self._is_stationary(k, residual, jacobian):
                statuses[k] = SolverStatus.not_stationary
        return MultiStartResult(
            points=points,
            residuals=np.stack([np.asarray(residual) for _, residual in ends]),
            jacobians=np.stack([np.asarray(jacobian) for jacobian, _ in ends]),
            costs=self._costs.copy(),
            statuses=statuses,
            updates=np.zeros(len(points), int),
            steps=self.steps,
            simulations=self.simulations,
            wall_time=self._wall_time,
            history=self._history,
        )

    def _is_stationary(self, k: int, residual: jax.Array, jacobian: jax.Array) -> bool:
        """Whether the best point of a search is a minimum within the bounds."""
        bounds = self._searches[k][0]
        lower, upper = jnp.asarray(bounds.lower), jnp.asarray(bounds.upper)
        decrease, step = predicted_decrease(jnp.asarray(self._best[k]), residual, jacobian, lower, upper)
        return bool(decrease <= _STATIONARY_SHARE * self._costs[k]) or bool(step <= _STATIONARY_STEP)


def _status_at_end(cost: float, best: float, unsuccessful: bool) -> SolverStatus:
    """How a search ended, at a cost that may be above the best one or NaN."""
    if not cost <= (1.0 + _DIVERGED_SHARE) * best:
        return SolverStatus.diverged
    at_best = cost <= (1.0 + _COST_ROUNDING) * best
    return SolverStatus.converged if at_best and not unsuccessful else SolverStatus.stalled


class _Function(eqx.Module):
    """The function of a solver: the residual, or half its sum of squares, of the unbounded unknowns."""

    residual: Residual = eqx.field(static=True)
    is_cost: bool = eqx.field(static=True)

    def __call__(self, unbounded: jax.Array, search: tuple[BoundTransformation, Any]) -> tuple[jax.Array, None]:
        transformation, args = search
        residual = self.residual(transformation(unbounded), args)
        return (0.5 * jnp.sum(residual**2) if self.is_cost else residual), None


@jit_with_kernels
def _step(solver: Any, fn: _Function, point: jax.Array, search: tuple[Any, ...], state: Any) -> tuple[Any, ...]:
    """One step: point and state after it, whether the solver ends and with an error, and vector and cost there."""
    point, state, _ = solver.step(fn, point, search, {}, state, frozenset())
    done, result = solver.terminate(fn, point, search, {}, state, frozenset())
    vector = search[0](point)
    cost = jnp.sum(fn.residual(vector, search[1]) ** 2)
    return point, state, done, result != optx.RESULTS.successful, vector, cost
