"""Searches that are repeated until the gains keep the limits, follow the reference and are stable, as far as possible.

Repeated searches use more starts, or a larger weight of the effort.
"""

from collections.abc import Mapping
from dataclasses import replace
from typing import Any, NamedTuple

from smajax.control.analysis.closed_loop_checks import GainEvaluation, evaluate_gains, fails_to_track
from smajax.control.analysis.reachable_range import ReachableRange
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.task import TuningTask
from smajax.control.tuning.tune import TuningResult, tune, violation_rank
from smajax.progress import PhasesAndSteps

# All constants were chosen by trial; tests/unit/control/test_tuning.py holds them.

# Number of starts of a search after one with fewer starts whose gains violate a limit or do not follow the reference.
_MORE_STARTS = 4
# Largest number of searches with an increased weight of the effort, the factor of the weight, and the weight that is
# increased if the given one is smaller.
_EFFORT_INCREASES = 3
_EFFORT_FACTOR = 10.0
_MIN_EFFORT_WEIGHT = 0.01


class SearchOutcome(NamedTuple):
    """Outcome of a search.

    Attributes:
        result: The best gains.
        evaluation: Behaviour of the rig's own plant with these gains.
        weights: Weights of the objective with which they were found, by name.
    """

    result: TuningResult
    evaluation: GainEvaluation
    weights: Mapping[str, float]


def search_gains(
    task: TuningTask, problem: TuningProblem, reachable: ReachableRange, seed: int, progress: PhasesAndSteps
) -> SearchOutcome:
    """Tune the gains; repeat from more starts, or with a larger weight of the effort, if the gains are not good enough.

    More starts are used if the gains violate a limit or do not follow the reference. The weight of the effort is
    increased if they are unstable.

    Args:
        task: The tuning task.
        problem: The tuning problem.
        reachable: Range of the channel that the rig reaches.
        seed: Seed of the random starts.
        progress: Receives the phases and steps of the search; a ``KeyboardInterrupt`` of it ends the search with the
            best gains so far.

    Returns:
        The best gains; their number of rollouts is that of all searches.

    Raises:
        InputError: if there is no objective, or the reference has no jump to settle after.
        NumericsError: if no point has a finite cost.
    """
    result = _search(task, problem, task.starts, seed, progress)
    evaluation = evaluate_gains(task, result.gains)
    failure = ""
    if result.interrupted:
        return SearchOutcome(result, evaluation, task.weights)
    if not result.feasible:
        failure = "keep all limits yet"
    elif fails_to_track(task, evaluation, reachable):
        failure = "follow the reference yet"
    if failure and task.starts < _MORE_STARTS:
        if _is_stopped(progress, f"no gains {failure}: searching from more starts"):
            return SearchOutcome(result._replace(interrupted=True), evaluation, task.weights)
        other = _search(task, problem, _MORE_STARTS, seed, progress)
        better = min(result, other, key=lambda candidate: _rank(task, candidate))
        result = better._replace(rollouts=result.rollouts + other.rollouts, interrupted=other.interrupted)
        evaluation = evaluate_gains(task, result.gains)
    outcome = SearchOutcome(result, evaluation, task.weights)
    if result.interrupted:
        return outcome
    if evaluation.unstable or evaluation.margins.unstable:
        return _increase_effort_weight(task, problem, outcome, reachable, seed, progress)
    return outcome


def _is_stopped(progress: PhasesAndSteps, phase: str) -> bool:
    """Report a phase, and return whether that was answered by a request to stop."""
    try:
        progress.phase(phase, can_stop=True)
    except KeyboardInterrupt:
        return True
    return False


def _search(task: TuningTask, problem: TuningProblem, starts: int, seed: int, progress: PhasesAndSteps) -> TuningResult:
    return tune(
        problem,
        task.weights,
        task.limits,
        settle=task.settle,
        population="none" if task.settle else "all",
        starts=starts,
        seed=seed,
        band=task.band,
        progress=lambda count, cost: progress.step(f"tuning: {count} rollouts, cost {cost:.4g}", count),
    )


def _rank(task: TuningTask, result: TuningResult) -> tuple[Any, ...]:
    """Sort key of results: violated limits first, then the objective; smaller is better."""
    if not result.feasible:
        return violation_rank(result)
    cost = sum(weight * result.terms[name] for name, weight in task.weights.items())
    return False, 0.0, result.settling if task.settle else cost


def _increase_effort_weight(
    task: TuningTask,
    problem: TuningProblem,
    before: SearchOutcome,
    reachable: ReachableRange,
    seed: int,
    progress: PhasesAndSteps,
) -> SearchOutcome:
    """Outcome of searches with an increasing weight of the effort, until rollout and margins are stable.

    Gains that do not follow the reference, or violate limits more than those before, are not used; the previous outcome
    is returned if there are no others.
    """
    rollouts, weights, interrupted = before.result.rollouts, task.weights, False
    # Weights have no influence on the shortest settling time.
    for _ in range(0 if task.settle else _EFFORT_INCREASES):
        weights = {**weights, "effort": _EFFORT_FACTOR * max(weights.get("effort", 0.0), _MIN_EFFORT_WEIGHT)}
        phase = f"the gains are unstable in a rollout or when linearised: effort weight {weights['effort']:g}"
        if interrupted := _is_stopped(progress, phase):
            break
        starts = max(_MORE_STARTS, task.starts)
        result = _search(replace(task, weights=weights), problem, starts, seed, progress)
        rollouts += result.rollouts
        evaluation = evaluate_gains(task, result.gains)
        stable = not evaluation.unstable and not evaluation.margins.unstable
        if (
            stable
            and not fails_to_track(task, evaluation, reachable)
            and violation_rank(result)[:2] <= violation_rank(before.result)[:2]
        ):
            return SearchOutcome(result._replace(rollouts=rollouts), evaluation, weights)
        if interrupted := result.interrupted:
            break
    return before._replace(result=before.result._replace(rollouts=rollouts, interrupted=interrupted))
