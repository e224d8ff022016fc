"""Gains that are judged on cases that no search has used, and tuned again for the cases that fail."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from typing import NamedTuple

import numpy as np

from smajax.control.analysis.case_check import CaseCheck, check_cases, excess_of_limits
from smajax.control.analysis.cases import Case
from smajax.control.analysis.closed_loop_checks import metric_of_limit
from smajax.control.tuning.margin_backoff import reduced_points
from smajax.control.tuning.problem import LIMITED_NOISE_DRAWS, TuningProblem
from smajax.control.tuning.task import TuningTask
from smajax.control.tuning.tune import TuningResult, tune
from smajax.progress import PhasesAndSteps

# Largest number of searches for cases that fail; chosen by experiments/control/random_tuning_tasks.py.
_RETUNINGS = 3
# Largest number of failing cases that a search uses. Chosen by trial.
_MOST_FAILING = 12
# Largest number of reductions of the loop gain after them: to a third. Chosen by trial.
_REDUCTIONS = 10
# Tightening of a limit that cases exceed, over the largest excess, and its largest value in each search as a share of
# the limit: the search has the worst cases as members, and other cases exceed them by little. Chosen by trial.
_TIGHTENING = 1.5
_MAX_TIGHTENING = (0.05, 0.15, 0.4)


class JudgedGains(NamedTuple):
    """Gains with their check.

    Attributes:
        result: The gains; their number of rollouts is that of all searches.
        check: Their check on cases that no search has used.
        rounds: Number of searches for failing cases.
    """

    result: TuningResult
    check: CaseCheck
    rounds: int


def judge_gains(
    task: TuningTask,
    problem: TuningProblem,
    result: TuningResult,
    cases: Callable[[int], Sequence[Case]],
    progress: PhasesAndSteps,
) -> JudgedGains:
    """Check gains on cases, and tune them again up to three times for cases that violate a limit.

    A search uses the failing cases and some of the others, with the limits that were exceeded tightened. Its gains are
    checked on new cases, and used if fewer of them fail. Where some still fail, as loops that rest at the first
    reference may, which no search simulates, the loop gain is reduced until none does.

    Args:
        task: The tuning task.
        problem: The tuning problem of the previous search.
        result: The gains of the previous search.
        cases: Returns the cases of a check by its number.
        progress: Receives the phases and steps; a ``KeyboardInterrupt`` of it ends the search.
    """
    check = check_cases(task, result.gains, cases(0))
    best, limits, seen, rounds = check, dict(task.limits), [], 0
    # Limits that the search could not keep for its own members are not kept on other cases.
    while best.beyond and rounds < _RETUNINGS and result.feasible and not result.interrupted:
        limits = _tightened(limits, task.limits, excess_of_limits(task.limits, check), _MAX_TIGHTENING[rounds])
        failing = sorted({k for rows in check.beyond.values() for k in rows}, key=lambda k: -_excess(task, check, k))
        seen = [*(check.cases[k] for k in failing), *seen][:_MOST_FAILING]
        # Without noise, which dithers the wire, a loop behaves differently: these cases come first.
        others = sorted((c for k, c in enumerate(check.cases) if k not in failing), key=lambda c: bool(np.any(c.noise)))
        try:
            progress.phase(
                f"{len(failing)} of {len(check.cases)} cases miss a limit: tuning again for them", can_stop=True
            )
            other = _search(
                replace(task, limits=limits),
                problem,
                result,
                [*seen, *others[: LIMITED_NOISE_DRAWS - len(seen)]],
                progress,
            )
        except KeyboardInterrupt:
            result = result._replace(interrupted=True)
            break
        rounds += 1
        check = check_cases(task, other.gains, cases(rounds))
        rollouts = result.rollouts + other.rollouts
        is_better = _rank(task, check) < _rank(task, best)
        best = check if is_better else best
        result = (other if is_better else result)._replace(
            rollouts=rollouts, feasible=True, interrupted=other.interrupted
        )
    if best.beyond and result.feasible and not result.interrupted:
        for step, point in enumerate(reduced_points(problem, result.point, 1 + _REDUCTIONS)[1:], start=1 + _RETUNINGS):
            reduced = {name: float(v) for name, v in problem.gains(point).items()}
            check = check_cases(task, reduced, cases(step))
            if not check.failing:
                return JudgedGains(result._replace(point=point, gains=reduced), check, rounds)
    return JudgedGains(result, best, rounds)


def _rank(task: TuningTask, check: CaseCheck) -> tuple[int, float]:
    """Sort key of checks: number of failing cases, then the largest excess; smaller is better."""
    failing = check.failing
    return len(failing), max((_excess(task, check, k) for k in failing), default=0.0)


def _excess(task: TuningTask, check: CaseCheck, case: int) -> float:
    """Largest excess of a case over its limits, as a share of the limit."""
    values = check.metrics[case]
    shares = [(values[metric_of_limit(n)] - v) / max(abs(v), 1e-9) for n, v in task.limits.items()]
    return max((share for share in shares if share == share), default=0.0)


def _tightened(
    limits: Mapping[str, float], original: Mapping[str, float], excess: Mapping[str, float], most: float
) -> dict[str, float]:
    """Limits after those that a case exceeds are tightened, by at most a share of their original value."""
    wanted = {k: original[k] - min(_TIGHTENING * excess[k], most * abs(original[k])) for k in limits}
    return {k: min(v, wanted[k]) if excess[k] > 0.0 else v for k, v in limits.items()}


def _search(
    task: TuningTask,
    problem: TuningProblem,
    result: TuningResult,
    cases: Sequence[Case],
    progress: PhasesAndSteps,
) -> TuningResult:
    """The best gains for some cases, from the last gains."""
    chosen = [cases[k % len(cases)] for k in range(max(LIMITED_NOISE_DRAWS, problem.count))]
    members = {name: np.array([case.parameters[name] for case in chosen]) for name in chosen[0].parameters}
    noise, loop = np.stack([case.noise for case in chosen]), problem.loop_with(result.gains)
    return tune(
        TuningProblem.of(task.system, loop, task.scenario, task.bounds, members, noise),
        task.weights,
        task.limits,
        settle=task.settle,
        population=not task.settle,
        band=task.band,
        progress=lambda count, cost: progress.step(f"tuning: {count} rollouts, cost {cost:.4g}", count),
    )
