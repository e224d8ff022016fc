"""Bounded Levenberg-Marquardt, as an optimistix least-squares solver.

Each step solves the normal equations, damped in proportion to their diagonal (Marquardt), for the parameters that are not held by a bound:
one that sits on its bound with the gradient pushing it outwards stays there, the rest of the step is cut to the box. Residual and Jacobian
are evaluated together at the trial point, because with forward tangents the pair costs less than two residuals; a trial that does not lower
the cost raises the damping, the more so the more of them were refused in a row. A parameter whose two bounds are equal is fixed, so
profiles and nested models need no other program.

The solver follows optimistix's interface (``init``, ``step``, ``terminate``); ``Search`` drives it step by step on a batch of starts, so
that progress can be shown, an interruption keeps the best point so far, and one start's failure leaves the others alone.
"""

import enum
import time
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import optimistix as optx


class Stop(enum.IntEnum):
    """Why a start ended; ``text`` says it in words."""

    running = 0
    converged = 1
    stalled = 2
    failed = 3
    steps = 4
    interrupted = 5

    @property
    def text(self) -> str:
        """One sentence for people."""
        return {
            Stop.running: "still running",
            Stop.converged: "the cost falls by less than its tolerance",
            Stop.stalled: "no step lowers the cost any more",
            Stop.failed: "the simulation fails at the start point: see its result code",
            Stop.steps: "the number of steps ran out before the cost settled: allow more, or start nearer",
            Stop.interrupted: "interrupted; the best point so far is kept",
        }[self]


class LMState(NamedTuple):
    """State of one start: best point's residual, Jacobian and cost; the trial point; damping; small falls and refusals in a row."""

    trial: jax.Array
    residual: jax.Array
    jacobian: jax.Array
    cost: jax.Array
    damping: jax.Array
    predicted: jax.Array
    small: jax.Array
    refused: jax.Array
    steps: jax.Array
    stop: jax.Array


class BoundedLevenbergMarquardt(optx.AbstractLeastSquaresSolver):
    """Levenberg-Marquardt in a box. ``args`` of the residual is ``(lower, upper, rest)``; the residual is called with ``rest``.

    Both the unknown ``y``, shape ``(p,)``, and the residual, shape ``(m,)``, are flat arrays. ``rtol`` is the relative fall of the cost
    below which two steps running end the search. ``sparing`` evaluates the Jacobian after the residual, and only of trials that are taken:
    that pays where it costs several residuals, and not in a batch.
    """

    rtol: Any  # an array of no dimensions: as a number, each value would be a program of its own
    atol: float = 0.0
    sparing: bool = eqx.field(static=True, default=False)
    norm: Callable = eqx.field(static=True, default=optx.max_norm)

    def init(self, fn: Callable, y: Any, args: Any, options: Any, f_struct: Any, aux_struct: Any, tags: Any) -> LMState:
        """Nothing is evaluated yet: the first step accepts the start point."""
        # Types are spelt out: a weakly typed start would compile the step twice.
        size, real, whole = f_struct.shape[0], jnp.float64, jnp.int64
        return LMState(
            trial=y,
            residual=jnp.zeros(size, real),
            jacobian=jnp.zeros((size, y.shape[0]), real),
            cost=jnp.asarray(jnp.inf, real),
            damping=jnp.asarray(1e-3, real),
            predicted=jnp.zeros((), real),
            small=jnp.zeros((), whole),
            refused=jnp.zeros((), whole),
            steps=jnp.zeros((), whole),
            stop=jnp.asarray(Stop.running.value, whole),
        )

    def step(self, fn: Callable, y: Any, args: Any, options: Any, state: LMState, tags: Any) -> tuple[Any, LMState, Any]:
        """Evaluates the trial point, accepts or refuses it, and proposes the next one."""
        lower, upper, rest = args

        def value(v: jax.Array) -> tuple[jax.Array, jax.Array]:
            r = fn(v, rest)[0]
            return r, r

        if self.sparing:
            residual = value(state.trial)[0]
            cost = jnp.sum(residual**2)
            slopes = jax.jacfwd(value, has_aux=True)
            jacobian = jax.lax.cond(cost < state.cost, lambda v: slopes(v)[0], lambda _: state.jacobian, state.trial)
        else:
            jacobian, residual = jax.jacfwd(value, has_aux=True)(state.trial)
            cost = jnp.sum(residual**2)
        sound = jnp.isfinite(cost) & jnp.all(jnp.isfinite(jacobian))
        accept = sound & (cost < state.cost)
        first = state.steps == 0
        fall = state.cost - cost
        gain = fall / jnp.where(state.predicted > 0, state.predicted, 1.0)
        eased = state.damping * jnp.clip(1.0 - (2.0 * gain - 1.0) ** 3, 0.1, 1.0)
        raised = 5.0 * 3.0**state.refused * state.damping
        damping = jnp.where(first, state.damping, jnp.where(accept, eased, raised))
        small = jnp.where(accept & (fall <= self.rtol * state.cost) & ~first, state.small + 1, jnp.where(accept, 0, state.small))
        y = jnp.where(accept, state.trial, y)
        residual = jnp.where(accept, residual, state.residual)
        jacobian = jnp.where(accept, jacobian, state.jacobian)
        cost = jnp.where(accept, cost, state.cost)
        trial, predicted = _propose(y, residual, jacobian, damping, lower, upper)
        still = (predicted >= 0) & (predicted <= self.rtol * 1e-2 * cost)
        stop = jnp.select(
            [first & ~sound, (small >= 2) | (still & ~first) | (first & (predicted == 0)), damping > 1e12],
            [Stop.failed.value, Stop.converged.value, Stop.stalled.value],
            Stop.running.value,
        ).astype(jnp.int64)
        refused = jnp.where(accept, 0, state.refused + 1)
        state = LMState(trial, residual, jacobian, cost, jnp.maximum(damping, 1e-12), predicted, small, refused, state.steps + 1, stop)
        return y, state, residual

    def terminate(self, fn: Callable, y: Any, args: Any, options: Any, state: LMState, tags: Any) -> tuple:
        """Optimistix's question whether to go on."""
        done = (state.stop == Stop.converged) | (state.stop == Stop.stalled)
        result = optx.RESULTS.where(state.stop == Stop.failed, optx.RESULTS.nonlinear_divergence, optx.RESULTS.successful)
        return done | (state.stop == Stop.failed), result

    def postprocess(self, fn: Callable, y: Any, aux: Any, args: Any, options: Any, state: LMState, tags: Any, result: Any) -> tuple:
        """Nothing more to do."""
        return y, aux, {}


def _propose(y: jax.Array, residual: jax.Array, jacobian: jax.Array, damping: jax.Array, lower: jax.Array, upper: jax.Array) -> tuple:
    """Next trial point in the box, and the fall of the cost that the linear model predicts for it."""
    gradient = jacobian.T @ residual
    normal = jacobian.T @ jacobian
    held = ((y <= lower) & (gradient > 0)) | ((y >= upper) & (gradient < 0)) | (lower >= upper)

    diagonal = jnp.diag(normal)
    damped = normal + damping * jnp.diag(jnp.maximum(diagonal, 1e-12 * jnp.max(diagonal) + 1e-300))

    def solve(right: jax.Array, held: jax.Array) -> jax.Array:
        matrix = jnp.where(held[:, None] | held[None, :], jnp.eye(y.shape[0]), damped)
        return jnp.where(held, 0.0, jnp.linalg.solve(matrix, jnp.where(held, 0.0, right)))

    # Parameters whose step leaves the box go to their bound, and the others are solved for again, knowing that.
    change = solve(-gradient, held)
    leaving = ~held & ((y + change < lower) | (y + change > upper))
    cut = jnp.where(leaving, jnp.clip(y + change, lower, upper) - y, 0.0)
    change = jnp.clip(y + cut + solve(-gradient - normal @ cut, held | leaving), lower, upper) - y
    predicted = -(2.0 * gradient @ change + change @ normal @ change)
    return y + change, predicted


@eqx.filter_jit
def _begin(solver: BoundedLevenbergMarquardt, points: jax.Array, size: int) -> LMState:
    struct = jax.ShapeDtypeStruct((size,), jnp.float64)
    return jax.vmap(lambda y: solver.init(lambda y, args: y, y, None, {}, struct, None, frozenset()))(points)


class Solved(NamedTuple):
    """A batch of ``s`` starts at their ends: points ``(s, p)``, residuals ``(s, m)``, Jacobians ``(s, m, p)``, costs ``(s,)``."""

    points: np.ndarray
    residuals: np.ndarray
    jacobians: np.ndarray
    costs: np.ndarray
    stops: list[Stop]
    steps: int
    simulations: int
    wall: float
    history: list[tuple[int, float, float]]


def _further(
    solver: BoundedLevenbergMarquardt, fn: Callable, points: jax.Array, states: LMState, bounds: tuple, rest: Any, apart: bool
) -> tuple:
    def further(y: jax.Array, state: LMState, bounds: tuple) -> tuple:
        return solver.step(lambda v, a: (fn(v, a), None), y, (*bounds, rest), {}, state, frozenset())[:2]

    def together(y: jax.Array, state: LMState, bounds: tuple) -> tuple:
        going = state.stop == Stop.running
        return jax.tree.map(lambda a, b: jnp.where(going, a, b), further(y, state, bounds), (y, state))

    def alone(one: tuple) -> tuple:
        return jax.lax.cond(one[1].stop == Stop.running, further, lambda y, state, bounds: (y, state), *one)

    if points.shape[0] == 1:  # one start needs no batch
        one = together(*jax.tree.map(lambda leaf: leaf[0], (points, states, bounds)))
        return jax.tree.map(lambda leaf: leaf[None], one)
    return jax.lax.map(alone, (points, states, bounds)) if apart else jax.vmap(together)(points, states, bounds)


_advance = eqx.filter_jit(_further)
# Of a large program that is no batch LLVM's later optimisations take long, and make nothing faster.
LARGE = {"xla_backend_optimization_level": 1}
_advance_large = eqx.filter_jit(_further, compiler_options=LARGE)  # pyright: ignore[reportCallIssue]


class Search:
    """Searches from each row of ``starts``, shape ``(s, p)``, that can be taken up again where they stood.

    Minimises ``sum(fn(v, rest)**2)`` within bounds of shape ``(p,)`` or ``(s, p)``; ``fn`` gives ``size`` residuals; ``rtol`` as in
    ``BoundedLevenbergMarquardt``. Starts take their steps as one batch, or ``apart``, one after another: that is as fast where ``fn`` is
    a batch itself, and those that have ended cost nothing. With ``ahead``, a program
    of its own that is called with the one start's trial point and ``rest`` before each step, ``fn`` is called with both ``rest`` and what
    that gives; then only a step that is taken costs derivatives.
    """

    def __init__(
        self,
        fn: Callable[[jax.Array, Any], jax.Array],
        rest: Any,
        starts: np.ndarray,
        lower: np.ndarray,
        upper: np.ndarray,
        *,
        size: int,
        rtol: float = 1e-7,
        apart: bool = False,
        ahead: Callable[[jax.Array, Any], Any] | None = None,
    ):
        self._fn, self._rest, self._ahead = fn, rest, ahead
        self._solver = BoundedLevenbergMarquardt(jnp.asarray(rtol), sparing=apart or ahead is not None)
        low, high = (np.broadcast_to(b, starts.shape) for b in (lower, upper))
        self._points, self._bounds = jax.device_put((np.clip(starts, low, high), (low, high)))
        self._states = _begin(self._solver, self._points, size)
        self._wall, self._history = 0.0, []
        self.steps = self.simulations = 0
        self._interrupted, self._apart = False, apart

    def advance(self, steps: int = 100, progress: Callable[[int, float], None] = lambda step, cost: None) -> "Search":
        """At most so many steps more; ``progress`` is called after each with its number and the best cost so far.

        Ctrl-C ends the search and keeps the best points.
        """
        began, last = time.perf_counter() - self._wall, self.steps + steps
        try:
            while self.steps < last and (running := int(np.sum(np.asarray(self._states.stop) == Stop.running))):
                self.simulations += running * (1 + self._points.shape[1])
                self._points, self._states = jax.block_until_ready(self._program(*self._arguments()))
                self.steps += 1
                self._wall = time.perf_counter() - began
                best = self.cost
                self._history.append((self.simulations, self._wall, best))
                progress(self.steps, best)
        except KeyboardInterrupt:
            self._interrupted = True
        return self

    def trace(self) -> None:
        """Traces the program of a step, which is kept for its compiling."""
        self._program.lower(*self._arguments())

    @property
    def _program(self) -> Any:
        return _advance if self._ahead is None else _advance_large

    def _arguments(self) -> tuple:
        rest = self._rest if self._ahead is None else (self._rest, self._ahead(self._states.trial[0], self._rest))
        return self._solver, self._fn, self._points, self._states, self._bounds, rest, self._apart

    @property
    def cost(self) -> float:
        """The best cost so far."""
        return float(np.min(self._states.cost))

    def result(self) -> Solved:
        """Where the searches stand."""
        unfinished = Stop.interrupted if self._interrupted else Stop.steps
        stops = [Stop(int(s)) for s in np.asarray(self._states.stop)]
        return Solved(
            points=np.asarray(self._points),
            residuals=np.asarray(self._states.residual),
            jacobians=np.asarray(self._states.jacobian),
            costs=np.asarray(self._states.cost),
            stops=[unfinished if s is Stop.running else s for s in stops],
            steps=self.steps,
            simulations=self.simulations,
            wall=self._wall,
            history=self._history,
        )
