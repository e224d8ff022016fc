"""The cost function of all population searches: it counts simulations, measures time and keeps the best point."""

import dataclasses
import math
import time
from collections.abc import Callable
from typing import Any, Literal

import jax.numpy as jnp
import numpy as np

from smajax.errors import InputError
from smajax.fitting.abstract_problem import AbstractFitProblem, costs
from smajax.progress import CallbackStop, stoppable

# Cost of a point that cannot be simulated: far above any cost of a successful simulation, and its square is still a
# float.
UNUSABLE_COST = 1e30

EndReason = Literal["settled", "target", "budget", "interrupted"]
# Called with the number of calls of the compiled program and the best cost so far.
Progress = Callable[[int, float], object]


@dataclasses.dataclass(frozen=True)
class BaselineResult:
    """The end of a search and its effort.

    Attributes:
        name: Name of the method.
        vector: Best point (p,), in the problem's scaled units; the nominal point if nothing could be simulated.
        cost: Sum of squares there; infinite if nothing could be simulated.
        simulations: Number of simulations.
        wall_time: Time without compiling, s.
        compile_time: Time until the program was compiled and had run once, s.
        history: Simulations, wall time in s and best cost at each improvement and at the end.
        failures: Simulations of points whose cost was not finite.
        end_reason: ``settled`` (converged), ``target``, ``budget`` or ``interrupted``.
    """

    name: str
    vector: np.ndarray
    cost: float
    simulations: int
    wall_time: float
    compile_time: float
    history: tuple[tuple[int, float, float], ...]
    failures: int
    end_reason: EndReason

    def effort_to_reach(self, cost: float) -> tuple[int, float] | None:
        """Return the effort until the best cost was at most ``cost``.

        Args:
            cost: A sum of squares.

        Returns:
            Number of simulations and wall time in s; ``None`` if the search did not reach the cost.
        """
        return next(((simulations, wall) for simulations, wall, best in self.history if best <= cost), None)


class _SearchEnded(Exception):
    """End of a search whose target is reached, whose budget is used up, or that is stopped; with the reason."""


class CostMeter:
    """A cost function of up to ``size`` points at once that counts simulations and keeps the best point."""

    def __init__(
        self, problem: AbstractFitProblem, size: int, budget: int | None, target: float | None, progress: Progress
    ) -> None:
        """Compile the program and run it once.

        Args:
            problem: The problem.
            size: Most points that are simulated as one batch.
            budget: Most simulations; no limit if not given.
            target: Cost at which the search ends; none if not given.
            progress: Called after each batch with the number of batches and the best cost so far; ends the search if it
                raises ``StopIteration``.

        Raises:
            InputError: The budget does not allow one evaluation of all recordings.
        """
        self._recordings = problem.data.measured.shape[0]
        if budget is not None and budget < self._recordings:
            raise InputError(
                f"a budget of {budget} simulations does not allow to simulate all recordings once: give a larger one"
            )
        self._problem, self._size, self._progress = problem, size, stoppable(progress)
        self._budget = math.inf if budget is None else budget
        self._target = -math.inf if target is None else target
        self._calls = self._simulations = self._failures = 0
        self._vector, self._cost = problem.nominal, math.inf
        self._history: list[tuple[int, float, float]] = []
        self._created = time.perf_counter()
        self._run(self._vector[None])
        self.start()

    def start(self) -> None:
        """Start the clock; the time before counts as compiling."""
        self._began = time.perf_counter()

    def _run(self, vectors: np.ndarray) -> np.ndarray:
        # Repeated points fill up the batch, so that one compiled program serves every number of points.
        filled = np.resize(vectors, (self._size, vectors.shape[1]))
        return np.array(costs(self._problem, jnp.asarray(filled)))[: len(vectors)]

    def __call__(self, vectors: np.ndarray) -> np.ndarray:
        """Compute the costs of points; raises ``_SearchEnded`` at the target or the end of the budget.

        Args:
            vectors: Points (m, p), in the problem's scaled units.

        Returns:
            The costs (m,); ``UNUSABLE_COST`` where a cost is not finite.
        """
        allowed = int(min(len(vectors), (self._budget - self._simulations) // self._recordings))
        if allowed == 0:
            raise _SearchEnded("budget")
        values = self._run(vectors[:allowed])
        self._calls += 1
        self._simulations += allowed * self._recordings
        unusable = ~np.isfinite(values)
        self._failures += int(np.sum(unusable)) * self._recordings
        values[unusable] = UNUSABLE_COST
        best = int(np.argmin(values))
        if values[best] < min(self._cost, UNUSABLE_COST):
            self._vector, self._cost = np.array(vectors[best]), float(values[best])
            self._note()
        try:
            self._progress(self._calls, self._cost)
        except CallbackStop:
            raise _SearchEnded("interrupted") from None
        if self._cost <= self._target:
            raise _SearchEnded("target")
        if allowed < len(vectors):
            raise _SearchEnded("budget")
        return values

    def _note(self) -> None:
        self._history.append((self._simulations, time.perf_counter() - self._began, self._cost))

    def search(self, name: str, run: Callable[[], Any]) -> BaselineResult:
        """Run a search that calls this meter, to its end. Ctrl-C ends it and keeps the best point.

        Args:
            name: Name of the method.
            run: The search.

        Returns:
            The best point, its cost, and the effort.
        """
        end_reason: EndReason = "settled"
        try:
            run()
        except _SearchEnded as ended:
            end_reason = ended.args[0]
        except KeyboardInterrupt:
            end_reason = "interrupted"
        self._note()
        return BaselineResult(
            name=name,
            vector=self._vector,
            cost=self._cost,
            simulations=self._simulations,
            wall_time=self._history[-1][1],
            compile_time=self._began - self._created,
            history=tuple(self._history),
            failures=self._failures,
            end_reason=end_reason,
        )


def no_progress(calls: int, cost: float) -> None:
    """Ignore the progress of a search.

    Args:
        calls: Number of calls of the compiled program.
        cost: The best cost so far.
    """
