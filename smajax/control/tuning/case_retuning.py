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


class _Judge:
    """Checks of gains on cases; alternatives are first compared on the cases of the gains that they replace."""

    def __init__(self, task: TuningTask, problem: TuningProblem, cases: Callable[[int], Sequence[Case]]) -> None:
        self._task, self._problem, self._cases, self._count = task, problem, cases, 0

    def check(self, gains: Mapping[str, float]) -> CaseCheck:
        """Check gains on new cases."""
        self._count += 1
        return check_cases(self._task, gains, self._cases(self._count - 1))

    def best_of(self, result: TuningResult) -> tuple[TuningResult, CaseCheck]:
        """Return the gains and their check, or the first alternative that fails in no case, also not in new ones."""
        check = self.check(result.gains)
        for point in result.alternatives if check.failing else ():
            gains = self.gains(point)
            if not check_cases(self._task, gains, check.cases).failing and not (again := self.check(gains)).failing:
                return result._replace(point=point, gains=gains), again
        return result, check

    def reduced(self, result: TuningResult) -> tuple[TuningResult, CaseCheck] | None:
        """Return the gains with the largest loop gain that fails in no case, and their check; ``None`` without any."""
        for point in reduced_points(self._problem, result.point, 1 + _REDUCTIONS)[1:]:
            gains = self.gains(point)
            if not (check := self.check(gains)).failing:
                return result._replace(point=point, gains=gains), check
        return None

    def gains(self, point: np.ndarray) -> dict[str, float]:
        """Return the gains at a point."""
        return {name: float(v) for name, v in self._problem.gains(point).items()}


def judge_gains(
    task: TuningTask,
    problem: TuningProblem,
    result: TuningResult,
    cases: Callable[[int], Sequence[Case]],
    progress: PhasesAndSteps,
) -> JudgedGains:
    """Check gains on cases, and tune them again up to three times for cases that violate a limit or are unstable.

    Other gains of the search that cost little more are tried first. A new search uses the failing cases and some of the
    others, with the limits that were exceeded tightened. Its gains are checked on new cases, and used if fewer of them
    fail. Where some still fail, as loops that rest at the first reference may, which no search simulates, the loop gain
    is reduced until none does.

    Args:
        task: The tuning task.
        problem: The tuning problem of the previous search.
        result: The gains of the previous search.
        cases: Returns the cases of a check by its number.
        progress: Receives the phases and steps; a ``KeyboardInterrupt`` of it ends the search.
    """
    judge = _Judge(task, problem, cases)
    result, check = judge.best_of(result)
    best, limits, seen, rounds = check, dict(task.limits), [], 0
    # Limits that the search could not keep for its own members are not kept on other cases.
    while best.failing and rounds < _RETUNINGS and result.feasible and not result.interrupted:
        limits = _tightened(limits, task.limits, excess_of_limits(task.limits, check), _MAX_TIGHTENING[rounds])
        failing = sorted(check.failing, key=lambda k: (k not in check.unstable, -_excess(task, check, k)))
        seen = [*(check.cases[k] for k in failing), *seen][:_MOST_FAILING]
        members = [*seen, *_others(check, failing)[: LIMITED_NOISE_DRAWS - len(seen)]]
        words = f"{len(failing)} of {len(check.cases)} cases miss a limit or are unstable: tuning again for them"
        try:
            progress.phase(words, can_stop=True)
            other = _search(replace(task, limits=limits), problem, result, members, progress)
        except KeyboardInterrupt:
            return JudgedGains(result._replace(interrupted=True), best, rounds)
        rounds += 1
        other, check = judge.best_of(other)
        rollouts, interrupted = result.rollouts + other.rollouts, other.interrupted
        if _rank(task, check) < _rank(task, best):
            result, best = other, check
        result = result._replace(rollouts=rollouts, feasible=True, interrupted=interrupted)
    if best.failing and result.feasible and not result.interrupted:
        result, best = judge.reduced(result) or (result, best)
    return JudgedGains(result, best, rounds)


def _others(check: CaseCheck, failing: Sequence[int]) -> list[Case]:
    """Cases that do not fail; those without noise, which dithers the wire, come first, since loops differ there."""
    return sorted((case for k, case in enumerate(check.cases) if k not in failing), key=lambda c: bool(np.any(c.noise)))


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
        population="none" if task.settle else "near",
        band=task.band,
        progress=lambda count, cost: progress.step(f"tuning: {count} rollouts, cost {cost:.4g}", count),
    )
