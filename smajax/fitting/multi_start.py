"""Least-squares searches from several starts, step by step.

``MultiStartSolver`` drives ``BoundedLevenbergMarquardt`` on a batch of starts, so that progress can be shown, an
interruption keeps the best point so far, and the failure of one start does not affect the others.
"""

import dataclasses
import functools
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from smajax.fitting.abstract_problem import AbstractFitProblem, costs
from smajax.fitting.compilation import LARGE_PROGRAM_OPTIONS, SEARCH_OPTIONS, vmap_unless_single
from smajax.fitting.levenberg_marquardt import BoundedLevenbergMarquardt, LMState, SolverStatus
from smajax.numerics.stored_programs import stored
from smajax.progress import CallbackStop, stoppable

# Least number of random points that are simulated to choose starts from. Chosen by trial on fits of rigs;
# tests/unit/fitting/test_fit.py holds the number.
_MIN_SCREENED = 48
# Least number of these per start; chosen by trial on fits of rigs.
_SCREENED_PER_START = 4
# From this number of recordings on, one simulation is a wide batch by itself, and the starts are searched one after
# another. Chosen by trial for speed.
SEQUENTIAL_FROM = 4


def screen_starts(
    problem: AbstractFitProblem, starts: int, seed: int, at_once: int | None = None
) -> tuple[np.ndarray, int]:
    """Choose the best of many random points, simulated as one batch, as starts in addition to the nominal one.

    At most random points the wire never transforms, and the gradient does not lead to a transformation.

    Args:
        problem: The problem.
        starts: Number of starts.
        seed: Seed of the random points.
        at_once: Most points that are simulated as one batch; all if not given.

    Returns:
        The nominal point and ``starts - 1`` others, shape ``(starts, p)``, and the number of simulations.
    """
    if starts <= 1:
        return problem.nominal[None], 0
    lower, upper = problem.search_bounds()
    count = max(_MIN_SCREENED, _SCREENED_PER_START * starts)
    points = np.random.default_rng(seed).uniform(lower, upper, (count, len(lower)))
    point_costs = _costs_in_parts(problem, points, at_once)
    order = np.argsort(np.where(np.isfinite(point_costs), point_costs, np.inf))
    return np.vstack([problem.nominal, points[order[: starts - 1]]]), len(points) * problem.data.measured.shape[0]


def screen_displaced_starts(
    problem: AbstractFitProblem,
    starts: int,
    seed: int,
    direction: np.ndarray,
    displacements: tuple[float, float],
    at_once: int | None = None,
) -> tuple[np.ndarray, int]:
    """Choose starts among random points that are displaced along one direction, from the whole range of displacements.

    The range is divided into as many parts as there are starts, and the best point of each part is a start, since the
    costs of displaced points need not lead towards the minimum.

    Args:
        problem: The problem.
        starts: Number of starts in addition to the nominal one.
        seed: Seed of the random points.
        direction: Change of the vector by a displacement of 1, shape ``(p,)``.
        displacements: Least and largest displacement.
        at_once: Most points that are simulated as one batch; all if not given.

    Returns:
        The nominal point and ``starts`` others, shape ``(starts + 1, p)``, and the number of simulations.
    """
    per_start = max(_SCREENED_PER_START, -(-_MIN_SCREENED // starts))
    lower, upper = problem.search_bounds()
    random = np.random.default_rng(seed)
    points = random.uniform(lower, upper, (starts * per_start, len(lower)))
    part = np.repeat(np.arange(starts), per_start)
    low, high = displacements
    displacement = low + (high - low) * (part + random.uniform(size=len(part))) / starts
    points = np.clip(points + displacement[:, None] * direction, *problem.bounds)
    point_costs = _costs_in_parts(problem, points, at_once)
    order = np.where(np.isfinite(point_costs), point_costs, np.inf).reshape(starts, per_start)
    best = points.reshape(starts, per_start, -1)[np.arange(starts), np.argmin(order, axis=1)]
    return np.vstack([problem.nominal, best]), len(points) * problem.data.measured.shape[0]


def _costs_in_parts(problem: AbstractFitProblem, points: np.ndarray, at_once: int | None) -> np.ndarray:
    """Costs (m,) of points (m, p), in batches of equal size, so that one program serves all of them."""
    count = len(points)
    size = min(at_once or count, count)
    # The last batch is filled up with copies of the last point.
    filled = np.concatenate([points, np.repeat(points[-1:], -count % size, axis=0)])
    parts = [np.asarray(costs(problem, jnp.asarray(part))) for part in np.split(filled, len(filled) // size)]
    return np.concatenate(parts)[:count]


class MultiStartResult(NamedTuple):
    """The ends of ``s`` searches.

    Attributes:
        points: Best points (s, p).
        residuals: Residuals there (s, m).
        jacobians: Jacobians there (s, m, p).
        costs: Sums of squares there (s,).
        statuses: Why each search ended.
        updates: Number of updates of each Jacobian since it was computed; 0 for an exact one.
        steps: Number of steps.
        simulations: Number of evaluations of the residual; a Jacobian counts as p.
        wall_time: Time of the steps, s.
        history: After each step: simulations, wall time in s, best cost.
    """

    points: np.ndarray
    residuals: np.ndarray
    jacobians: np.ndarray
    costs: np.ndarray
    statuses: list[SolverStatus]
    updates: np.ndarray
    steps: int
    simulations: int
    wall_time: float
    history: list[tuple[int, float, float]]


class MultiStartSolver:
    """Searches from several starts that can be continued where they stopped.

    Minimises ``sum(fn(vector, args)**2)`` within bounds.

    Attributes:
        steps: Number of steps so far.
        simulations: Number of evaluations of the residual so far; a Jacobian counts as p.
    """

    def __init__(
        self,
        fn: Callable[[jax.Array, Any], jax.Array],
        args: Any,
        starts: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        size: int,
        rtol: float = 1e-7,
        sequential: bool = False,
        primal_fn: Callable[[jax.Array, Any], Any] | None = None,
        secant_updates: bool = False,
    ):
        """Place the searches at their starts; nothing is evaluated yet.

        Args:
            fn: Residual function of a vector (p,) and ``args``, shape ``(size,)``.
            args: Second argument of ``fn``.
            starts: Start points (s, p).
            lower: Lower bounds (p,) or (s, p).
            upper: Upper bounds of the same shape.
            size: Length of the residual.
            rtol: Relative tolerance of ``BoundedLevenbergMarquardt``.
            sequential: Step the starts one after another instead of as one batch. This is as fast where ``fn`` is a
                batch itself, and searches that have ended cost nothing.
            primal_fn: Function without derivatives, for a single start, called with the trial point and ``args``
                before each step. ``fn`` is then called with ``(args, result)``, and derivatives are computed only for
                accepted steps.
            secant_updates: Update the Jacobian from residuals where that is enough; needs ``sequential`` or
                ``primal_fn``.
        """
        self._fn, self._args, self._primal_fn = fn, args, primal_fn
        self._solver = BoundedLevenbergMarquardt(
            jnp.asarray(rtol), lazy_jacobian=sequential or primal_fn is not None, secant_updates=secant_updates
        )
        low, high = (np.broadcast_to(b, starts.shape) for b in (lower, upper))
        self._points, self._bounds = jax.device_put((np.clip(starts, low, high), (low, high)))
        self._states = _initial_states(self._solver, self._points, size)
        self._wall_time, self._history = 0.0, []
        self.steps: int = 0
        self.simulations: int = 0
        self._interrupted, self._sequential = False, sequential

    def advance(self, steps: int = 100, progress: Callable[[int, float], object] | None = None) -> "MultiStartSolver":
        """Take at most ``steps`` more steps.

        With ``progress``, Ctrl-C or a ``StopIteration`` of the callback ends the searches, and the best points are kept
        with the status ``interrupted``. Without it, Ctrl-C raises ``KeyboardInterrupt``, so that a caller that does not
        ask for the status cannot take these points for the ends of the searches.

        Args:
            steps: Number of steps.
            progress: Called after each step with its number and the best cost so far.

        Returns:
            This solver.
        """
        began, last = time.perf_counter() - self._wall_time, self.steps + steps
        report = stoppable(progress or (lambda step, cost: None))
        try:
            while self.steps < last and (running := self._count_running()):
                self._points, self._states = jax.block_until_ready(self._program(*self._arguments()))
                updated = int(np.sum(np.asarray(self._states.updates) > 0))
                self.simulations += running + (running - updated) * self._points.shape[1]
                self.steps += 1
                self._wall_time = time.perf_counter() - began
                best = self.cost
                self._history.append((self.simulations, self._wall_time, best))
                report(self.steps, best)
        except (CallbackStop, KeyboardInterrupt):
            if progress is None:
                raise
            self._interrupted = True
        return self

    def trace_program(self) -> None:
        """Trace and lower the program of a step, so that it can be compiled in another thread."""
        self._program.lower(*self._arguments())

    @property
    def cost(self) -> float:
        """The best cost so far."""
        return float(np.min(self._states.cost))

    def result(self) -> MultiStartResult:
        """Return the state of all searches, with the exact Jacobians unless there is a ``primal_fn``."""
        jacobians, updates = np.array(self._states.jacobian), np.array(self._states.updates)
        for k in np.flatnonzero(updates) if self._primal_fn is None else ():
            jacobians[k], updates[k] = linearise(self._fn, self._points[k], self._args)[0], 0
        unfinished = SolverStatus.interrupted if self._interrupted else SolverStatus.steps
        statuses = [SolverStatus(int(s)) for s in np.asarray(self._states.status)]
        return MultiStartResult(
            points=np.asarray(self._points),
            residuals=np.asarray(self._states.residual),
            jacobians=jacobians,
            costs=np.asarray(self._states.cost),
            statuses=[unfinished if s is SolverStatus.running else s for s in statuses],
            updates=updates,
            steps=self.steps,
            simulations=self.simulations,
            wall_time=self._wall_time,
            history=self._history,
        )

    def _count_running(self) -> int:
        return int(np.sum(np.asarray(self._states.status) == SolverStatus.running))

    @property
    def _program(self) -> Any:
        return _step_starts if self._primal_fn is None else _step_starts_large

    def _arguments(self) -> tuple[Any, ...]:
        args = self._args
        if self._primal_fn is not None:
            args = (args, self._primal_fn(self._states.trial[0], args))
        return self._solver, self._fn, self._points, self._states, self._bounds, args, self._sequential


@functools.partial(stored, compiler_options=SEARCH_OPTIONS)
def _initial_states(solver: BoundedLevenbergMarquardt, points: jax.Array, size: int) -> LMState:
    struct = jax.ShapeDtypeStruct((size,), jnp.float64)
    return jax.vmap(lambda y: solver.init(lambda y, args: (y, None), y, None, {}, struct, None, frozenset()))(points)


def _step_all(
    solver: BoundedLevenbergMarquardt,
    fn: Callable[..., Any],
    points: jax.Array,
    states: LMState,
    bounds: tuple[Any, ...],
    args: Any,
    sequential: bool,
) -> tuple[Any, ...]:
    """One step of every search that has not ended: the points and states after it."""

    def step(y: jax.Array, state: LMState, bounds: tuple[Any, ...]) -> tuple[Any, ...]:
        bounded = dataclasses.replace(solver, lower=bounds[0], upper=bounds[1])
        return bounded.step(lambda v, a: (fn(v, a), None), y, args, {}, state, frozenset())[:2]

    def batched(y: jax.Array, state: LMState, bounds: tuple[Any, ...]) -> tuple[Any, ...]:
        running = state.status == SolverStatus.running
        return jax.tree.map(lambda a, b: jnp.where(running, a, b), step(y, state, bounds), (y, state))

    def conditional(search: tuple[Any, ...]) -> tuple[Any, ...]:
        running = search[1].status == SolverStatus.running
        return jax.lax.cond(running, step, lambda y, state, bounds: (y, state), *search)

    if sequential and points.shape[0] > 1:
        return jax.lax.map(conditional, (points, states, bounds))
    return vmap_unless_single(batched, points.shape[0], points, states, bounds)


_step_starts = stored(_step_all, compiler_options=SEARCH_OPTIONS)
_step_starts_large = stored(_step_all, compiler_options=LARGE_PROGRAM_OPTIONS)


@stored
def linearise(fn: Callable[[jax.Array, Any], jax.Array], vector: jax.Array, args: Any) -> tuple[jax.Array, jax.Array]:
    """Compute Jacobian and residual at a vector.

    Args:
        fn: Residual function of the vector and ``args``, shape ``(m,)``.
        vector: The vector, shape ``(p,)``.
        args: Second argument of ``fn``.

    Returns:
        The Jacobian, shape ``(m, p)``, and the residual.
    """

    def with_value(v: jax.Array) -> tuple[jax.Array, jax.Array]:
        residual = fn(v, args)
        return residual, residual

    return jax.jacfwd(with_value, has_aux=True)(vector)
