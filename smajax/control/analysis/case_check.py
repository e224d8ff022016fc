"""Check of one set of gains on many cases, none of which a search has used: the worst of each metric, and its case."""

import dataclasses
import math
from collections import Counter
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import jax
import jax.numpy as jnp
import numpy as np

from smajax.control.analysis.cases import Case, rounded
from smajax.control.analysis.closed_loop_checks import (
    ControlTask,
    jump_responses,
    metric_of_limit,
    rollout_instability,
    rollout_metrics,
    violated_limits,
)
from smajax.control.analysis.members import members_at_rest, rollout_members
from smajax.control.analysis.step_response import StepResponse
from smajax.control.loop.gains import gain, gains
from smajax.control.loop.rollout import Rollout
from smajax.numerics.ensemble import share_among_cores
from smajax.numerics.stored_programs import stored

# Number of cases in one call of the compiled program; chosen by trial for speed.
BATCH = 32
# Response where a case begins after the first jump.
_NO_JUMP = StepResponse(0.0, 0.0, 0.0)


class WorstCase(NamedTuple):
    """Worst value of a metric over the cases.

    Attributes:
        value: The metric; infinite if it is NaN in any case.
        case: Number of the case.
    """

    value: float
    case: int


class CaseCheck(NamedTuple):
    """Rollouts of one set of gains on many cases.

    Attributes:
        cases: The cases.
        metrics: Metrics of each, by their names in tune.json.
        responses: Response to each jump of the reference, of each case.
        unstable: Numbers of the cases without noise that are unstable.
        beyond: Numbers of the cases that violate each limit, by its name, without limits that all keep.
    """

    cases: tuple[Case, ...]
    metrics: tuple[dict[str, float], ...]
    responses: tuple[tuple[StepResponse, ...], ...]
    unstable: tuple[int, ...]
    beyond: dict[str, tuple[int, ...]]

    @property
    def failing(self) -> tuple[int, ...]:
        """Numbers of the cases that are unstable or violate a limit."""
        return tuple(sorted({*self.unstable, *(k for rows in self.beyond.values() for k in rows)}))

    @property
    def groups(self) -> dict[str, int]:
        """Number of cases of each group."""
        return dict(Counter(case.group for case in self.cases))

    def worst(self, metric: str) -> WorstCase:
        """Return the largest value of a metric, and its case."""
        return _largest([values[metric] for values in self.metrics])

    def worst_response(self, jump: int, name: str) -> WorstCase:
        """Return the largest rise, settling or overshoot of a jump, and its case."""
        return _largest([getattr(response[jump], name) for response in self.responses])


def _largest(values: Sequence[float]) -> WorstCase:
    numbers = [math.inf if math.isnan(v) else v for v in values]
    case = int(np.argmax(numbers))
    return WorstCase(numbers[case], case)


def check_cases(task: ControlTask, tuned: Mapping[str, float], cases: Sequence[Case]) -> CaseCheck:
    """Simulate one set of gains on all cases.

    Args:
        task: The control task.
        tuned: Gains in internal units; others keep their start values.
        cases: The cases.

    Returns:
        Metrics and responses of each case, and the cases that fail.
    """
    count = len(jump_responses(task, np.asarray(task.scenario.reference)))

    def check_batch(first: int) -> list[_CaseResult]:
        # The last batch is padded with the last case, so that one compiled program serves all batches.
        batch = [cases[min(k, len(cases) - 1)] for k in range(first, first + BATCH)]
        result = _simulate_batch(task, tuned, batch)
        channels, commands = {n: np.asarray(v) for n, v in result.channels.items()}, np.asarray(result.command)
        return [
            _case_result(task, batch[k], count, {n: v[k] for n, v in channels.items()}, commands[k])
            for k in range(min(BATCH, len(cases) - first))
        ]

    parts = share_among_cores(check_batch, range(0, len(cases), BATCH), new_program=True)
    results = [result for part in parts for result in part]
    beyond = {
        name: tuple(k for k, result in enumerate(results) if name in result.beyond)
        for name in dict.fromkeys(name for result in results for name in result.beyond)
    }
    return CaseCheck(
        tuple(cases),
        tuple(result.metrics for result in results),
        tuple(result.responses for result in results),
        tuple(k for k, result in enumerate(results) if result.unstable),
        beyond,
    )


class _CaseResult(NamedTuple):
    """Metrics and responses of a case, whether it is unstable, and the limits that it violates."""

    metrics: dict[str, float]
    responses: tuple[StepResponse, ...]
    unstable: bool
    beyond: tuple[str, ...]


def _case_result(
    task: ControlTask, case: Case, count: int, channels: dict[str, np.ndarray], command: np.ndarray
) -> _CaseResult:
    """What a rollout of a case gives; ``count`` is the number of jumps of the reference."""
    of_case = _resting_task(task) if case.rests else task
    jumps = jump_responses(of_case, channels[task.loop.channel])
    missing = (_NO_JUMP,) * (count - len(jumps))
    metrics = {**(_NO_JUMP._asdict() if missing else {}), **rollout_metrics(of_case, channels, command)}
    is_quiet = not np.any(case.noise)
    unstable = is_quiet and bool(rollout_instability(task, command, channels[task.loop.channel]))
    return _CaseResult(metrics, (*missing, *jumps), unstable, tuple(violated_limits(task.limits, metrics)))


def _resting_task(task: ControlTask) -> ControlTask:
    """The task of a loop that rests at the first reference, which then is no jump."""
    scenario = task.scenario
    return dataclasses.replace(task, scenario=dataclasses.replace(scenario, initial_reference=scenario.reference[0]))


def _simulate_batch(task: ControlTask, tuned: Mapping[str, float], batch: Sequence[Case]) -> Rollout:
    """Rollouts of a batch of cases; those that rest begin with the states after a rollout at the first reference."""
    own = {name: float(gain(task.loop, name)) for name in gains(task.loop)} | dict(tuned)
    values = {n: jnp.asarray([rounded(v, case.digits) for case in batch], jnp.float64) for n, v in own.items()}
    plants = {n: jnp.asarray([case.parameters[n] for case in batch], jnp.float64) for n in batch[0].parameters}
    noise = jnp.asarray(np.stack([case.noise for case in batch]))
    initial = jnp.asarray([case.initial for case in batch], jnp.float64)
    first = _at_rest(task.system, task.loop, task.scenario, plants, values, initial)
    if any(case.rests for case in batch):
        held = dataclasses.replace(
            task.scenario,
            reference=jnp.full_like(task.scenario.reference, task.scenario.reference[0]),
            changes={name: jnp.full_like(rows, rows[0]) for name, rows in task.scenario.changes.items()},
        )
        # The noise before the first sample is that of the case in reverse order.
        settled = _simulate(task.system, task.loop, held, plants, noise[:, ::-1], values, first).final_states
        rests = jnp.asarray([case.rests for case in batch])
        first = jax.tree.map(
            lambda held, cold: jnp.where(rests.reshape(-1, *[1] * (held.ndim - 1)), held, cold), settled, first
        )
    return _simulate(task.system, task.loop, task.scenario, plants, noise, values, first)


_simulate = stored(rollout_members)
_at_rest = stored(members_at_rest)


def excess_of_limits(limits: Mapping[str, float], check: CaseCheck) -> dict[str, float]:
    """Return by how much the worst case exceeds each limit, internal units; 0 where all keep it.

    Args:
        limits: Limits by name, internal units.
        check: The check.
    """
    return {
        name: max(check.worst(metric_of_limit(name)).value - limit, 0.0) if name in check.beyond else 0.0
        for name, limit in limits.items()
    }
