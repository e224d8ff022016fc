"""Smaller loop gains: with the usual margins, where they cost little of the objective."""

import numpy as np
from jaxtyping import Float

from smajax.control.analysis.closed_loop_checks import GainEvaluation, evaluate_gains
from smajax.control.analysis.margins import has_usual_margins
from smajax.control.tuning.objective import make_objective
from smajax.control.tuning.problem import TuningProblem
from smajax.control.tuning.search import BATCH, GainSearch
from smajax.control.tuning.task import TuningTask
from smajax.control.tuning.tune import TuningResult

# Gains that multiply the error: the loop gain is proportional to them.
_LOOP_GAINS = ("kp", "ki", "kd")
# Factor between two trials, and share by which the objective may grow; chosen by trial on the wire of
# data/controllers/dead-weight.toml.
_FACTOR = 0.9
_COST_SHARE = 0.1


def reduced_points(
    problem: TuningProblem, point: Float[np.ndarray, " gains"], count: int
) -> Float[np.ndarray, "points gains"]:
    """Return points at which the loop gain is 0.9^k of that at a point, k = 0, 1, ...; none is outside of the bounds.

    Args:
        problem: The tuning problem.
        point: The point of the unit box, shape ``(p,)``.
        count: Number of points.

    Returns:
        Points, shape ``(count, p)``; all are the same if no gain multiplies the error.
    """
    rows = [i for i, name in enumerate(problem.names) if name in _LOOP_GAINS]
    width = np.log(np.asarray(problem.upper) / np.asarray(problem.lower))
    points = np.tile(point, (count, 1))
    points[:, rows] += np.arange(count)[:, None] * np.log(_FACTOR) / np.where(width > 0.0, width, np.inf)[rows]
    return np.clip(points, 0.0, 1.0)


def reduce_loop_gain(
    task: TuningTask, problem: TuningProblem, result: TuningResult, evaluation: GainEvaluation
) -> tuple[TuningResult, GainEvaluation]:
    """Reduce the loop gain until the median margins are usual, or the objective has grown by a tenth.

    Gains that violate a limit of the search are not used. Where no reduction gives the usual margins, the gains stay.

    Args:
        task: The tuning task.
        problem: The tuning problem of the search.
        result: The gains of the search.
        evaluation: Behaviour of the rig's own plant with these gains.

    Returns:
        The gains, and the behaviour of the rig's own plant with them.
    """
    has_loop_gain = any(name in _LOOP_GAINS for name in problem.names)
    if not has_loop_gain or not result.feasible or result.interrupted or has_usual_margins(evaluation.margins):
        return result, evaluation
    search = GainSearch(problem, make_objective(task.weights, task.limits, task.band), lambda count, cost: None)
    candidates = search.candidates(reduced_points(problem, result.point, BATCH))
    most = (1.0 + _COST_SHARE) * candidates[0].cost
    counted = result._replace(rollouts=result.rollouts + search.rollouts)
    for candidate in candidates[1:]:
        if candidate.violation > 0.0 or candidate.cost > most:
            break
        gains = {name: float(v) for name, v in problem.gains(candidate.point).items()}
        other = evaluate_gains(task, gains)
        if has_usual_margins(other.margins) and not other.unstable:
            return counted._replace(point=candidate.point, gains=gains), other
    return counted, evaluation
