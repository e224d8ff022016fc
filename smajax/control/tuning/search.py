"""The search for gains: cost and gradient at a point, evaluated points, number of rollouts, and two local searches.

A point lies in the unit box: the logarithms of the gains, scaled between their bounds. Terms and limits (``objective``)
are combined to one cost; the work of its reverse-mode gradient does not depend on the number of gains. Several members
(plants, draws of the noise) are simulated as one batch and have equal weights; a search may use some of them only.
"""

import math
from collections.abc import Callable
from typing import Any, NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize
from jaxtyping import Float

from smajax.control.tuning import trust_region
from smajax.control.tuning.objective import LIMITS, TERMS, Objective, ObjectiveTerms
from smajax.control.tuning.problem import TuningProblem, evaluate_points
from smajax.control.tuning.trust_region import SearchState
from smajax.errors import NumericsError
from smajax.numerics.ensemble import evaluate_members
from smajax.numerics.stored_programs import stored

# Number of points that one call of the compiled program evaluates; more are shared among the cores.
BATCH = 8
# Largest violation that counts as none, dimensionless: a search within limits ends at a limit, up to this tolerance.
VIOLATION_TOLERANCE = 1e-3
# Number of rollouts that a reverse-mode gradient counts as: its measured run time is that of 2.6 to 2.9 rollouts.
_GRADIENT_ROLLOUTS = 3
# Cost that replaces one that is not finite.
_OVERFLOW = 1e30
# Change of the command, as a share of its range, at which the effort term is 1, and the range above which a command
# counts as unbounded.
_UNIT_MOVE = 0.01
_UNBOUNDED_RANGE = 1e6
# Largest violation, and largest ratio of a cost to the first one, that COBYQA gets, so that a steep increase does not
# distort its quadratic models; test_quadratic_models_continue_where_gradients_are_meaningless of
# tests/unit/control/test_tuning.py holds them.
_MAX_VIOLATION = 10.0
_MAX_COST_RATIO = 100.0


def _cost(evaluated: ObjectiveTerms, objective: Objective, scale: jax.Array) -> jax.Array:
    """The sum of the weighted terms over their scales, mean over the members."""
    return jnp.sum(jnp.mean(jnp.sum(evaluated.terms**2, axis=2), axis=0) * objective.weights / scale)


@stored
def _cost_and_gradient(
    problem: TuningProblem, point: jax.Array, objective: Objective, scale: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """The cost and its gradient."""
    return jax.value_and_grad(lambda p: _cost(problem.objective_terms(p, objective), objective, scale))(point)


class Candidate(NamedTuple):
    """Evaluated point.

    Attributes:
        violation: Total violation of the limits; 0 if all are kept.
        cost: Sum of the weighted terms.
        point: The point of the unit box, shape ``(p,)``.
        violations: Largest violation of each limit, shape ``(5,)``; 0 if it was not evaluated.
    """

    violation: float
    cost: float
    point: np.ndarray
    violations: np.ndarray = np.zeros(len(LIMITS))


def rank(candidate: Candidate) -> tuple[float, float]:
    """Return the sort key of candidates: violation first, then cost; smaller is better."""
    return candidate.violation, candidate.cost


def total_violation(violations: Float[np.ndarray, " limits"]) -> float:
    """Return the sum of all violations; 0 if all limits are kept, up to a tolerance.

    The sum, not the maximum: a limit that cannot be kept does not hide violations of the others.

    Args:
        violations: Largest violation of each limit, shape ``(k,)``.
    """
    return 0.0 if np.max(violations) <= VIOLATION_TOLERANCE else float(np.sum(np.maximum(violations, 0.0)))


class GainSearch:
    """Evaluator of points that counts rollouts and records the points that all members evaluated, the start first.

    Attributes:
        problem: The tuning problem.
        objective: Weights and limits.
        progress: Called with the number of rollouts so far and a cost.
        rollouts: Number of rollouts so far.
        history: A row (rollouts, cost) for each improvement.
        evaluated: Candidates that all members evaluated.
        reached: Points to which the local searches improved so far, also those of the searches that this one starts.
        scale: Terms at the start, by which they are divided, shape ``(5,)``.
        has_no_limits: Whether there are no limits and the settling time is not minimised.
        objective_without_limits: The objective without its limits.
    """

    def __init__(
        self,
        problem: TuningProblem,
        objective: Objective,
        progress: Callable[[int, float], None],
        settle: bool = False,
        reached: list[np.ndarray] | None = None,
    ) -> None:
        """Evaluate the start.

        Args:
            problem: The tuning problem.
            objective: Weights and limits.
            progress: Called with the number of rollouts so far and a cost.
            settle: Whether the settling time is minimised instead of the terms.
            reached: List for the points that are reached, that of the search that starts this one; a new one if not
                given.
        """
        self.reached: list[np.ndarray] = [] if reached is None else reached
        self.problem: TuningProblem = problem
        self.objective: Objective = objective
        self.progress: Callable[[int, float], None] = progress
        self.rollouts: int = 0
        self.history: list[Any] = []
        self.evaluated: list[Candidate] = []
        self._least: float = math.inf
        self._settles: bool = settle
        self._compiled: set[int] = set()  # numbers of members for which batches are compiled
        terms, violations = self.evaluate(problem.start[None])
        usable = np.isfinite(terms[0]) & (terms[0] > 0.0)
        self.scale: np.ndarray = np.where(usable, terms[0], 1.0)
        lower, upper = problem.loop.controller.limits
        command_range = float(upper) - float(lower)
        count = problem.reference.values.shape[0]
        if command_range < _UNBOUNDED_RANGE:
            self.scale[TERMS.index("effort")] = count * (_UNIT_MOVE * command_range) ** 2
        self.scale[TERMS.index("overshoot")] = 1.0
        self.has_no_limits: bool = not (settle or np.any(np.isfinite(np.asarray(objective.limits))))
        no_limits = jnp.full_like(objective.limits, jnp.inf)
        self.objective_without_limits: Any = eqx.tree_at(lambda o: o.limits, objective, no_limits)
        self.record(self._candidate(problem.start, terms[0], violations[0]))

    def evaluate(
        self, points: Float[np.ndarray, "points gains"], problem: TuningProblem | None = None
    ) -> tuple[Float[np.ndarray, "points terms"], Float[np.ndarray, "points limits"]]:
        """Evaluate points and count the rollouts.

        Args:
            points: Points of the unit box, shape ``(k, p)``.
            problem: Problem with the members to use; default: all members.

        Returns:
            Terms, not divided by those at the start, shape ``(k, 5)``, and largest violation of each limit, shape
            ``(k, 5)``; infinite where it is NaN.
        """
        members = problem or self.problem
        self.rollouts += len(points) * members.count
        terms, violations = evaluate_members(
            lambda batch: evaluate_points(members, jnp.asarray(batch), self.objective),
            points,
            min(BATCH, len(points)),
            new_program=members.count not in self._compiled,
        )
        if len(points) >= BATCH:
            self._compiled.add(members.count)
        return terms, np.nan_to_num(violations, nan=np.inf)

    def candidates(
        self, points: Float[np.ndarray, "points gains"], problem: TuningProblem | None = None
    ) -> list[Candidate]:
        """Evaluate points; they are recorded if all members evaluate them.

        Args:
            points: Points of the unit box, shape ``(k, p)``.
            problem: Problem with the members to use; default: all members.
        """
        candidates = [self._candidate(*row) for row in zip(points, *self.evaluate(points, problem), strict=True)]
        if problem is None or problem.count == self.problem.count:
            for candidate in candidates:
                self.record(candidate)
        return candidates

    def _candidate(self, point: np.ndarray, terms: np.ndarray, violations: np.ndarray) -> Candidate:
        cost = float(np.nan_to_num(terms @ (np.asarray(self.objective.weights) / self.scale), nan=np.inf))
        return Candidate(total_violation(violations), cost, point, violations)

    def record(self, candidate: Candidate) -> None:
        """Record a candidate that all members evaluated; improvements within all limits are added to the history."""
        if candidate.violation == 0.0 and candidate.cost < self._least and not self._settles:
            self._least = candidate.cost
            self.history.append((self.rollouts, candidate.cost))
        self.evaluated.append(candidate)

    def descend_in_trust_region(
        self, state: SearchState, problem: TuningProblem, min_radius: float, steps: int
    ) -> SearchState:
        """Minimise the logarithm of the cost without limits by gradients; see ``trust_region.descend``.

        Args:
            state: Start of the search.
            problem: Problem with the members to use.
            min_radius: Radius of the trust region that ends the search.
            steps: Largest number of steps.

        Returns:
            The state at the end, with the best point.
        """
        scale = jnp.asarray(self.scale)
        free = np.asarray(self.problem.upper > self.problem.lower)
        lowest = [math.inf]

        def log_cost_and_gradient(point: np.ndarray) -> tuple[float, np.ndarray]:
            """Evaluate the logarithm of the cost and its gradient; infinite where they are not finite."""
            value, derivative = _cost_and_gradient(problem, jnp.asarray(point), self.objective_without_limits, scale)
            self.rollouts += _GRADIENT_ROLLOUTS * problem.count
            cost, gradient = float(value), np.where(free, np.asarray(derivative), 0.0)
            if not (0.0 < cost < math.inf and np.all(np.isfinite(gradient))):
                return math.inf, np.zeros_like(point)
            if problem.count == self.problem.count and self.has_no_limits:
                self.record(Candidate(0.0, cost, point))
            if cost < lowest[0]:
                lowest[0] = cost
                self.reached.append(point)
            self.progress(self.rollouts, cost)
            return math.log(cost), gradient / cost

        return trust_region.descend(log_cost_and_gradient, state, min_radius, steps)

    def search_by_cobyqa(
        self,
        start: Float[np.ndarray, " gains"],
        problem: TuningProblem,
        radius: float,
        min_radius: float,
        evaluations: int,
    ) -> Candidate:
        """Minimise the cost without derivatives, within the limits if there are any, by SciPy's COBYQA.

        Args:
            start: Start in the unit box, shape ``(p,)``.
            problem: Problem with the members to use.
            radius: First radius of the trust region, in sizes of the box.
            min_radius: Last radius, in sizes of the box.
            evaluations: Largest number of evaluations.

        Returns:
            The best candidate, violations first.
        """
        free = np.asarray(problem.upper > problem.lower)
        limited = np.isfinite(np.asarray(self.objective.limits))
        best = self.candidates(start[None], problem)[0]
        max_cost = _MAX_COST_RATIO * min(best.cost, _OVERFLOW)
        cache = {start[free].tobytes(): best}  # COBYQA evaluates terms and limits of a point in separate calls

        def candidate_at(packed: bytes) -> Candidate:
            """Return the terms and limits at a point, evaluated once."""
            nonlocal best
            if packed in cache:
                return cache[packed]
            point = start.copy()
            point[free] = np.clip(np.frombuffer(packed), 0.0, 1.0)
            candidate = cache[packed] = self.candidates(point[None], problem)[0]
            if rank(candidate) < rank(best):
                best = candidate
                self.reached.append(point)
            self.progress(self.rollouts, best.cost)
            return candidate

        constraint = scipy.optimize.NonlinearConstraint(
            lambda x: np.minimum(candidate_at(x.tobytes()).violations[limited], _MAX_VIOLATION), -np.inf, 0.0
        )
        scipy.optimize.minimize(
            lambda x: math.log(max(min(candidate_at(x.tobytes()).cost, max_cost), 1e-300)),
            start[free],
            method="COBYQA",
            bounds=[(0.0, 1.0)] * int(np.sum(free)),
            constraints=[constraint] if np.any(limited) else (),
            options={"initial_tr_radius": radius, "final_tr_radius": min_radius, "maxfev": evaluations},
        )
        return best

    def best(self) -> Candidate:
        """Return the best candidate that all members evaluated.

        Raises:
            NumericsError: if no candidate has a finite cost.
        """
        return self.require_cost(min(self.evaluated, key=rank))

    def require_cost(self, candidate: Candidate) -> Candidate:
        """Return a candidate if its cost is finite.

        Raises:
            NumericsError: if the cost is not finite.
        """
        if not math.isfinite(candidate.cost):
            raise NumericsError(
                "the closed loop has no finite cost with the start gains, nor with any other gains that were tried: "
                "start from smaller gains",
                {name: float(v) for name, v in self.problem.gains(candidate.point).items()},
            )
        return candidate
