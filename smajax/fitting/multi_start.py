"""Least-squares searches from several starts, step by step.

``MultiStartSolver`` drives ``BoundedLevenbergMarquardt`` from several starts, so that progress can be shown, an
interruption keeps the best point so far, and the failure of one start does not affect the others. The starts are shared
among the processor's cores; an accelerator takes all of them as one batch.
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
from smajax.numerics.ensemble import evaluate_members, share_among_cores
from smajax.numerics.stored_programs import stored
from smajax.progress import CallbackStop, stoppable

# Least number of random points that are simulated to choose starts from. Chosen by trial on fits of rigs;
# tests/unit/fitting/test_fit.py holds the number.
_MIN_SCREENED = 48
# Least number of these per start; chosen by trial on fits of rigs.
_SCREENED_PER_START = 4
# Points of one batch when starts are chosen: four batches of the least number of points, for several cores.
_SCREENED_AT_ONCE = 12
# From this number of recordings on, the Jacobian is evaluated only where a step is accepted. Chosen by trial for speed.
LAZY_FROM = 4


def screen_starts(
    problem: AbstractFitProblem, starts: int, seed: int, at_once: int | None = None
) -> tuple[np.ndarray, int]:
    """Choose the best of many random points as starts in addition to the nominal one.

    At most random points the wire never transforms, and the gradient does not lead to a transformation.

    Args:
        problem: The problem.
        starts: Number of starts.
        seed: Seed of the random points.
        at_once: Most points that are simulated at a time; no limit if not given.

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
        at_once: Most points that are simulated at a time; no limit if not given.

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
    """Costs (m,) of points (m, p), in batches of one size; one after another where not all fit into the memory."""
    batch = len(points) if jax.default_backend() != "cpu" else _SCREENED_AT_ONCE
    is_limited = at_once is not None and at_once < len(points)
    size = min(batch, at_once or batch)
    return evaluate_members(
        lambda part: costs(problem, jax.device_put(part)), points, size, workers=1 if is_limited else None
    )


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
        lazy_jacobian: bool = False,
        workers: int | None = None,
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
            lazy_jacobian: Compute derivatives for accepted steps only, after a simulation without them. This is faster
                where derivatives cost many simulations; an accelerator computes them in any case.
            workers: Number of starts that are evaluated at a time; by default one per core.
            primal_fn: Function without derivatives, for a single start, called with the trial point and ``args``
                before each step. ``fn`` is then called with ``(args, result)``, and derivatives are computed only for
                accepted steps.
            secant_updates: Update the Jacobian from residuals where that is enough; needs ``lazy_jacobian`` or
                ``primal_fn``.
        """
        self._fn, self._args, self._primal_fn, self._workers = fn, args, primal_fn, workers
        self._solver = BoundedLevenbergMarquardt(
            jax.device_put(np.float64(rtol)),
            lazy_jacobian=lazy_jacobian or primal_fn is not None,
            secant_updates=secant_updates,
        )
        low, high = (np.broadcast_to(b, starts.shape) for b in (lower, upper))
        points, count = np.clip(starts, low, high), len(starts)
        together = 1 if jax.default_backend() == "cpu" else count
        parts = [slice(k, k + together) for k in range(0, count, together)]
        ends = [jax.device_put((points[part], (low[part], high[part]))) for part in parts]
        self._groups = [_Group(at, bounds, _initial_states(self._solver, at, size)) for at, bounds in ends]
        self._wall_time, self._history = 0.0, []
        self.steps: int = 0
        self.simulations: int = 0
        self._interrupted = False

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
            while self.steps < last and (running := [k for k, group in enumerate(self._groups) if group.running]):
                count = sum(self._groups[k].running for k in running)
                ends = share_among_cores(self._step, running, workers=self._workers, new_program=self.steps == 0)
                for k, end in zip(running, ends, strict=True):
                    self._groups[k] = end
                updated = sum(int(np.sum(np.asarray(end.states.updates) > 0)) for end in ends)
                self.simulations += count + (count - updated) * self._groups[0].points.shape[1]
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
        self._program.lower(*self._arguments(self._groups[0]))

    @property
    def cost(self) -> float:
        """The best cost so far."""
        return min(float(np.min(np.asarray(group.states.cost))) for group in self._groups)

    def result(self) -> MultiStartResult:
        """Return the state of all searches, with the exact Jacobians unless there is a ``primal_fn``."""

        def joined(leaf: Callable[[_Group], jax.Array]) -> np.ndarray:
            return np.concatenate([np.asarray(leaf(group)) for group in self._groups])

        points = joined(lambda group: group.points)
        jacobians, updates = joined(lambda group: group.states.jacobian), joined(lambda group: group.states.updates)
        for k in np.flatnonzero(updates) if self._primal_fn is None else ():
            jacobians[k], updates[k] = linearise(self._fn, jnp.asarray(points[k]), self._args)[0], 0
        unfinished = SolverStatus.interrupted if self._interrupted else SolverStatus.steps
        statuses = [SolverStatus(int(s)) for s in joined(lambda group: group.states.status)]
        return MultiStartResult(
            points=points,
            residuals=joined(lambda group: group.states.residual),
            jacobians=jacobians,
            costs=joined(lambda group: group.states.cost),
            statuses=[unfinished if s is SolverStatus.running else s for s in statuses],
            updates=updates,
            steps=self.steps,
            simulations=self.simulations,
            wall_time=self._wall_time,
            history=self._history,
        )

    def _step(self, k: int) -> "_Group":
        """The starts of a group after a step."""
        group = self._groups[k]
        points, states = jax.block_until_ready(self._program(*self._arguments(group)))
        return group._replace(points=points, states=states)

    @property
    def _program(self) -> Any:
        return _step_starts if self._primal_fn is None else _step_starts_large

    def _arguments(self, group: "_Group") -> tuple[Any, ...]:
        args = self._args
        if self._primal_fn is not None:
            args = (args, self._primal_fn(group.states.trial[0], args))
        return self._solver, self._fn, group.points, group.states, group.bounds, args


class _Group(NamedTuple):
    """Starts that are evaluated together: one on a processor, all on an accelerator.

    Attributes:
        points: Best points (g, p).
        bounds: Lower and upper bounds (g, p).
        states: States of the searches.
    """

    points: jax.Array
    bounds: tuple[jax.Array, jax.Array]
    states: LMState

    @property
    def running(self) -> int:
        """Number of searches that have not ended."""
        return int(np.sum(np.asarray(self.states.status) == SolverStatus.running))


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
) -> tuple[Any, ...]:
    """One step of every search that has not ended: the points and states after it."""

    def step(y: jax.Array, state: LMState, bounds: tuple[Any, ...]) -> tuple[Any, ...]:
        bounded = dataclasses.replace(solver, lower=bounds[0], upper=bounds[1])
        return bounded.step(lambda v, a: (fn(v, a), None), y, args, {}, state, frozenset())[:2]

    def batched(y: jax.Array, state: LMState, bounds: tuple[Any, ...]) -> tuple[Any, ...]:
        running = state.status == SolverStatus.running
        return jax.tree.map(lambda a, b: jnp.where(running, a, b), step(y, state, bounds), (y, state))

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
