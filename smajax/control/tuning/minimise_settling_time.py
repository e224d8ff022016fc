"""Gains that settle as soon as possible, or soon enough: the discontinuous settling time has its own search."""

import equinox as eqx
import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.analysis.step_response import step_responses
from smajax.control.tuning.objective import LIMITS, Objective, evaluate_objective, make_objective
from smajax.control.tuning.problem import TuningProblem, simulate_gains
from smajax.control.tuning.search import VIOLATION_TOLERANCE, Candidate, GainSearch, rank, total_violation
from smajax.control.tuning.settling_slp import LinearisedResponse, linearise, settling_slp
from smajax.control.tuning.unconstrained import COBYQA_ALL_MEMBERS

# Weights of the terms that are minimised before the settling time is: ITAE, since its minimum settles without a long
# tail.
START_WEIGHTS = {"itae": 1.0}
# Steps of that search, and the factor of the coordinates, which bounds its first step; chosen by
# experiments/papers/hip/hip_gains.py.
_STEPS = 10
_COORDINATE_SCALE = 5.0
# Largest number of evaluations of the settling time; the search ends by itself earlier as a rule.
_EVALUATIONS = 32


def minimise_without_limits(search: GainSearch, points: np.ndarray) -> np.ndarray:
    """Return the point, ``(p,)``, with the smallest terms without limits, of searches from ``points``, ``(k, p)``."""
    objective, multipliers = search.objective_without_limits, search.zero_multipliers
    best = min(
        (search.descend_by_lbfgs(p, objective, multipliers, 1.0, _STEPS, _COORDINATE_SCALE) for p in points),
        key=lambda candidate: candidate.cost,
    )
    return search.require_cost(best).point


def minimise_settling_time(search: GainSearch, start: np.ndarray) -> np.ndarray:
    """Return the point, shape ``(p,)``, with the shortest settling time within the other limits."""
    problem = search.problem
    jumps = problem.jumps
    response = _ErrorAndViolations(problem, search.objective)

    def linearised_at(point: np.ndarray) -> LinearisedResponse:
        search.rollouts += problem.count * (1 + len(point))
        return linearise(response, point)

    def report(point: np.ndarray, latest: float, violation: float) -> None:
        search.progress(search.rollouts, latest)
        if violation <= VIOLATION_TOLERANCE:
            search.history.append((search.rollouts, latest))

    span = np.log(np.asarray(problem.upper / problem.lower))
    period = problem.reference.period
    return settling_slp(linearised_at, start, span, jumps, search.objective, period, report, evaluations=_EVALUATIONS)


def meet_settling_limit(search: GainSearch, point: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Return a point that settles in time, with small terms, or the one that settles first.

    The violation of a settling limit says little about how to settle sooner, so that this has a search of its own,
    within the other limits.

    Args:
        search: The search.
        point: The point so far, which is returned if it keeps all limits.
        points: Starts, shape ``(k, p)``.
    """
    place, spent = LIMITS.index("settling"), search.rollouts
    before = search.candidates(point[None])[0]
    if before.violation == 0.0:
        return point
    without_settling = eqx.tree_at(
        lambda o: (o.weights, o.limits),
        search.objective,
        (make_objective(START_WEIGHTS, {}).weights, search.objective.limits.at[place].set(jnp.inf)),
    )
    settling_search = GainSearch(
        search.problem, without_settling, lambda count, cost: search.progress(spent + count, cost), settle=True
    )
    sooner = minimise_settling_time(settling_search, minimise_without_limits(settling_search, points))
    search.rollouts += settling_search.rollouts
    after = search.candidates(sooner[None])[0]
    if after.violation == 0.0:
        refined = search.search_by_cobyqa(sooner, search.problem, *COBYQA_ALL_MEMBERS)
        return min(after, refined, key=rank).point

    def settling_rank(candidate: Candidate) -> tuple[float, float]:
        others = total_violation(np.delete(candidate.violations, place))
        return others, longest_settling(search.problem, candidate.point, search.objective.band)

    return min(before, after, key=settling_rank).point


class _ErrorAndViolations(eqx.Module):
    """Maps a point to the error over the jump, shape ``(m, n)``, and the violations, shape ``(m, 5, n)``."""

    problem: TuningProblem
    objective: Objective

    def __call__(self, point: jax.Array) -> tuple[jax.Array, jax.Array]:
        problem, reference = self.problem, self.problem.reference
        rollouts = problem.simulate(problem.gains(point))._replace(final_states=None)
        after_jump = reference.jump_size != 0.0
        sizes = jnp.where(after_jump, reference.jump_size, 1.0)
        share = jax.vmap(lambda values: jnp.where(after_jump, (values - reference.values) / sizes, 0.0))(
            rollouts.channels[reference.channel]
        )
        violations = jax.vmap(lambda rollout: evaluate_objective(rollout, reference, self.objective).violations)
        return share, violations(rollouts)


def longest_settling(problem: TuningProblem, point: np.ndarray, band: float) -> float:
    """Return the longest settling time of all jumps and members at a point, s; 0 without any jump."""
    signal, jumps = problem.reference, problem.jumps
    values = np.asarray(simulate_gains(problem, problem.gains(point)).channels[signal.channel])
    reference = np.asarray(signal.values)
    times = [r.settling for v in values for r in step_responses(v, reference, jumps, signal.period, band)]
    return max(times, default=0.0)
