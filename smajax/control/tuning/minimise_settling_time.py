"""Gains with the shortest settling time, or one below a limit: the discontinuous settling time has its own search."""

import dataclasses
import math

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Float

from smajax.control.analysis.step_response import step_responses
from smajax.control.tuning.constrained import constrained
from smajax.control.tuning.objective import LIMITS, Objective, evaluate_objective, make_objective
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.search import VIOLATION_TOLERANCE, Candidate, GainSearch, rank, total_violation
from smajax.control.tuning.settling_slp import LinearisedResponse, linearise, settling_slp
from smajax.control.tuning.trust_region import SearchState
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS

# Weights of the terms that are minimised before the settling time: ITAE, since its minimum settles without a slow
# final approach.
START_WEIGHTS = {"itae": 1.0}
# Largest number of steps of that search, and first and last radius of its trust region; chosen by
# experiments/papers/hip/hip_gains.py.
_STEPS = 10
_RADIUS = 0.1
_MIN_RADIUS = 1e-3
# Largest number of evaluations of the settling time; as a rule the search converges earlier.
_EVALUATIONS = 32


def minimise_without_limits(
    search: GainSearch, points: Float[np.ndarray, "starts gains"]
) -> Float[np.ndarray, " gains"]:
    """Minimise the terms without limits by gradients from several starts.

    Args:
        search: The search.
        points: Starts in the unit box, shape ``(k, p)``.

    Returns:
        The best point, shape ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
    """
    states = [
        search.descend_in_trust_region(SearchState(p, math.inf, None, _RADIUS), search.problem, _MIN_RADIUS, _STEPS)
        for p in points
    ]
    best = min(states, key=lambda state: state.cost)
    return search.require_cost(Candidate(0.0, math.exp(best.cost), best.point)).point


def minimise_settling_time(search: GainSearch, start: Float[np.ndarray, " gains"]) -> Float[np.ndarray, " gains"]:
    """Minimise the settling time within the other limits.

    Args:
        search: The search.
        start: Start in the unit box, shape ``(p,)``.

    Returns:
        The best point, shape ``(p,)``.
    """
    problem = search.problem
    jumps = problem.jumps
    response = _ErrorAndViolations(problem, search.objective)

    def linearised_at(point: np.ndarray) -> LinearisedResponse:
        search.rollouts += problem.count * (1 + len(point))
        return linearise(response, point)

    def report(point: np.ndarray, latest: float, violation: float) -> None:
        search.reached.append(point)
        search.progress(search.rollouts, latest)
        if violation <= VIOLATION_TOLERANCE:
            search.history.append((search.rollouts, latest))

    span = np.log(np.asarray(problem.upper / problem.lower))
    period = problem.reference.period
    return settling_slp(linearised_at, start, span, jumps, search.objective, period, report, evaluations=_EVALUATIONS)


def settle_within_limits(search: GainSearch, points: Float[np.ndarray, "starts gains"]) -> Float[np.ndarray, " gains"]:
    """Minimise the settling time within the other limits, from the smallest terms without limits or within them.

    The search from the smallest terms without limits may end outside the limits. Then the terms are minimised within
    the limits first, and the settling time from there.

    Args:
        search: The search.
        points: Starts in the unit box, shape ``(k, p)``.

    Returns:
        The point with the shortest settling time that keeps the limits, or the one with the smallest violation, shape
        ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
    """
    first = minimise_settling_time(search, minimise_without_limits(search, points))
    if search.candidates(first[None])[0].violation == 0.0:
        return first
    kept = constrained(search, points)
    found = search.candidates(np.stack([first, kept, minimise_settling_time(search, kept)]))
    return min((*found, search.evaluated[0]), key=lambda candidate: settling_rank(search, candidate)).point


def settling_rank(search: GainSearch, candidate: Candidate) -> tuple[float, float]:
    """Return the sort key of candidates: violation first, then the longest settling time; smaller is better."""
    return candidate.violation, longest_settling(search.problem, candidate.point, search.objective.band)


def meet_settling_limit(
    search: GainSearch, point: Float[np.ndarray, " gains"], points: Float[np.ndarray, "starts gains"]
) -> Float[np.ndarray, " gains"]:
    """Find a point that keeps a limit on the settling time, with small terms.

    The gradient of the settling limit's violation does not lead to shorter settling times, so the settling time is
    minimised within the other limits.

    Args:
        search: The search.
        point: The best point so far, shape ``(p,)``; it is returned if it keeps all limits.
        points: Starts in the unit box, shape ``(k, p)``.

    Returns:
        A point that keeps all limits, or the one with the shortest settling time, shape ``(p,)``.

    Raises:
        NumericsError: if no point has a finite cost.
    """
    place, previous_rollouts = LIMITS.index("settling"), search.rollouts
    before = search.candidates(point[None])[0]
    if before.violation == 0.0:
        return point
    without_settling = eqx.tree_at(
        lambda o: (o.weights, o.limits),
        search.objective,
        (make_objective(START_WEIGHTS, {}).weights, search.objective.limits.at[place].set(jnp.inf)),
    )
    settling_search = GainSearch(
        search.problem,
        without_settling,
        lambda count, cost: search.progress(previous_rollouts + count, cost),
        settle=True,
        reached=search.reached,
    )
    fastest_point = minimise_settling_time(settling_search, minimise_without_limits(settling_search, points))
    search.rollouts += settling_search.rollouts
    after = search.candidates(fastest_point[None])[0]
    if after.violation == 0.0:
        refined = search.search_by_cobyqa(fastest_point, search.problem, *COBYQA_ALL_MEMBERS)
        return min(after, refined, key=rank).point

    def rank_at_limit(candidate: Candidate) -> tuple[float, float]:
        others = total_violation(np.delete(candidate.violations, place))
        return others, longest_settling(search.problem, candidate.point, search.objective.band)

    return min(before, after, key=rank_at_limit).point


class _ErrorAndViolations(eqx.Module):
    """Function of a point: the error over the jump, shape ``(m, n)``, and the violations, shape ``(m, 5, n)``."""

    problem: TuningProblem
    objective: Objective

    def __call__(
        self, point: Float[Array, " gains"]
    ) -> tuple[Float[Array, "members samples"], Float[Array, "members limits samples"]]:
        problem, reference = self.problem, self.problem.reference
        rollouts = dataclasses.replace(problem.simulate(problem.gains(point)), final_states=None)
        after_jump = reference.jump_size != 0.0
        sizes = jnp.where(after_jump, reference.jump_size, 1.0)
        share = jax.vmap(lambda values: jnp.where(after_jump, (values - reference.values) / sizes, 0.0))(
            rollouts.channels[reference.channel]
        )
        violations = jax.vmap(lambda rollout: evaluate_objective(rollout, reference, self.objective).violations)
        return share, violations(rollouts)


def longest_settling(problem: TuningProblem, point: Float[np.ndarray, " gains"], band: float) -> float:
    """Compute the longest settling time of all jumps and members at a point.

    Args:
        problem: The tuning problem.
        point: A point of the unit box, shape ``(p,)``.
        band: Settling band as a share of the jump.

    Returns:
        The settling time in s; infinite if a response does not settle, 0 without any jump.
    """
    signal, jumps = problem.reference, problem.jumps
    values = np.asarray(simulate_gains(problem, problem.gains(point)).channels[signal.channel])
    reference = np.asarray(signal.values)
    times = [r.settling for v in values for r in step_responses(v, reference, jumps, signal.period, band)]
    return max(times, default=0.0)
