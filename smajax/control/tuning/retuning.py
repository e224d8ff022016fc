"""Searches that are repeated until the gains keep the limits, follow the reference and are stable, as far as possible.

What is changed from one search to the next: more starts where few were asked for, more weight of the effort, and the
draws that fail.
"""

import math
from collections.abc import Mapping
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from smajax.control.analysis.closed_loop_checks import (
    DrawChecks,
    GainEvaluation,
    check_draws,
    evaluate_gains,
    fails_to_track,
)
from smajax.control.analysis.reachable_range import ReachableRange
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.task import TuningTask
from smajax.control.tuning.tune import TuningResult, tune, violation_rank
from smajax.progress import Progress

# All constants were chosen by trial; tests/unit/control/test_tuning.py holds them.

# Searches for draws that fail.
_RETUNINGS = 3
# Starts of a search where fewer do not keep all limits or do not follow the reference.
_MORE_STARTS = 4
# A limit that the worst draw exceeds is tightened by this factor of the excess.
_TIGHTENING = 1.5
# Smallest and largest tightening, as shares of the limit.
_MIN_TIGHTENING = 0.005
_MAX_TIGHTENING = 0.5
# Searches with more weight of the effort, the factor of the weight, and the weight that is increased where there is
# less.
_EFFORT_INCREASES = 3
_EFFORT_FACTOR = 10.0
_MIN_EFFORT_WEIGHT = 0.01


class SearchOutcome(NamedTuple):
    """Outcome of a search.

    Args:
        result: The best gains.
        evaluation: How the rig's own plant behaves with them.
        weights: Weights with which they were found.
    """

    result: TuningResult
    evaluation: GainEvaluation
    weights: Mapping[str, float]


def search_gains(
    task: TuningTask, problem: TuningProblem, reachable: ReachableRange, seed: int, progress: Progress
) -> SearchOutcome:
    """Search from the given number of starts, or from more where gains violate a limit or do not follow the reference.

    Args:
        task: The tuning task.
        problem: The tuning problem.
        reachable: Range that the rig reaches.
        seed: Seed of the random starts.
        progress: Where the phases of the search are reported.
    """
    result = _search(task, problem, task.starts, seed, progress)
    evaluation = evaluate_gains(task, result.gains)
    failure = ""
    if not result.feasible:
        failure = "keep all limits yet"
    elif fails_to_track(task, evaluation, reachable):
        failure = "follow the reference yet"
    if failure and task.starts < _MORE_STARTS:
        progress.phase(f"no gains {failure}: searching from more starts")
        other = _search(task, problem, _MORE_STARTS, seed, progress)
        better = min(result, other, key=lambda candidate: _rank(task, candidate))
        result = better._replace(rollouts=result.rollouts + other.rollouts)
        evaluation = evaluate_gains(task, result.gains)
    outcome = SearchOutcome(result, evaluation, task.weights)
    if evaluation.unstable or evaluation.margins.unstable:
        return _increase_effort_weight(task, problem, outcome, reachable, seed, progress)
    return outcome


def _search(task: TuningTask, problem: TuningProblem, starts: int, seed: int, progress: Progress) -> TuningResult:
    return tune(
        problem,
        task.weights,
        task.limits,
        settle=task.settle,
        starts=starts,
        seed=seed,
        band=task.band,
        progress=lambda count, cost: progress.step(f"{count} rollouts, cost {cost:.4g}"),
    )


def _rank(task: TuningTask, result: TuningResult) -> tuple:
    """The key by which searches are compared: violated limits first, then the objective."""
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
    progress: Progress,
) -> SearchOutcome:
    """Searches with more and more weight of the effort until the gains are stable, rollout and margins.

    Gains that do not follow the reference, or violate limits more, do not count; the outcome before is kept if there
    are no others.
    """
    rollouts, weights = before.result.rollouts, task.weights
    # Weights have no influence on the shortest settling time.
    for _ in range(0 if task.settle else _EFFORT_INCREASES):
        weights = {**weights, "effort": _EFFORT_FACTOR * max(weights.get("effort", 0.0), _MIN_EFFORT_WEIGHT)}
        progress.phase(f"the gains found are unstable, or nearly so: giving effort the weight {weights['effort']:g}")
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
    return before._replace(result=before.result._replace(rollouts=rollouts))


def retune_on_failing_draws(
    task: TuningTask,
    problem: TuningProblem,
    result: TuningResult,
    checks: Mapping[str, DrawChecks],
    draws: Mapping[str, np.ndarray],
    seed: int,
    progress: Progress,
) -> tuple[TuningResult, DrawChecks]:
    """Tune again, a few times, for the draws that fail, together with some of those that the gains were tuned for.

    A limit that some draws still exceed after that is tightened by the excess, and by half as much more. Gains that
    follow the reference worse than the start gains are not used.

    Args:
        task: The tuning task.
        problem: The tuning problem so far.
        result: The gains so far.
        checks: Checks of the ``start`` gains and of the ``tuned`` ones.
        draws: Samples of parameters, internal units, shape ``(count,)`` each.
        seed: Seed of the random starts.
        progress: Where the phases are reported.

    Returns:
        The gains with the fewest failing draws, and their checks.
    """
    count, limits, checked = problem.count, dict(task.limits), checks["tuned"]
    hard: list[int] = []
    for turn in range(_RETUNINGS):
        if not checked.failing:
            break
        progress.phase(f"tuning again for {len(checked.failing)} draws that are unstable or beyond a limit")
        hard = list(dict.fromkeys([*checked.failing[: max(1, count // 2)], *hard]))
        rows = list(dict.fromkeys([*hard, *range(count)]))[:count]
        selected = {n: v[np.resize(rows, count)] for n, v in draws.items()}
        loop = problem.loop_with(result.gains)
        hard_problem = TuningProblem.of(task.system, loop, task.scenario, task.bounds, selected, problem.draws)
        if turn:
            limits = _tightened(limits, task.limits, checked.document["worst"])
        retuned = tune(
            hard_problem, task.weights, limits, settle=task.settle, starts=_MORE_STARTS, seed=seed, band=task.band
        )
        result = result._replace(rollouts=result.rollouts + retuned.rollouts)
        new_checks = check_draws(task, retuned.gains, draws)
        follows = task.settle or _median_error(new_checks) <= _median_error(checks["start"])
        if follows and len(new_checks.failing) < len(checked.failing):
            result, checked = retuned._replace(rollouts=result.rollouts), new_checks
    return result, checked


def _tightened(
    limits: Mapping[str, float], original: Mapping[str, float], worst: Mapping[str, float | None]
) -> dict[str, float]:
    """Limits that the worst draw exceeds, tightened; none by more than half of its original value."""
    excess = {k: (worst.get(k) or worst.get(f"peak_{k}") or 0.0) - v for k, v in original.items()}
    tightened = {
        k: v - (excess[k] > 0.0) * max(_TIGHTENING * excess[k], _MIN_TIGHTENING * abs(v)) for k, v in limits.items()
    }
    # An overshoot below 0, for one, cannot be kept.
    return {k: max(v, original[k] - _MAX_TIGHTENING * abs(original[k])) for k, v in tightened.items()}


def _median_error(checks: DrawChecks) -> float:
    """The median tracking error (RMS) over the draws."""
    return checks.document["spread"]["rmse"][1] or math.inf
