"""The search for gains: cost and gradient at a point, evaluated points, rollouts, and three local searches.

A point lies in the unit box: the logarithms of the gains between their bounds. Terms and limits (``objective``) make
one cost, whose gradient by reverse mode costs the same whatever the number of gains. Several members (plants, draws of
the noise) are simulated as one batch and count equally; a search may use some of them only.
"""

import contextlib
import math
from collections.abc import Callable
from typing import NamedTuple

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
import scipy.optimize

from smajax.control.tuning import trust_region
from smajax.control.tuning.objective import LIMITS, TERMS, Objective, residual
from smajax.control.tuning.problem import TuningProblem, evaluate_points
from smajax.control.tuning.trust_region import SearchState
from smajax.errors import NumericsError

# Points that are evaluated together.
BATCH = 8
# A violation that counts as none: limits are sampled, and a search ends at them.
VIOLATION_TOLERANCE = 1e-3
# Rollouts that a gradient by reverse mode counts as: 2.6 to 2.9 were measured.
_GRADIENT_ROLLOUTS = 3
# Largest slope, costs being near 1: steeper ones are of unstable loops, and would end a line search.
_MAX_SLOPE = 100.0
# A slope that means nothing, and how many of them end a search; test_slopes_that_tell_nothing_end_the_search of
# tests/unit/control/test_tuning.py holds them.
_MEANINGLESS_SLOPE = 1e6
_MAX_MEANINGLESS = 3
# Cost that stands for an overflow.
_OVERFLOW = 1e30
# A move of the command that counts as one, as a share of its range, and a range that counts as none.
_UNIT_MOVE = 0.01
_NO_RANGE = 1e6
# Relative decrease of the cost that ends L-BFGS-B; chosen by trial.
_COST_TOLERANCE = 1e-4
# Bounds of violations and of the cost (over the first one) that COBYQA sees, so that a cliff does not distort its
# quadratic models; test_quadratics_lead_on_where_slopes_tell_nothing of tests/unit/control/test_tuning.py holds them.
_MAX_VIOLATION = 10.0
_MAX_COST_RATIO = 100.0


class _CostArguments(NamedTuple):
    """What the cost takes next to the point; arrays, so that other values need no other program."""

    problem: TuningProblem
    objective: Objective
    scale: jax.Array
    multipliers: jax.Array
    mu: jax.Array


@eqx.filter_jit
def _cost_and_gradient(point: jax.Array, arguments: _CostArguments) -> tuple[jax.Array, jax.Array]:
    """The sum of squares of all residuals, mean over the members, and its gradient."""
    objective, scale, mu = arguments.objective, arguments.scale, arguments.mu

    def cost(point: jax.Array) -> jax.Array:
        evaluated = arguments.problem.objective_terms(point, objective)
        residuals = jax.vmap(lambda e, m: residual(e, scale, objective, m, mu))(evaluated, arguments.multipliers)
        return jnp.sum(residuals**2) / residuals.shape[0]

    return jax.value_and_grad(cost)(point)


@eqx.filter_jit
def limit_violations(problem: TuningProblem, point: jax.Array, objective: Objective) -> jax.Array:
    """Return the violations of the limits at a point, shape ``(m, 5, n)``."""
    return problem.objective_terms(point, objective).violations


class _MeaninglessSlopes(Exception):
    """Ends a search among slopes that mean nothing."""


class Candidate(NamedTuple):
    """An evaluated point.

    Args:
        violation: Total violation of the limits; 0 if all are kept.
        cost: Weighted terms.
        point: The point, shape ``(p,)``.
        violations: Largest violation of each limit, shape ``(5,)``; 0 where it was not evaluated.
    """

    violation: float
    cost: float
    point: np.ndarray
    violations: np.ndarray = np.zeros(len(LIMITS))


def rank(candidate: Candidate) -> tuple[float, float]:
    """Return the key by which candidates are compared: violation first, then cost."""
    return candidate.violation, candidate.cost


def total_violation(violations: np.ndarray) -> float:
    """Return the sum of all violations, so that a limit that cannot be kept does not hide others; 0 if all are kept."""
    return 0.0 if np.max(violations) <= VIOLATION_TOLERANCE else float(np.sum(np.maximum(violations, 0.0)))


class GainSearch:
    """Evaluates points, counts rollouts and records the points that all members evaluated, the start first.

    Attributes:
        rollouts: Number of rollouts so far.
        history: A row (rollouts, cost) for each improvement.
        evaluated: Candidates of all members.
        scale: Terms at the start, shape ``(4,)``.
        has_no_limits: Whether the terms are all that counts.
        zero_multipliers: Multipliers of no limit, shape ``(m, 5, n)``.
        objective_without_limits: The objective without its limits.
    """

    def __init__(
        self,
        problem: TuningProblem,
        objective: Objective,
        progress: Callable[[int, float], None],
        settle: bool = False,
    ) -> None:
        """Evaluate the start.

        Args:
            problem: The tuning problem.
            objective: Weights and limits.
            progress: Called with the rollouts so far and a cost.
            settle: Whether the settling time is minimised, not the terms.
        """
        self.problem, self.objective, self.progress = problem, objective, progress
        self.rollouts, self.history = 0, []
        self.evaluated: list[Candidate] = []
        terms, violations = self.evaluate(problem.start[None])
        usable = np.isfinite(terms[0]) & (terms[0] > 0.0)
        self.scale = np.where(usable, terms[0], 1.0)
        pid = problem.loop.controller.inner
        command_range = float(pid.upper) - float(pid.lower)
        count = problem.reference.values.shape[0]
        if command_range < _NO_RANGE:
            self.scale[TERMS.index("effort")] = count * (_UNIT_MOVE * command_range) ** 2
        self.has_no_limits = not (settle or np.any(np.isfinite(np.asarray(objective.limits))))
        self.zero_multipliers = jnp.zeros((problem.count, len(LIMITS), count))
        no_limits = jnp.full_like(objective.limits, jnp.inf)
        self.objective_without_limits = eqx.tree_at(lambda o: o.limits, objective, no_limits)
        self.record(self._candidate(problem.start, terms[0], violations[0]))

    def evaluate(self, points: np.ndarray, problem: TuningProblem | None = None) -> tuple[np.ndarray, np.ndarray]:
        """Return terms, ``(k, 4)``, and violations, ``(k, 5)``, at points by all members, or by those of a problem."""
        problem = problem or self.problem
        self.rollouts += len(points) * problem.count
        terms, violations = evaluate_points(problem, jnp.asarray(points), self.objective)
        return np.asarray(terms), np.nan_to_num(np.asarray(violations), nan=np.inf)

    def candidates(self, points: np.ndarray, problem: TuningProblem | None = None) -> list[Candidate]:
        """Evaluate points by all members, which records them, or by those of a problem."""
        candidates = [self._candidate(*row) for row in zip(points, *self.evaluate(points, problem), strict=True)]
        if problem is None or problem.count == self.problem.count:
            for candidate in candidates:
                self.record(candidate)
        return candidates

    def _candidate(self, point: np.ndarray, terms: np.ndarray, violations: np.ndarray) -> Candidate:
        cost = float(np.nan_to_num(terms @ (np.asarray(self.objective.weights) / self.scale), nan=np.inf))
        return Candidate(total_violation(violations), cost, point, violations)

    def record(self, candidate: Candidate) -> None:
        """Record a candidate of all members; without limits an improvement goes into the history."""
        if self.has_no_limits and candidate.cost < min((c.cost for c in self.evaluated), default=math.inf):
            self.history.append((self.rollouts, candidate.cost))
        self.evaluated.append(candidate)

    def descend_in_trust_region(
        self, state: SearchState, problem: TuningProblem, min_radius: float, steps: int
    ) -> SearchState:
        """Minimise the logarithm of the cost without limits by gradients; see ``trust_region.descend``.

        Args:
            state: Start of the search.
            problem: The members that are used.
            min_radius: Radius that ends the search.
            steps: Largest number of steps.
        """
        multipliers = self.zero_multipliers[: problem.count]
        arguments = _CostArguments(
            problem, self.objective_without_limits, jnp.asarray(self.scale), multipliers, jnp.asarray(1.0)
        )
        free = np.asarray(self.problem.upper > self.problem.lower)

        def log_cost_and_gradient(point: np.ndarray) -> tuple[float, np.ndarray]:
            value, slope = _cost_and_gradient(jnp.asarray(point), arguments)
            self.rollouts += _GRADIENT_ROLLOUTS * problem.count
            cost, gradient = float(value), np.where(free, np.asarray(slope), 0.0)
            if not (0.0 < cost < math.inf and np.all(np.isfinite(gradient))):
                return math.inf, np.zeros_like(point)
            if problem.count == self.problem.count:
                self.record(Candidate(0.0, cost, point))
            self.progress(self.rollouts, cost)
            return math.log(cost), gradient / cost

        return trust_region.descend(log_cost_and_gradient, state, min_radius, steps)

    def descend_by_lbfgs(
        self,
        start: np.ndarray,
        objective: Objective,
        multipliers: jax.Array,
        mu: float,
        steps: int,
        scale: float,
        max_distance: float = 1.0,
    ) -> Candidate:
        """Minimise the augmented Lagrangian by SciPy's L-BFGS-B with all members.

        Args:
            start: The start, shape ``(p,)``.
            objective: Weights and limits.
            multipliers: Multipliers of the limits, shape ``(m, 5, n)``.
            mu: Penalty.
            steps: Largest number of steps.
            scale: Factor of the coordinates: the first step has a length of at most one over it.
            max_distance: Largest distance from the start in each coordinate.

        Returns:
            The best point with the cost of terms and limits together (infinite if no point gave numbers); its violation
            is 0.
        """
        arguments = _CostArguments(self.problem, objective, jnp.asarray(self.scale), multipliers, jnp.asarray(mu))
        best = Candidate(0.0, math.inf, start)
        free, meaningless = np.asarray(self.problem.upper > self.problem.lower), 0

        def cost_and_gradient(x: np.ndarray) -> tuple[float, np.ndarray]:
            nonlocal best, meaningless
            value, slope = _cost_and_gradient(jnp.asarray(x / scale), arguments)
            self.rollouts += _GRADIENT_ROLLOUTS * self.problem.count
            cost, gradient = float(value), np.where(free, np.asarray(slope), 0.0) / scale
            if not (math.isfinite(cost) and np.all(np.isfinite(gradient))):
                return _OVERFLOW, np.zeros_like(x)
            if cost < best.cost:
                best = Candidate(0.0, cost, x / scale)
                self.progress(self.rollouts, cost)
            largest = scale * float(np.max(np.abs(gradient)))
            meaningless += largest > _MEANINGLESS_SLOPE
            if meaningless == _MAX_MEANINGLESS:
                raise _MeaninglessSlopes
            return cost, gradient * min(1.0, _MAX_SLOPE / max(1e-300, largest))

        low, high = np.maximum(0.0, start - max_distance) * scale, np.minimum(1.0, start + max_distance) * scale
        options = {"maxiter": steps, "maxfun": 2 * steps, "ftol": _COST_TOLERANCE}
        bounds = list(zip(low, high, strict=True))
        with contextlib.suppress(_MeaninglessSlopes):
            scipy.optimize.minimize(
                cost_and_gradient, start * scale, jac=True, method="L-BFGS-B", bounds=bounds, options=options
            )
        return best

    def search_by_cobyqa(
        self, start: np.ndarray, problem: TuningProblem, radius: float, min_radius: float, evaluations: int
    ) -> Candidate:
        """Search without derivatives, within the limits if there are any, by SciPy's COBYQA.

        Args:
            start: The start, shape ``(p,)``.
            problem: The members that are used.
            radius: First radius of the trust region.
            min_radius: Last radius.
            evaluations: Largest number of evaluations.
        """
        free = np.asarray(problem.upper > problem.lower)
        limited = np.isfinite(np.asarray(self.objective.limits))
        best = self.candidates(start[None], problem)[0]
        max_cost = _MAX_COST_RATIO * min(best.cost, _OVERFLOW)
        known = {start[free].tobytes(): best}  # COBYQA asks for terms and limits of a point one after the other

        def candidate_at(packed: bytes) -> Candidate:
            nonlocal best
            if packed in known:
                return known[packed]
            point = start.copy()
            point[free] = np.clip(np.frombuffer(packed), 0.0, 1.0)
            candidate = known[packed] = self.candidates(point[None], problem)[0]
            if rank(candidate) < rank(best):
                best = candidate
                if candidate.violation == 0.0 and not self.has_no_limits and problem.count == self.problem.count:
                    self.history.append((self.rollouts, candidate.cost))
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
        """Return the best candidate of all members. Raises ``NumericsError`` if none has a cost."""
        return self.require_cost(min(self.evaluated, key=rank))

    def require_cost(self, candidate: Candidate) -> Candidate:
        """Return a candidate that has a finite cost. Raises ``NumericsError`` if it has none."""
        if not math.isfinite(candidate.cost):
            raise NumericsError(
                "the closed loop does not give numbers from the start gains, nor from any that was drawn: start from "
                "smaller gains",
                {name: float(v) for name, v in self.problem.gains(candidate.point).items()},
            )
        return candidate
